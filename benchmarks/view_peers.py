"""The page beside other viewers, on one volume, in one browser.

`TRABECULA_PEERS` names a folder that holds them: `npm install vtk.js` (node_modules/vtk.js) and
`pip install --target k3d k3d` (k3d); what is not there is left out.
"""

from __future__ import annotations

import base64
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import trabecula as tb
from common import tell
from view import STAGE, bone, memory_of

_PAGE = """window.trabecula.ready.then((app) => {
  window.frame = () => {
    const { gl } = app.drawing;
    app.paint(1, 0);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
  clearTimeout(app.settle);
  app.redraw = app.schedule = () => {};
  const stage = document.getElementById("stage").style;
  Object.assign(stage, { width: "SIDEpx", height: "SIDEpx", minHeight: "0", flex: "none" });
  frame();
})""".replace("SIDE", str(STAGE))

_VTK = Path(__file__).with_name("view_peers_vtk.html")

_K3D = """
import sys, numpy as np, k3d
values = np.load(sys.argv[1]).astype(np.float32)
plot = k3d.plot(height=int(sys.argv[3]), grid_visible=False, axes_helper=0, menu_visibility=False)
plot.snapshot_type = "full"
plot += k3d.volume(values, color_range=[0.4, 0.6], alpha_coef=200, bounds=[0, 1, 0, 1, 0, 1],
                   color_map=k3d.matplotlib_color_maps.Bone)
plot.camera = [1.6, -1.8, 1.3, 0.5, 0.5, 0.5, 0, 0, 1]
open(sys.argv[2], "w").write(plot.get_snapshot())
"""
_K3D_READY = """new Promise((done) => {
  const wait = () => (window.K3DInstance && K3DInstance.then ? K3DInstance.then((plot) => {
    const world = plot.getWorld(), gl = world.renderer.getContext();
    plot.setCameraAutoFit && plot.setCameraAutoFit(false);
    window.frame = async () => {
      plot.render(true);
      await new Promise((done) => requestAnimationFrame(() => setTimeout(done, 0)));
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    };
    frame().then(done);
  }) : setTimeout(wait, 20));
  wait();
})"""


def view_peers(side: int = 200, frames: int = 3) -> None:
    """The page, vtk.js and k3d on bone of 200^3 at 512 x 512: MB of the file, seconds to the first
    picture by the clock, seconds of the processor a frame, MB over an empty page.
    """
    import chromium

    if chromium.find_browser() is None:
        tell(chromium.MISSING)
        return
    peers, volume = Path(os.environ.get("TRABECULA_PEERS", "")), bone(side)
    tell("viewer", "MB", "first picture, s", "a frame, processor s", "MB over empty")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        page = tb.view(volume, names=["bone"]).save(folder / "page.html")
        rows = [("page", page, page.stat().st_size, _PAGE, "frame()")]
        library = peers / "node_modules" / "vtk.js" / "vtk.js"
        if library.is_file():
            (folder / "vtk.js").symlink_to(library.resolve())
            place = _vtk_page(volume.values, folder)
            size = place.stat().st_size + library.stat().st_size
            rows.append(("vtk.js", place, size, "trabeculaPeer.then(() => 0)", "frame()"))
        if (peers / "k3d").is_dir():
            place = _k3d_page(volume.values, folder, peers / "k3d")
            rows.append(("k3d", place, place.stat().st_size, _K3D_READY, "frame()"))
        for row in rows:
            tell(*_measured(*row, frames))


def _vtk_page(values: np.ndarray, folder: Path) -> Path:
    import gzip

    data = base64.b64encode(gzip.compress(values.tobytes(), 6)).decode()
    text = (
        _VTK.read_text()
        .replace("SIDE", str(STAGE))
        .replace("N, N, N", ", ".join([str(len(values))] * 3))
    )
    (folder / "vtk.html").write_text(text.replace("DATA", data))
    return folder / "vtk.html"


def _k3d_page(values: np.ndarray, folder: Path, package: Path) -> Path:
    np.save(folder / "values.npy", values)
    words = [sys.executable, "-c", _K3D, folder / "values.npy", folder / "k3d.html", str(STAGE)]
    subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": str(package)})
    return folder / "k3d.html"


def _measured(
    name: str, place: Path, size: int, ready: str, frame: str, frames: int
) -> tuple[str, ...]:
    """What a fresh browser tells of a viewer."""
    import chromium

    browser = chromium.Chromium()
    try:
        browser.open("about:blank", size=(900, 700))
        empty, start = memory_of(browser), time.perf_counter()
        tab = browser.open(place.as_uri(), size=(STAGE, STAGE) if name == "k3d" else (900, 700))
        tab.run(ready)
        first = time.perf_counter() - start
        tab.run("new Promise((done) => setTimeout(done, 3000))")
        tab.run(frame)
        before = sum(seconds for _, _, seconds in browser.processes())
        for _ in range(frames):
            tab.run(frame)
        busy = (sum(seconds for _, _, seconds in browser.processes()) - before) / frames
        tab.call("HeapProfiler.collectGarbage")
        held = (memory_of(browser) - empty) / 1e6
        shot = os.environ.get("TRABECULA_SHOTS")
        if shot:
            from PIL import Image

            Image.fromarray(tab.picture()).save(Path(shot) / f"{name}.png")
        return name, f"{size / 1e6:.2f}", f"{first:.1f}", f"{busy:.2f}", f"{held:.0f}"
    finally:
        browser.close()

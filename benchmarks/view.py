"""Pictures: how long a still takes, and what the page asks of a browser."""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import trabecula as tb
from common import tell

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "view"))

STAGE = 512
FRAMES = 4
_READY = """window.trabecula.ready.then((app) => {
  window.app = app;
  const gl = app.drawing.gl;
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  return performance.now();
})"""
_SQUARE = f"""(() => {{
  const stage = document.getElementById("stage").style;
  Object.assign(stage, {{ width: "{STAGE}px", height: "{STAGE}px", minHeight: "0", flex: "none" }});
  return new Promise((done) => setTimeout(done, 400));
}})()"""
_HOLD = (
    "new Promise((done) => { const wait = () => "
    "(app.passes >= 4 ? done(0) : setTimeout(wait, 50)); wait(); })"
)

_SETTLED = """new Promise((done) => {
  const wait = () => {
    const [volume] = app.volumes, came = app.cameras[0].zoom === 1 || volume.fine;
    return app.passes >= 4 && came ? done(0) : setTimeout(wait, 100);
  };
  wait();
})"""


def bone(side: int) -> tb.Image:
    """The sample, mirrored until it has that many voxels a side."""
    sample = tb.sample("bone")
    values = np.pad(
        sample.values, [(0, max(0, side - length)) for length in sample.shape], mode="symmetric"
    )
    return tb.Image(
        values[:side, :side, :side], "labels", sample.spacing, sample.unit, sample.phases
    )


def scan(side: int) -> tb.Image:
    """A grey scan of it: 90 and 160, blurred by the noise of a scanner (standard deviation 12)."""
    labels = bone(side)
    noise = np.random.default_rng(0).normal(0, 12, labels.shape)
    return tb.Image(
        np.clip(np.round(90 + 70.0 * labels.values + noise), 0, 255).astype(np.uint8),
        "grey",
        labels.spacing,
        "um",
    )


def view_still() -> None:
    """Seconds of a still of 800 x 600, by look."""
    tell("look", "side", "s, one thread")
    for side in (128, 256):
        volume = bone(side)
        for look in ("bone", "stone"):
            tb.render(volume, look=look, size=(64, 48))
            start = time.process_time()
            tb.render(volume, look=look)
            tell(look, side, f"{time.process_time() - start:.2f}")


def view_page() -> None:
    """The page of 200^3 in headless Chromium's software rasteriser, 512 x 512: size, load, frame,
    samples, memory.
    """
    import chromium

    if chromium.find_browser() is None:
        tell(chromium.MISSING)
        return
    tell("volume", "MB", "first frame, s", "memory / volume")
    with tempfile.TemporaryDirectory() as folder:
        empty = _opened(tb.Image(bone(8).values, "labels"), folder)["memory"]
        for name, volume in (("labels", bone(200)), ("grey", scan(200))):
            found = _opened(volume, folder)
            memory = (found["memory"] - empty) / volume.values.size
            tell(
                name, f"{found['size'] / 1e6:.2f}", f"{found['first'] / 1000:.2f}", f"{memory:.1f}"
            )
            tell("", "frame, ms", "of processor, ms", "samples a pixel")
            for how, kind in (
                ("whole", "skipping"),
                ("plain", "no skipping"),
                ("half", "dragging, half size"),
            ):
                each = found[how]
                tell(
                    kind,
                    f"{each['milliseconds']:.0f}",
                    f"{each['busy']:.0f}",
                    f"{each['samples']:.1f}",
                )


def view_large(side: int = 1024) -> None:
    """Bone of 1024^3 in a Zarr store, served and looked at closely: seconds, and the memory of the
    page over that of an empty browser.
    """
    import chromium

    from trabecula.io.lazy import open_slabs
    from trabecula.view.page.server import PageServer

    if chromium.find_browser() is None:
        tell(chromium.MISSING)
        return
    with tempfile.TemporaryDirectory() as folder:
        store = tb.write(bone(side), Path(folder) / "bone.zarr")
        start = time.process_time()
        page = tb.view(open_slabs(store))
        assert page.live is not None and page.live.boxes is not None
        tell("page made, processor s", f"{time.process_time() - start:.1f}")
        start = time.process_time()
        page.live.boxes(0, 4, (100,) * 3, (48,) * 3)
        tell("box of 192^3, processor s", f"{time.process_time() - start:.1f}")
        browser = chromium.Chromium()
        try:
            with PageServer(page.live.html, boxes=page.live.boxes) as server:
                threading.Thread(target=server.serve_forever, daemon=True).start()
                browser.open("about:blank", size=(560, 480))
                empty = memory_of(browser)
                tab = browser.open(server.url, size=(560, 480))
                tell("first picture, s by the clock", f"{tab.run(_READY) / 1000:.1f}")
                for zoom, what in ((1, "whole"), (6, "box of finer voxels")):
                    tab.run(f"app.cameras[0].zoom = {zoom}; app.redraw()")
                    tab.run(_SETTLED)
                    tab.call("HeapProfiler.collectGarbage")
                    tell(f"MB with the {what}", f"{(memory_of(browser) - empty) / 1e6:.0f}")
                server.shutdown()
        finally:
            browser.close()


def memory_of(browser) -> int:
    kinds = ("renderer", "gpu-process")
    return sum(size for kind, size, _ in browser.processes() if kind in kinds)


def _opened(volume: tb.Image, folder: str) -> dict:
    """What a fresh browser tells of a page with that volume."""
    import chromium

    path = tb.view(volume, names=["volume"]).save(Path(folder) / "page.html")
    browser = chromium.Chromium()
    try:
        tab = browser.open(path.as_uri(), size=(900, 700))
        first = tab.run(_READY)
        tab.run(_SQUARE)
        tab.run(_HOLD)
        tab.call("HeapProfiler.collectGarbage")
        found = {"size": path.stat().st_size, "first": first, "memory": memory_of(browser)}
        if volume.values.size > 1000:
            for name, options in (("whole", ""), ("plain", "skip: false"), ("half", "scale: 0.5")):
                found[name] = _measured(browser, tab, options)
        return found
    finally:
        browser.close()


def _measured(browser, tab, options: str) -> dict:
    """What the page measures, and the processor's milliseconds a frame: other work on the machine
    does not lengthen them.
    """
    before = sum(seconds for _, _, seconds in browser.processes())
    found = tab.run(f"app.measure({{ frames: {FRAMES}, {options} }})")
    # One frame before the clock starts, and one that counts samples.
    found["busy"] = (
        1000 * (sum(seconds for _, _, seconds in browser.processes()) - before) / (FRAMES + 2)
    )
    return found

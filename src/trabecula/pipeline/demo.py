"""The main job on an embedded sample, start to end."""

from __future__ import annotations

import os
from pathlib import Path

from trabecula import finish
from trabecula.core.progress import notify
from trabecula.exemplar.samples import sample
from trabecula.io import files
from trabecula.pipeline.certificate_page import write_page
from trabecula.pipeline.outputs import check_folder, export
from trabecula.report.certificate import verify
from trabecula.report.verdict import Certificate
from trabecula.synth.api.registry import method
from trabecula.view.slices import montage
from trabecula.view.still import render

_DISK = 200 << 20  # bytes


def demo(folder: str | os.PathLike[str], *, shape: int = 120, seed: int = 7) -> Certificate:
    """Run the main job on `sample:bone`: a larger volume, connected, with everything about it.

    Writes exemplar.zarr, bone.zarr, part.zarr, part.stl, part.png, slices.png and report.html into
    `folder`.

    Parameters
    ----------
    folder : path
    shape : int
        Edge of the volume, voxels.
    seed : int

    Returns
    -------
    Certificate
        Of the connected volume against the sample.
    """
    out = Path(folder)
    check_folder(out / "report.html", size=_DISK)
    exemplar = sample("bone")
    material = method("texture").fit(exemplar).generate(shape, seed=seed)
    part = finish.connect(material)
    for image, name in ((exemplar, "exemplar.zarr"), (material, "bone.zarr"), (part, "part.zarr")):
        files.write(image, out / name)
    notify(f"surface: {export(part, out / 'part.stl')}")
    render(part, out / "part.png")
    montage([exemplar, part], ["exemplar", "part"], out / "slices.png")
    verdict = verify(exemplar, part, names=["part.zarr"])
    write_page(out / "report.html", exemplar, [part], [verdict])
    return verdict

"""`trabecula demo [--out DIR]`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from trabecula.cli import terminal

if TYPE_CHECKING:
    from trabecula.report.verdict import Certificate

_DISK = 200 << 20  # bytes
_SCALE = 10  # of the part that is printed: struts of the sample are too thin for a desktop printer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder of the results."""
    parser.add_argument(
        "--out", default="out", metavar="DIR", help="folder for the results (default: out)"
    )
    parser.add_argument("--json", action="store_true", help="print the certificate as JSON")


def run(options: argparse.Namespace) -> int:
    """Run the main job and list its files."""
    verdict = demo(options.out)
    if options.json:
        terminal.show_json(verdict.to_json())
        return 0
    terminal.show_certificate(verdict.to_table())
    print(f"\nIn {options.out}:")
    terminal.show_rows(
        [
            (f"  {path.name}", _WHAT.get(path.name, ""))
            for path in sorted(Path(options.out).iterdir())
        ]
    )
    return 0


_WHAT = {
    "exemplar.zarr": "the sample: a stand-in for a scan, 96^3",
    "bone.zarr": "more of the same material, 120^3, with its recipe",
    "part.zarr": "the same in one piece",
    "part.3mf": "its surface ten times as large, within half a voxel, for a slicer",
    "part.png": "a still",
    "slices.png": "slices beside the exemplar's",
    "report.html": "the certificate: one page, open it in a browser",
}


def demo(folder: str | os.PathLike[str], *, shape: int = 120, seed: int = 7) -> Certificate:
    """Run the main job on `sample:bone`: a larger volume, connected, with everything about it.

    Writes exemplar.zarr, bone.zarr, part.zarr, part.3mf, part.png, slices.png and report.html into
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
    from trabecula import finish
    from trabecula.core.progress import notify
    from trabecula.exemplar.samples import sample
    from trabecula.finish.printing import print_check
    from trabecula.io import files
    from trabecula.io.lengths import with_lengths
    from trabecula.pipeline.certificate_page import write_page
    from trabecula.pipeline.outputs import check_folder, export
    from trabecula.report.certificate import verify
    from trabecula.synth.api.registry import method
    from trabecula.view.slices import montage
    from trabecula.view.still import render

    out = Path(folder)
    check_folder(out / "report.html", size=_DISK)
    exemplar = sample("bone")
    material = method("texture").fit(exemplar).generate(shape, seed=seed)
    part = finish.connect(material)
    for image, name in ((exemplar, "exemplar.zarr"), (material, "bone.zarr"), (part, "part.zarr")):
        files.write(image, out / name)
    large = with_lengths(part, scale=_SCALE)
    printed = export(large, out / "part.3mf", tolerance=0.5)
    about = print_check(large, printer="sla").findings
    notify(f"surface: {printed}: {about[0].says}; resin: {about[-1].says}")
    render(part, out / "part.png")
    montage([exemplar, part], ["exemplar", "part"], out / "slices.png")
    verdict = verify(exemplar, part, names=["part.zarr"])
    write_page(out / "report.html", exemplar, [part], [verdict])
    return verdict

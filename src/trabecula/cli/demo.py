"""`trabecula demo [--out DIR]`."""

from __future__ import annotations

import argparse
from pathlib import Path

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder of the results."""
    parser.add_argument(
        "--out", default="out", metavar="DIR", help="folder for the results (default: out)"
    )
    parser.add_argument("--json", action="store_true", help="print the certificate as JSON")


def run(options: argparse.Namespace) -> int:
    """Run the main job and list its files."""
    from trabecula.pipeline.demo import demo

    verdict = demo(options.out)
    if options.json:
        terminal.show_json(verdict.to_json())
        return 0
    print(verdict.to_table())
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
    "part.stl": "its closed surface, in millimetres",
    "part.png": "a still",
    "slices.png": "slices beside the exemplar's",
    "report.html": "the certificate: one page, open it in a browser",
}

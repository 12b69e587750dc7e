"""`trabecula inspect SCAN [--json]`."""

from __future__ import annotations

import argparse
from math import prod
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal

_BYTES = 16  # a voxel: greys as float32, components, and what is made of them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The scan and how it is read."""
    parser.add_argument("scan", metavar="SCAN", help="volume or picture, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument(
        "--memory",
        type=shared.gibibytes,
        metavar="GIB",
        help="memory that may be used (default: what is available); of a .zarr of labels that needs more the centre box is "
        "inspected",
    )
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print what was found."""
    from trabecula.report.inspection import inspect

    found = inspect(_loaded(options))
    if options.json:
        terminal.show_json(found.to_json())
    else:
        print(found.to_table())
    return 0


def _loaded(options: argparse.Namespace) -> Any:
    """The scan; a grey one stays grey unless a threshold is given."""
    from trabecula.io.lazy import slabs_if_large
    from trabecula.pipeline.inputs import load

    if options.threshold in (None, "none"):
        volume = slabs_if_large(
            options.scan,
            need=lambda shape: _BYTES * prod(shape),
            memory=options.memory,
            **shared.reading(options),
        )
        if volume is not None:
            return volume.centre(shared.box_of(options, options.scan)) if options.crop else volume
    threshold = "none" if options.threshold is None else shared.threshold(options.threshold)
    return load(
        options.scan, crop=shared.crop_of(options), threshold=threshold, **shared.reading(options)
    )

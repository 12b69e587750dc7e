"""`trabecula inspect SCAN [--json]`."""

from __future__ import annotations

import argparse
from math import prod
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.csv_tables import add_csv, check_csv, write_figures

_BYTES = 16  # a voxel: greys as float32, components, and what is made of them


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scan and the options for reading it."""
    parser.add_argument("scan", metavar="SCAN", help="volume or picture, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    add_csv(parser)
    shared.add_memory(parser, "of a .zarr of labels that needs more the centre box is inspected")
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print what is found."""
    from trabecula.report.inspection import inspect

    check_csv(options.csv)
    found = inspect(_load(options))
    write_figures(options.csv, found.to_json())
    if options.json:
        terminal.show_json(found.to_json())
    else:
        print(found.to_table())
    return 0


def _load(options: argparse.Namespace) -> Any:
    """Load the scan; a grey one stays grey unless a threshold is given."""
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

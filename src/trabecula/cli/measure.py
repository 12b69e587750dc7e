"""`trabecula measure FILE [--quick | --full] [--memory GIB] [--json]`."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file and how it is read."""
    parser.add_argument("file", metavar="FILE", help="volume or 2-D picture, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON, curves included")
    parser.add_argument(
        "--memory",
        type=shared.gibibytes,
        metavar="GIB",
        help="memory that may be used (default: what is available); a .zarr of labels that needs more is measured in slabs",
    )
    shared.add_level(parser)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print every descriptor."""
    found = _described(options)
    if options.json:
        terminal.show_json(found)
    else:
        terminal.show_mapping(found)
    return 0


def _described(options: argparse.Namespace) -> dict[str, Any]:
    """Of the whole where that fits into memory, else slab by slab; of a crop of what does not fit only that is read."""
    from trabecula.flow import slabs_if_large
    from trabecula.measure import describe
    from trabecula.measure.blockwise import describe_slabs, in_core_bytes

    wanted = {"level": options.level, "box": options.box}
    volume = None
    if options.threshold in (None, "auto", "none"):
        given = {"memory": options.memory, **shared.reading(options)}
        volume = slabs_if_large(options.file, need=lambda shape: in_core_bytes(shape, options.level), **given)
    if volume is None:
        return describe(shared.load_exemplar(options.file, options), **wanted)
    if options.crop:
        return describe(volume.centre(shared.box_of(options, options.file)), **wanted)
    return describe_slabs(volume, memory=options.memory, **wanted)

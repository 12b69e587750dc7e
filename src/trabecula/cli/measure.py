"""`trabecula measure FILE [--quick | --full] [--json]`."""

from __future__ import annotations

import argparse

from trabecula.cli import options as shared
from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file and how it is read."""
    parser.add_argument("file", metavar="FILE", help="volume or 2-D picture, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON, curves included")
    shared.add_level(parser)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print every descriptor."""
    from trabecula.measure import describe

    found = describe(shared.load_exemplar(options.file, options), level=options.level, box=options.box)
    if options.json:
        terminal.show_json(found)
    else:
        terminal.show_mapping(found)
    return 0

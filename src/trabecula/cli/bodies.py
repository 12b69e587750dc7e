"""`trabecula bodies FILE [--phase NAME] [--components] [--out FILE] [--json]`."""

from __future__ import annotations

import argparse

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.cutting import add_cutting, cutting_of, write_if_named


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file and the options."""
    parser.add_argument("file", metavar="FILE", help="volume, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument(
        "--out", metavar="FILE", help="a row for every body: .csv, .npz, .json, or .vtp"
    )
    parser.add_argument(
        "--components",
        action="store_true",
        help="one body for every connected component: cut nothing at its necks",
    )
    add_cutting(parser, default="the solid, every phase but void")
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print the figures; write the bodies where a file is named."""
    from trabecula.measure import bodies

    image = shared.load_exemplar(options.file, options)
    given = cutting_of(options)
    measured = bodies(image, phase=options.phase, separate=not options.components, **given)
    found = {"shape": list(image.shape), "spacing": list(image.spacing), "unit": image.unit}
    found |= measured.summary()
    found["out"] = write_if_named(measured, options)
    if options.json:
        terminal.show_json(found)
    else:
        terminal.show_mapping(found)
    return 0

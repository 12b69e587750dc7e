"""`trabecula check FILE --printer sls|sla|fdm|slm`."""

from __future__ import annotations

import argparse

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.csv_tables import add_csv, check_csv, write_figures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the part, the printer and its limits."""
    parser.add_argument("file", metavar="FILE", help="volume of labels, in a unit of length")
    parser.add_argument(
        "--printer", default="sls", metavar="NAME", help="sls (default), sla, fdm or slm"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="LIMIT=MM",
        help="another limit than the typical one: box, wall, gap, layer, passage, cup, overhang, "
        "bridge, density, pause, speed; repeatable",
    )
    parser.add_argument("--phase", help="phase that is printed (default: every phase but void)")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    add_csv(parser)
    shared.add_memory(parser)
    shared.add_lengths(parser, spacing=False)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Print the findings; a part that a printer would refuse is no error: status 0."""
    from trabecula.finish import print_check
    from trabecula.io.lengths import with_lengths
    from trabecula.io.units import to_metres
    from trabecula.mesh.sizes import notify_size

    check_csv(options.csv)
    limits = shared.settings(options.set)
    image = with_lengths(
        shared.load_exemplar(options.file, options), scale=shared.scale_factor(options)
    )
    found = print_check(
        image, printer=options.printer, phase=options.phase, memory=options.memory, **limits
    )
    notify_size(
        [side / (1000 * to_metres(image.unit)) for side in found.findings[0].figures["extent"]],
        image.unit,
    )
    write_figures(options.csv, found.to_json())
    if options.json:
        terminal.show_json(found.to_json())
    else:
        print(found.to_table())
    return 0

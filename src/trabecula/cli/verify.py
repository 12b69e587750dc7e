"""`trabecula verify EXEMPLAR FILE ... [--quick | --full] [--json] [--report HTML]`."""

from __future__ import annotations

import argparse
from pathlib import Path

from trabecula.cli import options as shared
from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The exemplar, the results, the forms of the verdict."""
    parser.add_argument("exemplar", metavar="EXEMPLAR", help="scan that the material should be like, or sample:NAME")
    parser.add_argument("files", nargs="+", metavar="FILE", help="results, ours or anybody's")
    parser.add_argument("--json", action="store_true", help="print as JSON (a list for several files)")
    parser.add_argument("--report", metavar="HTML", help="write one self-contained page")
    parser.add_argument(
        "--r-max", type=int, default=50, metavar="R", help="largest distance of the curves, voxels (default 50)"
    )
    shared.add_level(parser)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Judge, print, and write the page where one is asked for. A failed verdict is a result, not an error: status 0."""
    from trabecula.flow import check_page, load_like, write_page
    from trabecula.report.certificate import verify

    if options.report:
        check_page(options.report)
    exemplar = shared.load_exemplar(options.exemplar, options)
    images = [load_like(file, exemplar) for file in options.files]
    names = [Path(file).name for file in options.files]
    found = verify(exemplar, *images, r_max=options.r_max, names=names, level=options.level, box=options.box)
    certificates = found if isinstance(found, list) else [found]
    if options.report:
        write_page(options.report, exemplar, images, certificates)
    if options.json:
        verdicts = [certificate.to_json() for certificate in certificates]
        terminal.show_json(verdicts if len(verdicts) > 1 else verdicts[0])
    else:
        print("\n\n".join(certificate.to_table() for certificate in certificates))
    return 0

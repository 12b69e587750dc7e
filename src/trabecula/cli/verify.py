"""`trabecula verify EXEMPLAR FILE ... [--pictures FILE ... [--views PLANE ... | --gap N] |
--ensemble [--parts FILE ...]] [--quick | --full] [--json] [--report HTML]`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.csv_tables import add_csv, check_csv, write_csv, write_figures
from trabecula.core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the exemplar, the results and the forms of the verdict."""
    parser.add_argument(
        "exemplar", metavar="EXEMPLAR", help="scan that the material should be like, or sample:NAME"
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="results, ours or anybody's")
    parser.add_argument(
        "--json", action="store_true", help="print as JSON (a list for several files)"
    )
    add_csv(parser)
    parser.add_argument("--report", metavar="HTML", help="write one self-contained page")
    parser.add_argument(
        "--r-max",
        type=int,
        default=50,
        metavar="R",
        help="largest distance of the curves, voxels (default 50)",
    )
    shared.add_memory(parser, "a .zarr of labels that needs more is judged in slabs")
    group = parser.add_argument_group("volumes held against pictures")
    group.add_argument(
        "--pictures",
        nargs="+",
        default=[],
        metavar="FILE",
        help="further pictures, where EXEMPLAR is one: of other planes",
    )
    group.add_argument(
        "--views",
        nargs="+",
        default=[],
        metavar="PLANE",
        help="plane of each picture, EXEMPLAR's first: yx (seen across z), zx, zy, xy, xz, yz; or "
        "of one picture all of them",
    )
    group.add_argument(
        "--gap",
        type=int,
        default=0,
        metavar="N",
        help="the pictures are parallel sections, N pixels from one to the next, which judge the "
        "Euler number",
    )
    group = parser.add_argument_group("ensembles")
    group.add_argument(
        "--ensemble",
        action="store_true",
        help="judge all results together: is their distribution that of real parts of their size?",
    )
    group.add_argument(
        "--parts",
        nargs="+",
        default=[],
        metavar="FILE",
        help="further scans of the material, whose parts are real as well",
    )
    shared.add_level(parser)
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Judge, print, and write the page that is named. A failed verdict is a result, not an
    error: status 0.
    """
    from trabecula.pipeline.certificate_page import check_page, write_page
    from trabecula.report.certificate import verify
    from trabecula.report.tables import figure_rows

    check_csv(options.csv)
    if options.report:
        check_page(options.report)
    if options.ensemble:
        return _judge_ensemble(options)
    if options.parts:
        raise InputError("--parts are for an ensemble: give --ensemble as well")
    sources = [options.exemplar, *options.pictures]
    exemplars = [shared.load_exemplar(source, options) for source in sources]
    views = [plane for word in options.views for plane in word.split(",")]
    images = [_result(file, exemplars, views, options) for file in options.files]
    names = [Path(file).name for file in options.files]
    wanted = {
        "r_max": options.r_max,
        "names": names,
        "level": options.level,
        "box": options.box,
        "views": views,
        "gap": options.gap,
    }
    wanted["memory"] = options.memory
    found = verify(exemplars if len(exemplars) > 1 else exemplars[0], *images, **wanted)
    certificates = found if isinstance(found, list) else [found]
    if options.csv:
        write_csv(options.csv, figure_rows(certificates))
    if options.report:
        write_page(options.report, exemplars, images, certificates)
    if options.json:
        verdicts = [certificate.to_json() for certificate in certificates]
        terminal.show_json(verdicts if len(verdicts) > 1 else verdicts[0])
    else:
        terminal.show_certificate(
            "\n\n".join(certificate.to_table() for certificate in certificates)
        )
    return 0


def _judge_ensemble(options: argparse.Namespace) -> int:
    """Judge all results together."""
    from trabecula.pipeline.certificate_page import write_ensemble_page
    from trabecula.pipeline.inputs import load_like
    from trabecula.report.ensemble import verify_ensemble

    if options.pictures or options.views or options.gap:
        raise InputError(
            "--ensemble compares volumes with parts of volumes: leave out --pictures, --views and "
            "--gap; further scans follow --parts"
        )
    sources = [options.exemplar, *options.parts]
    exemplars = [shared.load_exemplar(source, options) for source in sources]
    members = [load_like(file, exemplars[0]) for file in options.files]
    certificate = verify_ensemble(
        exemplars,
        members,
        r_max=options.r_max,
        names=[Path(file).name for file in options.files],
        level=options.level,
        box=options.box,
    )
    write_figures(options.csv, certificate.to_json())
    if options.report:
        write_ensemble_page(options.report, exemplars, members, certificate)
    if options.json:
        terminal.show_json(certificate.to_json())
    else:
        terminal.show_certificate(certificate.to_table())
    return 0


def _result(file: str, exemplars: list[Any], views: list[str], options: argparse.Namespace) -> Any:
    """Load a result, in slabs where it is too large and the exemplar is a volume of labels."""
    from trabecula.measure.blockwise import in_core_bytes
    from trabecula.pipeline.inputs import load_like, slabs_like_if_large, voxels_of

    exemplar, volume = exemplars[0], None
    if exemplar.kind == "labels" and exemplar.ndim == 3:
        level = options.level
        # Above level "quick" the exemplar's search tree is held beside what the image takes.
        held = 0 if level == "quick" else in_core_bytes(exemplar.shape, level)
        memory = {
            "need": lambda shape: held + in_core_bytes(shape, level),
            "memory": options.memory,
        }
        volume = slabs_like_if_large(file, exemplar, **memory)
    return (
        load_like(file, exemplar, spacing=lambda: voxels_of(exemplars, views, gap=options.gap))
        if volume is None
        else volume
    )

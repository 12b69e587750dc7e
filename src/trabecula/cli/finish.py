"""`trabecula finish FILE --connect ... --out FILE`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file and what to do with it."""
    parser.add_argument("file", metavar="FILE", help="volume of labels")
    parser.add_argument("--out", required=True, metavar="FILE", help="volume to write")
    group = parser.add_argument_group("what to do, in this order whatever the order of the words")
    group.add_argument("--prune", action="store_true", help="remove short struts that end freely, grow long ones on")
    group.add_argument("--connect", action="store_true", help="join near parts, remove loose ones: one piece is left")
    group.add_argument(
        "--smooth", metavar="S", help="smooth the surface at the same volume: sigma, in the image's unit"
    )
    group.add_argument("--thicken", metavar="T", help="least thickness of a strut, in the image's unit")
    group.add_argument("--floaters", action="store_true", help="remove every part but the largest")
    group.add_argument("--fill", action="store_true", help="fill pores that no way leads out of")
    parser.add_argument("--like", metavar="EXEMPLAR", help="for --prune: the exemplar, whose free ends are no fault")
    parser.add_argument("--phase", help="phase that is finished (default: every phase but void)")


def run(options: argparse.Namespace) -> int:
    """Do the operations asked for, each on the result of the one before."""
    from trabecula.core.errors import InputError
    from trabecula.finish import OPERATIONS
    from trabecula.flow import check_target
    from trabecula.io.files import read, write

    if options.like is not None and not options.prune:
        raise InputError("--like is the exemplar for --prune: give --prune as well")
    steps = list(_steps(options))
    if not steps:
        words = "--prune, --connect, --smooth S, --thicken T, --floaters, --fill"
        raise InputError(f"nothing to do: give --connect, or another of {words}")
    check_target(options.out)
    part = read(options.file)
    for name, settings in steps:
        if name == "prune" and options.like is not None:
            settings = {**settings, "exemplar": _exemplar(options.like, part)}
        part = OPERATIONS[name](part, phase=options.phase, **settings)
    write(part, options.out)
    print(f"{options.out}: {part!r}")
    done = part.recipe.steps[-len(steps) :]
    if len(done) == 1:
        terminal.show_mapping(done[0]["report"])
    else:
        terminal.show_mapping(
            {f"{step['operation']}.{name}": value for step in done for name, value in step["report"].items()}
        )
    return 0


def _steps(options: argparse.Namespace) -> Iterator[tuple[str, dict[str, Any]]]:
    """The operations asked for, in their order: whole struts, one piece, its surface, its strength, what that left loose
    or closed."""
    if options.prune:
        yield "prune", {}
    if options.connect:
        yield "connect", {}
    if options.smooth is not None:
        yield "smooth", {"sigma": shared.numbers([options.smooth], name="--smooth")[0]}
    if options.thicken is not None:
        yield "thicken", {"thickness": shared.numbers([options.thicken], name="--thicken")[0]}
    if options.floaters:
        yield "remove_floaters", {}
    if options.fill:
        yield "fill_trapped", {}


def _exemplar(source: str, part: Any) -> Any:
    """The exemplar as the part is: segmented, with the part's spacing where its file states none."""
    from trabecula.flow import load_like

    return load_like(source, part)

"""`trabecula finish FILE --connect --out FILE`."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file and what to do with it."""
    parser.add_argument("file", metavar="FILE", help="volume of labels")
    parser.add_argument("--out", required=True, metavar="FILE", help="volume to write")
    parser.add_argument("--connect", action="store_true", help="join near parts, remove loose ones: one piece is left")
    parser.add_argument("--phase", help="phase that is finished (default: every phase but void)")


def run(options: argparse.Namespace) -> int:
    """Do the operations asked for, in the order connect."""
    from trabecula.core.errors import InputError
    from trabecula.finish import connect
    from trabecula.flow import check_target
    from trabecula.io.files import read, write

    if not options.connect:
        raise InputError("nothing to do: give --connect")
    check_target(options.out)
    part = connect(read(options.file), phase=options.phase)
    write(part, options.out)
    print(f"{options.out}: {part!r}")
    terminal.show_mapping(part.recipe.steps[-1]["report"])
    return 0

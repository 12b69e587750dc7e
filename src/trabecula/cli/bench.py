"""`trabecula bench [CASE ...]`."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from trabecula.core.errors import InputError

_ALONE = "gan_paper"

_PARTS = {
    "only": "of the cases named image and fusion: exemplars by name (default: all); of gan_paper: "
    "the file of the exemplar (default: sample:bone)",
    "methods": "of the cases named image: methods, with a preset as in mrf:fast; of those named "
    "big: methods (default: all)",
    "run": "of the case papers: results to measure and save again (default: the page from those "
    "that are saved)",
    "device": "of the case gan_paper: cuda or cpu (default: cuda)",
    "minutes": "of the case gan_paper: minutes of this command (default: 24)",
    "batch": "of the case gan_paper: crops an iteration (default: the paper's 100)",
    "state": "of the case gan_paper: folder of the checkpoint that the next command resumes from "
    "(default: state in the folder --out)",
    "side": "of the cases named image, fusion and big: voxels a side of what is made",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the cases, and the folder of their pictures."""
    parser.add_argument(
        "cases",
        nargs="*",
        metavar="CASE",
        help="case, or how several begin, such as texture (default: all; minutes)",
    )
    parser.add_argument("--list", action="store_true", help="name the cases")
    for option, what in _PARTS.items():
        parser.add_argument(f"--{option}", nargs="+", metavar=option.upper(), help=what)
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        help="where cases that draw put their pictures (default: none drawn)",
    )


def run(options: argparse.Namespace) -> int:
    """Run the cases in a process of their own, so that memory is measured alone."""
    words = [*options.cases, *(["--list"] if options.list else [])]
    places = (
        {}
        if options.out is None
        else {"TRABECULA_BENCH_OUT": os.fspath(Path(options.out).absolute())}
    )
    for option in _PARTS:
        if getattr(options, option):
            # names hold commas
            places[f"TRABECULA_BENCH_{option.upper()}"] = ";".join(getattr(options, option))
    # The one case that runs where other cases cannot be imported.
    alone = _ALONE if words == [_ALONE] else "run"
    command = [sys.executable, os.fspath(_script(alone)), *(words if alone == "run" else [])]
    return subprocess.run(command, env={**os.environ, **places}, check=False).returncode


def _script(name: str) -> Path:
    """Return a script of the checkout that the package is installed from."""
    import trabecula

    found = Path(trabecula.__file__).resolve().parents[2] / "benchmarks" / f"{name}.py"
    if not found.is_file():
        raise InputError(
            "the benchmarks live in the repository, not in the installed package: install from a "
            "checkout "
            "(pip install --editable .) and run trabecula bench there"
        )
    return found

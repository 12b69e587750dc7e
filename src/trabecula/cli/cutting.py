"""What `network` and `bodies` share: how a phase is cut, and the file."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared


def add_cutting(parser: argparse.ArgumentParser, *, default: str) -> None:
    """Add the phase, and the options of the watershed."""
    parser.add_argument("--phase", metavar="NAME", help=f"phase to cut (default: {default})")
    group = parser.add_argument_group("how the phase is cut at its necks")
    group.add_argument(
        "--periodic",
        nargs="*",
        metavar="AXIS",
        help="the volume repeats along z, y, x (no word: all of them)",
    )
    group.add_argument(
        "--smoothing",
        metavar="S",
        help="standard deviation of the Gaussian on the distance map, voxels (default 0.4)",
    )
    group.add_argument(
        "--reach",
        metavar="R",
        help="a peak is the highest voxel within so many voxels (default 4)",
    )


def cutting_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the watershed as `network` and `bodies` take them."""
    found: dict[str, Any] = {}
    for name in ("smoothing", "reach"):
        value = getattr(options, name)
        if value is not None:
            found[name] = shared.number(value, name=f"--{name}")
    if options.periodic is not None:
        found["periodic"] = shared.periodic(options.periodic)
    return found


def write_if_named(result: Any, options: argparse.Namespace) -> list[str] | None:
    """Write the result to --out; return the files."""
    return None if options.out is None else [str(path) for path in result.write(options.out)]

"""`trabecula rerun FILE`."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file, and the places of files of its recipe that have moved."""
    parser.add_argument("file", metavar="FILE", help="a file that this package wrote")
    parser.add_argument(
        "--exemplar", nargs="+", metavar="FILE", help="the recipe's first files, if they have moved"
    )
    for part in ("mask", "fixed", "known", "coarse", "like", "target"):
        parser.add_argument(
            f"--{part}", metavar="FILE", help=f"the file that was --{part}, if it has moved"
        )
    parser.add_argument(
        "--model", metavar="FILE", help="the trained model of the recipe, if it has moved"
    )


def run(options: argparse.Namespace) -> int:
    """Make the voxels again and compare their SHA-256."""
    from trabecula.core.recipe import digest
    from trabecula.pipeline.replay import rerun

    moved = {
        name: getattr(options, name)
        for name in ("exemplar", "mask", "fixed", "known", "coarse", "like", "target", "model")
    }
    image = rerun(options.file, **moved)
    print(f"{options.file}: the same voxels\nsha256 {digest(image.values)}")
    return 0

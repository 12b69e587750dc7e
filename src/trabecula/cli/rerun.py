"""`trabecula rerun FILE`."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file, and where the files of its recipe lie now."""
    parser.add_argument("file", metavar="FILE", help="a file that this package wrote")
    parser.add_argument(
        "--exemplar",
        nargs="+",
        metavar="FILE",
        help="where the recipe's first files lie now, if they have moved",
    )
    for part in ("mask", "fixed", "known", "target"):
        parser.add_argument(
            f"--{part}", metavar="FILE", help=f"where the file that was --{part} lies now"
        )
    parser.add_argument(
        "--model", metavar="FILE", help="where the trained model of the recipe lies now"
    )


def run(options: argparse.Namespace) -> int:
    """Make the voxels again and compare their SHA-256."""
    from trabecula.core.recipe import digest
    from trabecula.pipeline.replay import rerun

    moved = {
        name: getattr(options, name)
        for name in ("exemplar", "mask", "fixed", "known", "target", "model")
    }
    image = rerun(options.file, **moved)
    print(f"{options.file}: the same voxels\nsha256 {digest(image.values)}")
    return 0

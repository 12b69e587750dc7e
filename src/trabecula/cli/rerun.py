"""`trabecula rerun FILE`."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file, and where its exemplar lies now."""
    parser.add_argument("file", metavar="FILE", help="a file that this package wrote")
    parser.add_argument("--exemplar", metavar="FILE", help="where the recipe's first file lies now, if it has moved")


def run(options: argparse.Namespace) -> int:
    """Make the voxels again and compare their SHA-256."""
    from trabecula.core.recipe import digest
    from trabecula.flow import rerun

    image = rerun(options.file, exemplar=options.exemplar)
    print(f"{options.file}: the same voxels\nsha256 {digest(image.values)}")
    return 0

"""What is shown of a file that does not fit into memory: a coarser level of it, or only the box
that is asked for.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from trabecula.cli import options as shared


def add_memory(parser: argparse.ArgumentParser) -> None:
    """The budget."""
    parser.add_argument(
        "--memory",
        type=shared.gibibytes,
        metavar="GIB",
        help="memory that may be used (default: what is available); of a .zarr that needs more a coarser level is shown",
    )


def load_for_view(
    source: str, options: argparse.Namespace, *, need: Callable[[tuple[int, ...], int], int]
) -> Any:
    """As `load_exemplar`, of the finest level that fits where none is asked for; of a crop of
    labels nothing else is read.
    """
    from trabecula.io.levels import level_that_fits

    boxed = _box(source, options) if options.crop else None
    if boxed is not None:
        return boxed
    level = options.halvings
    if not options.crop:
        level = level_that_fits(source, need=need, memory=options.memory, level=level)
    return shared.load_exemplar(source, argparse.Namespace(**{**vars(options), "halvings": level}))


def _box(source: str, options: argparse.Namespace) -> Any:
    """The crop that was asked for of a store of labels that does not fit; else None."""
    from dataclasses import replace
    from math import prod

    from trabecula.pipeline.demo import slabs_if_large

    if options.threshold not in (None, "auto", "none"):
        return None
    volume = slabs_if_large(
        source, need=lambda shape: 2 * prod(shape), memory=options.memory, **shared.reading(options)
    )
    if volume is None:
        return None
    image = volume.centre(shared.box_of(options, source))
    corner = [(have - want) // 2 for have, want in zip(volume.shape, image.shape, strict=True)]
    return replace(
        image, recipe=volume.recipe.then("crop", image.values, size=image.shape, corner=corner)
    )

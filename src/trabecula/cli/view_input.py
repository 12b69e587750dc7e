"""Files too large to be shown: a coarser level of them, or only the box that is requested."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from trabecula.cli import options as shared


def add_memory(parser: argparse.ArgumentParser) -> None:
    """Add the memory budget."""
    shared.add_memory(parser, "of a .zarr that needs more a coarser level is shown")


def load_for_view(
    source: str, options: argparse.Namespace, *, need: Callable[[tuple[int, ...], int], int]
) -> Any:
    """Load an exemplar at the finest level that fits where no level is given; of a crop of labels
    read nothing else.
    """
    from trabecula.io.lazy import level_that_fits

    boxed = _box(source, options) if options.crop else None
    if boxed is not None:
        return boxed
    level = options.halvings
    if not options.crop:
        level = level_that_fits(source, need=need, memory=options.memory, level=level)
    return shared.load_exemplar(source, argparse.Namespace(**{**vars(options), "halvings": level}))


def slabs_for_page(source: str, options: argparse.Namespace) -> Any:
    """Open a store of labels of more voxels than a page draws, to be read in part; None where it is
    small, of another kind, or where a box or a level is asked for.
    """
    from contextlib import suppress
    from math import prod

    from trabecula.core.errors import InputError
    from trabecula.io.lazy import open_slabs, volume_shape
    from trabecula.view.page.fitting import LARGEST

    if options.crop or options.halvings is not None or options.threshold not in (None, "none"):
        return None
    shape = volume_shape(source)
    if shape is None or prod(shape) <= LARGEST:
        return None
    with suppress(InputError):  # not labels
        return open_slabs(source, **shared.reading(options))
    return None


def _box(source: str, options: argparse.Namespace) -> Any:
    """Read the crop of a store of labels that does not fit; None where there is no such crop."""
    from dataclasses import replace
    from math import prod

    from trabecula.io.lazy import slabs_if_large

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

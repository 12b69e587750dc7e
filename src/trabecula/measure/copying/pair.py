"""An exemplar and an image prepared for comparison: checked, lifted to three axes, coarsened,
mirrored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.copying.index import (
    Geometry,
    Neighbourhoods,
    Tree,
    build_tree,
    neighbourhoods_of,
    over_windows,
)


@dataclass(frozen=True)
class Pair:
    exemplar: np.ndarray  # (Z, Y, X) uint8
    image: np.ndarray
    geometry: Geometry
    lifted: int  # 1 where a 2-D image was made one plane thick
    shape: tuple[int, ...]  # of the image as given


def prepare_pair(
    exemplar: Image | ArrayLike, image: Image | ArrayLike, *, size: int | None, half: bool
) -> Pair:
    parts = [as_image(exemplar, name="the exemplar"), as_image(image)]
    for part, name in zip(parts, ("the exemplar", "the image"), strict=True):
        check_labels(part, name=name)
    first, second = parts
    if first.ndim != second.ndim:
        raise InputError(
            f"the exemplar is {first.ndim}-D, the image {second.ndim}-D: compare like with like"
        )
    if isinstance(exemplar, Image) and isinstance(image, Image) and first.phases != second.phases:
        raise InputError(
            f"the phases {'/'.join(first.phases)} and {'/'.join(second.phases)} do not "
            "correspond: name them alike"
        )
    width = 9 if first.ndim == 3 else 15
    if size is not None:
        width = int(as_number(size, name="size", low=3, high=15, whole=True))
    if width % 2 == 0:
        raise InputError(f"size={width} is even: a neighbourhood has a middle, give an odd size")
    lifted = 3 - first.ndim
    values = [
        np.ascontiguousarray(part.values if part.ndim == 3 else part.values[None]) for part in parts
    ]
    if half:
        values = [_coarse(part, lifted) for part in values]
    shares = np.bincount(values[0].ravel()) / values[0].size
    bits = max(1, int(max(part.max() for part in values)).bit_length())
    widths = (1,) * lifted + (width,) * first.ndim
    geometry = Geometry(widths, 2 if half else 1, bits, int(np.argmin(np.abs(shares - 0.5))))
    for array, name in zip(values, ("exemplar", "image"), strict=True):
        if any(side <= span for side, span in zip(array.shape, geometry.span, strict=True)):
            raise InputError(
                f"the {name} is {array.shape[lifted:]}: a neighbourhood spans "
                f"{max(geometry.span) + 1} voxels along every axis; "
                "give a larger image or a smaller size"
            )
    return Pair(values[0], values[1], geometry, lifted, second.shape)


def _coarse(values: np.ndarray, lifted: int) -> np.ndarray:
    """Return the most frequent label of the 2 x 2 x 2 voxels from each voxel on; the highest of
    equally frequent ones.
    """
    width = (1,) * lifted + (2,) * (3 - lifted)
    best = over_windows(np.add, (values == 0).astype(np.uint8), width, 1)
    chosen = np.zeros(best.shape, np.uint8)
    for label in range(1, int(values.max()) + 1):
        count = over_windows(np.add, (values == label).astype(np.uint8), width, 1)
        chosen[count >= best] = label
        best = np.maximum(best, count)
    return chosen


def exemplar_tree(pair: Pair, *, leaf: int = 1024) -> Tree:
    cubes = neighbourhoods_of(pair.exemplar, pair.geometry)
    if not cubes.counts.any():
        raise InputError(
            "no neighbourhood of the exemplar has an interface near its middle: give another crop"
        )
    return build_tree(cubes, pair.geometry, leaf=leaf)


class ExemplarTrees:
    """The trees of one exemplar, each grown once for all searches that share them, in any
    threads.
    """

    def __init__(self) -> None:
        self._grown: dict[Geometry, Tree] = {}
        self._lock = Lock()

    def of(self, pair: Pair) -> Tree:
        """Return the tree of the exemplar of a pair, whose image decides on the bits of labels."""
        with self._lock:
            if pair.geometry not in self._grown:
                self._grown[pair.geometry] = exemplar_tree(pair)
            return self._grown[pair.geometry]


def mirror_images(pair: Pair, mirrors: bool) -> Iterator[tuple[tuple[int, ...], Neighbourhoods]]:
    """Yield the image's neighbourhoods, flipped along every set of axes: flipping the exemplar
    comes to the same.
    """
    for chosen in product((False, True), repeat=3 - pair.lifted) if mirrors else ((),):
        flips = tuple(axis + pair.lifted for axis, flip in enumerate(chosen) if flip)
        yield (
            flips,
            neighbourhoods_of(np.ascontiguousarray(np.flip(pair.image, flips)), pair.geometry),
        )


def pad_to_image(values: np.ndarray, pair: Pair, fill: float) -> np.ndarray:
    """Return a value per corner as a value per voxel of the image, `fill` at the rim where no
    neighbourhood fits.
    """
    full = np.full((*(1,) * pair.lifted, *pair.shape, *values.shape[3:]), fill, values.dtype)
    near = [
        slice(first, first + side)
        for first, side in zip(pair.geometry.centre, values.shape[:3], strict=True)
    ]
    full[tuple(near)] = values
    return full[0] if pair.lifted else full

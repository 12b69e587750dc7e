"""Volumes of labels that are read some planes at a time: `Slabs`.

A slab is an Image of some whole planes. What is measured slab by slab carries from one to the next
what it still needs, so that no plane is read twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from trabecula.core.checks import as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image, check_labels, outline
from trabecula.core.recipe import Recipe
from trabecula.engine.chunking import Box, slices_of
from trabecula.engine.memory import Plan, as_budget, available_memory, check_budget


@dataclass(frozen=True, eq=False)
class Slabs:
    """A volume of labels that is read some planes at a time.

    Parameters
    ----------
    shape : three ints
        (Z, Y, X).
    read : callable
        `read(((z, z1), (y, y1), (x, x1)))` gives the labels of that box.
    spacing, unit, phases, recipe
        As of an Image.
    grain : int
        Planes of a chunk in the store: slabs that begin at a multiple of it are read
        at no extra cost.
    """

    shape: tuple[int, int, int]
    read: Callable[[Box], np.ndarray]
    spacing: tuple[float, ...]
    unit: str
    phases: tuple[str, ...]
    recipe: Recipe = field(default_factory=Recipe)
    grain: int = 1

    @property
    def kind(self) -> str:
        """Return "labels"."""
        return "labels"

    @property
    def ndim(self) -> int:
        """Return the number of axes: 3."""
        return 3

    def __repr__(self) -> str:
        return outline(self.shape, "labels", self.spacing, self.unit, self.phases)

    def planes(self, first: int, last: int) -> Image:
        """Return the planes `first` to `last` (exclusive) as an Image without a recipe."""
        return self._image(((first, last), (0, self.shape[1]), (0, self.shape[2])))

    def slabs(self, depth: int) -> Iterator[Image]:
        """Yield all planes, `depth` of them at a time."""
        for first in range(0, self.shape[0], depth):
            yield self.planes(first, min(first + depth, self.shape[0]))

    def centre(self, sides: Sequence[int]) -> Image:
        """Return a box in the middle; nothing else is read.

        Raises
        ------
        InputError
            The box is not inside the volume.
        """
        kept = as_shape(sides, name="crop")
        if any(side > length for side, length in zip(kept, self.shape, strict=True)):
            raise InputError(
                f"a crop of {kept} does not lie inside the image of {self.shape}: give a smaller "
                "one"
            )
        starts = [(length - side) // 2 for length, side in zip(self.shape, kept, strict=True)]
        return self._image(
            tuple((first, first + side) for first, side in zip(starts, kept, strict=True))
        )

    def _image(self, box: Box) -> Image:
        return Image(
            self.read(box), "labels", spacing=self.spacing, unit=self.unit, phases=self.phases
        )


def as_slabs(image: Image) -> Slabs:
    """Return a volume in memory as `Slabs`; nothing is copied.

    Raises
    ------
    InputError
        Not labels, or not 3-D.

    Examples
    --------
    >>> volume = slabs_of(Image(np.zeros((5, 4, 3), np.uint8), "labels"))
    >>> [slab.shape for slab in volume.slabs(2)]
    [(2, 4, 3), (2, 4, 3), (1, 4, 3)]
    """
    check_labels(image)
    if image.ndim != 3:
        raise InputError(
            f"slabs are cut from a volume, the image has shape {image.shape}: give 3 axes (z, y, x)"
        )

    def read(box: Box) -> np.ndarray:
        return image.values[slices_of(box)]

    z, y, x = image.shape
    return Slabs((z, y, x), read, image.spacing, image.unit, image.phases, image.recipe)


def depth_within(
    volume: Slabs, need: Callable[[int], Plan], *, memory: int | None = None, advice: str
) -> int:
    """Return the deepest slabs that fit into memory: many planes where there are few, whole grains
    where there are many.

    Parameters
    ----------
    volume : Slabs
    need : callable
        Depth of a slab -> forecast of the run.
    memory : int, optional
        Bytes. Default: what is available.
    advice : str
        What the user can change where no slab fits, as an imperative.

    Raises
    ------
    MemoryBudgetError
        Not even the thinnest slab fits.
    """
    budget = available_memory() if memory is None else as_budget(memory)
    whole, grain = volume.shape[0], volume.grain
    deep = [whole, *(many * grain for many in (8, 4, 2, 1) if many * grain < whole)]
    thin = [depth for depth in (64, 32, 16, 8, 4, 2, 1) if depth < min(deep)]
    for depth in [*deep, *thin]:
        if need(depth).peak <= budget:
            return depth
    check_budget(need(1), budget=budget, advice=advice)
    return 1

"""What `quilt` knows of its exemplars: how large a patch is, their period, and their words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.fields.local import windowed
from trabecula.measure.labelling import label_components
from trabecula.synth.quilt.bit_packing import Words, planes_for
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.period import agreement, periods_of, shifts_of
from trabecula.synth.shared.orient import Symmetry, apply_symmetry, symmetries

_LEAST, _MOST = 8, 24  # voxels of a patch that nobody chose
_OVER = 0.4  # share of a patch, or a period, that overlaps
_PER_DIP = 2.5  # such a patch over the distance at which agreement is least


@dataclass(frozen=True)
class Learnt:
    """The exemplars as one stack, with all that does not depend on a request.

    Attributes
    ----------
    images : tuple of Image
        Every exemplar in every orientation, as it is quilted from.
    stack : (S, Z, Y, X) uint8
        Their labels; 0 beyond a smaller one's end. Of pictures Z is 1.
    patch, overlap : int
    periods : three of float or None
    shifts : (S, 3) int64
        Voxels by which an exemplar's cells lie further than the first one's.
    words : Words
    """

    images: tuple[Image, ...]
    stack: np.ndarray
    patch: int
    overlap: int
    periods: tuple[float | None, ...]
    shifts: np.ndarray
    words: Words

    @classmethod
    def of(cls, exemplars: Sequence[Image], config: QuiltConfig) -> Learnt:
        """Learn from exemplars of labels of one material, all 2-D or all 3-D."""
        own = [
            _deep(labels) for labels in (cleaned(image, config.connected) for image in exemplars)
        ]
        periods = periods_of(own) if config.period == "auto" else (None, None, None)
        patch, overlap = sizes_for(own, config, periods)
        check_fits(exemplars, patch)
        turns = symmetries(
            config.orientations, ndim=exemplars[0].ndim, spacing=exemplars[0].spacing
        )
        turned = [_turned(labels, turn, exemplars[0].ndim) for labels in own for turn in turns]
        stack = _stacked(turned)
        planes = planes_for(max(int(labels.max()) for labels in own) + 1)
        words = Words.of(stack, patch=patch, overlap=overlap, planes=planes)
        flat = exemplars[0].ndim == 2
        images = tuple(
            replace(exemplars[0], values=labels[0] if flat else labels) for labels in turned
        )
        return cls(images, stack, patch, overlap, periods, shifts_of(turned, periods), words)

    @property
    def flat(self) -> bool:
        """Whether the exemplars are pictures."""
        return self.images[0].ndim == 2

    @property
    def measured(self) -> int:
        """Side of what a patch's descriptors are measured in, about its middle: the patch, or of a
        lattice as many whole periods as it holds. Part of a period more would count its struts, or
        its hollows, twice.
        """
        known = {period for period in self.periods[int(self.flat) :]}
        period = known.pop() if len(known) == 1 else None
        if period is None or period != round(period) or period > self.patch:
            return self.patch
        return self.patch // round(period) * round(period)

    @property
    def middle(self) -> int:
        """How far from a patch's first voxel what it is measured in has its middle, as
        `fields.measure` has it.
        """
        return (self.patch - self.measured) // 2 + (self.measured - 1) // 2

    def described(self, image: Image, name: str) -> np.ndarray:
        """A descriptor of every patch of an image, float32, one value a position."""
        off = (self.patch - self.measured) // 2
        field = windowed(image, size=self.measured, names=[name])[name]
        return field[tuple(slice(off, off + side - self.patch + 1) for side in image.shape)]

    @property
    def box(self) -> tuple[int, int, int]:
        """Voxels of a patch along every axis."""
        return (1 if self.flat else self.patch, self.patch, self.patch)

    @property
    def step(self) -> tuple[int, int, int]:
        """Voxels between patches along every axis."""
        by = self.patch - self.overlap
        return (1 if self.flat else by, by, by)

    @property
    def strides(self) -> tuple[int, int, int]:
        """Voxels of the stack from one exemplar, layer and row to the next."""
        _, depth, height, width = self.stack.shape
        return (depth * height * width, height * width, width)

    @property
    def counts(self) -> list[tuple[int, ...]]:
        """Positions of a patch along every axis of every exemplar."""
        shapes = [(1,) * (3 - image.ndim) + image.shape for image in self.images]
        return [
            tuple(side - p + 1 for side, p in zip(shape, self.box, strict=True)) for shape in shapes
        ]

    def piece(self, at: int) -> np.ndarray:
        """The patch that begins at a voxel of the stack."""
        by_source, by_layer, by_row = self.strides
        (source, at), (depth, height, width) = divmod(at, by_source), self.box
        (z, at) = divmod(at, by_layer)
        y, x = divmod(at, by_row)
        return np.ascontiguousarray(
            self.stack[source, z : z + depth, y : y + height, x : x + width]
        )


def void_of(phases: Sequence[str]) -> int:
    """The label that is void: the phase of that name, or 0."""
    return list(phases).index("void") if "void" in phases else 0


def cleaned(image: Image, connected: str) -> np.ndarray:
    """The labels without what could hang together with nothing: solid that floats inside the
    exemplar, where the solid is to be connected, and void that is closed in, where the void is.
    """
    labels, void = image.values, void_of(image.phases)
    if connected in ("solid", "both"):
        labels = np.where(_lost(labels != void), np.uint8(void), labels)
    if connected in ("void", "both"):
        lost = _lost(labels == void)
        solid = np.bincount(labels[labels != void], minlength=1)
        labels = np.where(lost, np.uint8(solid.argmax()), labels) if solid.any() else labels
    return labels


def _lost(inside: np.ndarray) -> np.ndarray:
    """Bodies that touch no face of the image, but the largest."""
    numbers, sizes = label_components(inside)
    lost = np.ones(len(sizes) + 1, np.bool_)
    lost[0] = False
    if len(sizes):
        lost[1 + int(sizes.argmax())] = False
    for axis in range(inside.ndim):
        for end in (0, -1):
            lost[numbers.take(end, axis)] = False
    return lost[numbers]


def sizes_for(
    own: Sequence[np.ndarray], config: QuiltConfig, periods: Sequence[float | None]
) -> tuple[int, int]:
    """Patch and overlap: what the settings say, or what suits the exemplars."""
    if config.patch:
        overlap = config.overlap or min(max(3, round(_OVER * config.patch)), config.patch - 1)
        return config.patch, overlap
    axes = [axis for axis in range(3) if own[0].shape[axis] > 1]
    shortest = min(labels.shape[axis] for labels in own for axis in axes)
    found = [period for period in periods if period is not None]
    if found:
        overlap = config.overlap or max(3, round(_OVER * max(found)))
        patch = round(max(found)) + overlap
    else:
        dips = [_dip(labels, axis) for labels in own for axis in axes]
        patch = round(_PER_DIP * sum(dips) / len(dips))
        overlap = 0
    patch = min(
        max(patch, _LEAST, config.overlap + 1),
        _MOST if not found else 64,
        max(_LEAST, shortest // 2),
    )
    return patch, min(config.overlap or overlap or max(3, round(_OVER * patch)), patch - 1)


def _dip(labels: np.ndarray, axis: int) -> int:
    """The distance at which two voxels agree least, before they agree more again: about half of a
    structure and its gap.
    """
    curve = agreement(labels, axis, max(1, labels.shape[axis] // 3))
    rises = np.flatnonzero(np.diff(curve) > 0)
    return int(rises[0]) if len(rises) else len(curve) - 1


def check_fits(exemplars: Sequence[Image], patch: int) -> None:
    """Raise where a patch has no room to lie in an exemplar in more than one place."""
    for exemplar in exemplars:
        if min(exemplar.shape) < patch + 1:
            raise InputError(
                f"the exemplar is {exemplar.shape}, a patch of {patch} needs at least {patch + 1} voxels along every axis: "
                "give a larger exemplar, or a smaller patch"
            )


def _deep(labels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(labels if labels.ndim == 3 else labels[None])


def _turned(labels: np.ndarray, turn: Symmetry, ndim: int) -> np.ndarray:
    own = labels if ndim == 3 else labels[0]
    return _deep(apply_symmetry(own[None], turn)[0])


def _stacked(turned: Sequence[np.ndarray]) -> np.ndarray:
    shape = np.max([labels.shape for labels in turned], axis=0)
    stack = np.zeros((len(turned), *shape), np.uint8)
    for own, labels in zip(stack, turned, strict=True):
        own[tuple(slice(side) for side in labels.shape)] = labels
    return stack

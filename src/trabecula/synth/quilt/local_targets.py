"""What is asked for at every place: targets of its box, summed as whole numbers, so that every
machine finds the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trabecula.core.seeds import generator
from trabecula.core.target import OF_A_PHASE, Target
from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.patch_library import Learnt, void_of
from trabecula.synth.quilt.windows import Frame

_UNIT = 1 << 20


def targets_at(
    target: Mapping[str, Target],
    frame: Frame,
    corner: tuple[int, ...],
    middle: int,
    mask: np.ndarray | None,
) -> dict[str, float]:
    """Every target in the middle of a box, the voxel `middle` further than its first along every
    axis; where that lies outside the volume or the form, the mean over what lies inside.
    """
    centre = tuple(
        at + (middle if side > 1 else 0) for at, side in zip(corner, frame.patch, strict=True)
    )
    inside = np.ones((1, 1, 1), np.bool_) if mask is None else mask
    return {
        name: _in_the_middle(value, inside, centre, corner, frame.patch, frame.wraps)
        if isinstance(value, np.ndarray)
        else float(value)
        for name, value in target.items()
    }


@dataclass(frozen=True)
class Own:
    """Where nothing is asked for: the first exemplar's own shares of phases, neighbourhood by
    neighbourhood.

    Without a target the best partners would be those of void, which fits to void anywhere. The
    fields run backwards, and back and forth beyond their ends, so that no place asks for what lies
    beside its neighbour's piece in the exemplar.
    """

    fields: dict[str, np.ndarray]
    offset: tuple[int, ...]

    @classmethod
    def of(cls, learnt: Learnt, seed: int) -> Own:
        """The fields, begun at a place that the seed chooses."""
        image = learnt.images[0]
        void = void_of(image.phases)
        names = [OF_A_PHASE + phase for label, phase in enumerate(image.phases) if label != void]
        found = {name: learnt.described(image, name) for name in names}
        deep = {
            name: field.reshape((1,) * (3 - field.ndim) + field.shape)
            for name, field in found.items()
        }
        return cls(
            deep, tuple(int(n) for n in generator(seed, "quilt/own").integers(0, 1 << 20, 3))
        )

    def at(self, corner: tuple[int, ...]) -> dict[str, float]:
        """The shares that a box is to have."""
        place = []
        for first, offset, side in zip(corner, self.offset, _shape(self.fields), strict=True):
            at = (offset - first) % max(1, 2 * side - 2)
            place.append(min(at, 2 * side - 2 - at) if side > 1 else 0)
        return {name: float(field[tuple(place)]) for name, field in self.fields.items()}


def _shape(fields: Mapping[str, np.ndarray]) -> tuple[int, ...]:
    """The shape that all fields have."""
    return next(iter(fields.values())).shape


@kernel
def _in_the_middle(field, inside, centre, corner, sides, wraps):
    """A mask of one voxel stands for none."""
    total, count = _summed(field, inside, centre, (1, 1, 1), wraps)
    if count == 0:
        total, count = _summed(field, inside, corner, sides, wraps)
    return total / (np.float64(_UNIT) * max(count, 1))


@inline
def _summed(field, inside, corner, sides, wraps):
    depth, height, width = field.shape
    masked = inside.size > 1
    total, count = np.int64(0), 0
    for k in range(sides[0]):
        z = corner[0] + k
        z = z % depth if wraps[0] else z
        for j in range(sides[1]):
            y = corner[1] + j
            y = y % height if wraps[1] else y
            if not (0 <= z < depth and 0 <= y < height):
                continue
            for i in range(sides[2]):
                x = corner[2] + i
                x = x % width if wraps[2] else x
                if 0 <= x < width and (not masked or inside[z, y, x]):
                    total += np.int64(np.rint(np.float64(field[z, y, x]) * _UNIT))
                    count += 1
    return total, count

"""The free voxels beside a known part: where bodies may be dropped, how far they are from the known
part's other phase, and a push that keeps them out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.packing.standing import Standing

_PUSH = 0.7  # of what a body lacks, a step
_TRIES = 12  # places that are drawn for a body, of which one is taken
_ROOM = 0.5  # of its size, that a body wants there: of more, the first planes came out too sparse


@dataclass(frozen=True, eq=False)
class Beside:
    """Free voxels beside a known part, in a box that repeats and has room beyond the faces of axes
    that do not: there the voxels of a face go on.

    Attributes
    ----------
    clear : (Z, Y, X) float32
        Edges from a free voxel to the other phase; negative where known, to the nearest free one.
    room : (Z, Y, X) float32
        Edges from a free voxel to what is known or in a body that stands.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    sides : (3,) float64
        Of the box, edges.
    standing : Standing
        Bodies that do not move.
    """

    clear: np.ndarray
    room: np.ndarray
    steps: np.ndarray
    sides: np.ndarray
    standing: Standing

    @property
    def volume(self) -> float:
        """Return the volume of the free part of the box."""
        return self._volume_of(self.clear > 0)

    @property
    def covered(self) -> float:
        """Return the volume of what bodies that stand have of the free part."""
        return self._volume_of((self.clear > 0) & (self.room == 0))

    def drop(self, sizes: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Return random places in the free part of the box for bodies of these sizes (n,): of some
        that are drawn the first with the most room, up to what is wanted.
        """
        wanted = _ROOM * sizes
        free = np.flatnonzero(self.clear > 0)
        lines = [self._lines(axis) for axis in range(3)]
        depth, height, width = (widths for _, widths in lines)
        weight = np.cumsum(np.einsum("z,y,x->zyx", depth, height, width).ravel()[free])
        places, most = np.zeros((len(sizes), 3)), np.full(len(sizes), -np.inf)
        for _ in range(_TRIES if len(free) else 0):
            chosen = np.searchsorted(weight, draw.random(len(sizes)) * weight[-1], side="right")
            own = free[np.minimum(chosen, len(free) - 1)]
            found = np.minimum(self.room.ravel()[own], wanted)
            within = draw.random((len(sizes), 3))
            for axis, i in enumerate(np.unravel_index(own, self.clear.shape)):
                starts, widths = lines[axis]
                within[:, axis] = starts[i] + within[:, axis] * widths[i]
            better = found > most
            places[better], most[better] = within[better], found[better]
        return np.asarray(np.mod(places, self.sides))

    def push(
        self, places: np.ndarray, shapes: np.ndarray, turns: np.ndarray, radii: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return moves (n, 3) of bodies out of the known part, and what they lack of their distance
        (n,).
        """
        moves, lacks = np.zeros_like(places), np.zeros(len(places))
        _push(places, shapes, turns, radii, self.clear, self.steps, self.sides, moves, lacks)
        return moves, lacks

    def _volume_of(self, inside: np.ndarray) -> float:
        widths = (self._lines(axis)[1] for axis in range(3))
        return float(np.einsum("zyx,z,y,x->", inside.astype(np.float64), *widths))

    def _lines(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where voxels along an axis begin, edges, and how wide they are: those at faces
        that do not repeat have the room beyond.
        """
        side, step = self.clear.shape[axis], self.steps[axis]
        starts, widths = np.arange(side) * step, np.full(side, step)
        beyond = 0.5 * (self.sides[axis] - side * step)
        starts[0] -= beyond
        widths[[0, -1]] += beyond if side > 1 else 2 * beyond
        return starts, widths


@inline
def _voxel(place, step, side, count):
    """Return the voxel of a place along an axis: beyond its last one the nearer face's."""
    at = int(place / step)
    if at < count:
        return at
    room = side - count * step
    return 0 if place - count * step > 0.5 * room else count - 1


@inline
def _slope(before, own, after, step):
    """Return a difference quotient of a field that changes by no more than `step` a voxel; where
    it does it jumps there.
    """
    before = min(max(before, own - step), own + step)
    after = min(max(after, own - step), own + step)
    return (after - before) / (2 * step)


@kernel
def _push(places, shapes, turns, radii, clear, steps, sides, moves, lacks):
    """Write the moves of bodies along the slope of `clear`, until they are as far as their radii,
    and what they lack.
    """
    Z, Y, X = clear.shape
    slope = np.empty(3)
    for i in range(len(places)):
        z = _voxel(places[i, 0], steps[0], sides[0], Z)
        y = _voxel(places[i, 1], steps[1], sides[1], Y)
        x = _voxel(places[i, 2], steps[2], sides[2], X)
        own = clear[z, y, x]
        around = (
            (clear[max(z - 1, 0), y, x], clear[min(z + 1, Z - 1), y, x]),
            (clear[z, max(y - 1, 0), x], clear[z, min(y + 1, Y - 1), x]),
            (clear[z, y, max(x - 1, 0)], clear[z, y, min(x + 1, X - 1)]),
        )
        length = 1e-9
        for axis in range(3):
            slope[axis] = _slope(around[axis][0], own, around[axis][1], steps[axis])
            length += slope[axis] ** 2
        length = np.sqrt(length)
        turn = turns[i]
        dz, dy, dx = -slope[0], -slope[1], -slope[2]
        wanted = radius_towards(
            radii[shapes[i]],
            turn[0, 0] * dz + turn[1, 0] * dy + turn[2, 0] * dx + 1e-12,
            turn[0, 1] * dz + turn[1, 1] * dy + turn[2, 1] * dx,
            turn[0, 2] * dz + turn[1, 2] * dy + turn[2, 2] * dx,
        )
        lacks[i] = max(wanted - own, 0.0)
        for axis in range(3):
            moves[i, axis] = _PUSH * lacks[i] * slope[axis] / length

"""The known part of a request: its bodies, and how deep its voxels lie in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.request import Request
from trabecula.measure.distance import distance_transform
from trabecula.synth.packing.arrangement import Arrangement
from trabecula.synth.packing.beside import Beside
from trabecula.synth.packing.drawing import draw_depth
from trabecula.synth.packing.scan_bodies import ScanBodies
from trabecula.synth.packing.standing import Standing, find_standing
from trabecula.synth.shared.known_part import WHOLE, move_shares
from trabecula.synth.shared.packed.depth import REACH
from trabecula.synth.shared.slabs import complement


@dataclass(frozen=True, eq=False)
class KnownBodies:
    """Known voxels of bodies, and of the other phase.

    Attributes
    ----------
    inside, other : (Z, Y, X) bool
        Known voxels of the bodies' phase, and of the other.
    known : (Z, Y, X) bool
        Both.
    wraps : three bool
        Axes that repeat.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    """

    inside: np.ndarray
    other: np.ndarray
    known: np.ndarray
    wraps: tuple[bool, ...]
    steps: np.ndarray

    @classmethod
    def of(cls, request: Request, label: int, steps: np.ndarray) -> KnownBodies:
        """Take the known voxels of a request whose bodies have a label."""
        assert request.fixed is not None and request.known is not None
        inside = request.known & (request.fixed.values == label)
        return cls(inside, request.known & ~inside, request.known, request.periodic, steps)

    def find_standing(self, bodies: ScanBodies, degree: int) -> Standing:
        """Complete the bodies that the joint cuts."""
        return find_standing(self.inside, self.known, self.steps, self.wraps, bodies, degree)

    def measure_free(self, sides: np.ndarray, standing: Standing) -> Beside:
        """Measure the free part of a box with these sides, edges."""
        clear = self._distance(complement(self.other))
        clear[self.known] = -self._distance(self.known)[self.known]
        # from the faces of voxels instead of their centres
        clear += np.where(self.known, np.float32(0.5), np.float32(-0.5))
        np.minimum(clear, np.float32(sides.max()), out=clear)
        turns = np.broadcast_to(np.eye(3), (len(standing.places), 3, 3))
        shapes = np.arange(len(standing.places))
        alone = Arrangement(standing.radii, shapes, turns, standing.places, sides, 0)
        covered = draw_depth(alone, self.known.shape, self.steps, 0) > 0
        room = self._distance(complement(self.known | covered))
        return Beside(clear, room, self.steps, sides, standing)

    def hold(self, field: np.ndarray, margin: np.ndarray) -> None:
        """Write how deep known voxels lie into a field whose voxel `margin` is the first: no deeper
        than is drawn where that agrees with what is known.
        """
        inner = tuple(
            slice(m, m + side) for m, side in zip(margin, self.known.shape, strict=True)
        )
        part = field[inner]
        for own, rest, sign in ((self.inside, self.other, 1), (self.other, self.inside, -1)):
            distance = self._distance(complement(rest))
            deep = np.minimum(distance[own] - np.float32(0.5), np.float32(REACH))
            drawn = sign * part[own]
            part[own] = sign * np.where(drawn > 0, np.minimum(deep, drawn), deep)
        for axis, wrap in enumerate(self.wraps):
            if wrap:
                lines = np.arange(field.shape[axis]) - margin[axis]
                again = lines % self.known.shape[axis] + margin[axis]
                field[...] = field.take(again, axis=axis)

    def steepen(self, depth: np.ndarray) -> None:
        """Raise what is deep beside known voxels, in place, and lower what is not: so that the
        interface there is where it is drawn, whatever share of the voxels is chosen.
        """
        shares = move_shares(self.known, self.wraps)
        free = shares > 0
        depth[free] *= np.float32(WHOLE) / shares[free]

    def _distance(self, inside: np.ndarray) -> np.ndarray:
        return distance_transform(inside, spacing=self.steps.tolist(), periodic=self.wraps)

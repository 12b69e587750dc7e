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
from trabecula.synth.packing.standing import find_standing
from trabecula.synth.shared.content.joints import spread_offset
from trabecula.synth.shared.slabs import complement

_UNIT, _MOST = 16, 7.5  # steps of an edge, and edges, that a byte holds


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

    def measure_free(
        self, bodies: ScanBodies, degree: int, separation: float, sides: np.ndarray
    ) -> Beside:
        """Complete the bodies that the joint cuts, and measure the free part of a box with these
        sides, edges.
        """
        part = (self.inside, self.known, self.steps, self.wraps)
        standing = find_standing(*part, bodies, degree, separation)
        clear = self._distance(complement(self.other))
        clear[self.known] = -self._distance(self.known)[self.known]
        # from the faces of voxels instead of their centres
        clear += np.where(self.known, np.float32(0.5), np.float32(-0.5))
        np.minimum(clear, np.float32(sides.max()), out=clear)
        turns = np.broadcast_to(np.eye(3), (len(standing.places), 3, 3))
        shapes = np.arange(len(standing.places))
        alone = Arrangement(standing.radii, shapes, turns, standing.places, sides, 0, 0)
        covered = draw_depth(alone, self.known.shape, self.steps, 0) > 0
        room = self._distance(complement(self.known | covered))
        return Beside(clear, room, self.steps, sides, standing)

    def join(self, depth: np.ndarray, level: float) -> np.ndarray:
        """Move the depth of free voxels so that its `level` is at the interface of what is known
        beside them: what known voxels are off is spread as a membrane.

        Returns
        -------
        depth : float32 array, (Z, Y, X)
            From the level, in 4096ths of an edge; far from what is known unchanged but for that.
        """
        votes = np.rint(np.clip(depth - np.float32(level), -_MOST, _MOST) * (_UNIT * 256))
        given = np.zeros(depth.shape, np.float32)
        for own, rest, sign in ((self.inside, self.other, 1), (self.other, self.inside, -1)):
            deep = self._distance(complement(rest))[own] - np.float32(0.5)
            drawn = sign * votes[own] / (_UNIT * 256)
            # what is hidden behind the joint may be nearer than what is known
            given[own] = sign * np.where(drawn > 0, np.minimum(deep, drawn), deep)
        bound = np.rint(np.clip(given, -_MOST, _MOST) * _UNIT).astype(np.int8)[None]
        moved = spread_offset(votes.astype(np.int16)[None], bound, bound, complement(self.known))
        return moved[0].astype(np.float32)

    def _distance(self, inside: np.ndarray) -> np.ndarray:
        return distance_transform(inside, spacing=self.steps.tolist(), periodic=self.wraps)

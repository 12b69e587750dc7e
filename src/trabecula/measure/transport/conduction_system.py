"""Laplace's equation on segments as a system of conjugate gradients, with multigrid as its
preconditioner.

The residual, directions and products are of the residual's type; the multigrid cycle is float32.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_each
from trabecula.measure.transport import conduction_segments as kernels
from trabecula.measure.transport.conduction_segments import ConductionSegments
from trabecula.measure.transport.finest_level import FinestLevel
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.sweep_parts import SweptNodes, cut_planes
from trabecula.numerics.krylov import Iterate, LinearSystem, Scalar
from trabecula.numerics.multigrid import Multigrid, k_cycle
from trabecula.numerics.vectors import add_to, dot, for_chunks

PART_SLOTS = 1 << 20
"""Of a part that is swept by itself, at least."""


class SegmentPart(NamedTuple):
    """Segments that are swept by themselves."""

    cut: SweptNodes
    planes: tuple[slice, slice]
    """Slots of the planes of other parts before and after them."""
    shifts: tuple[int, int]
    """Slots from these to where their values from before a sweep are kept."""


class ConductionLevel(FinestLevel):
    """The finest level of the multigrid."""

    part: ConductionSegments

    def __init__(self, part: ConductionSegments) -> None:
        def rows(number: np.ndarray, a: int, b: int) -> Graph:
            linked = part.table[a:b], part.code[a:b], part.coupling, part.place[a:b], number
            return Graph(*kernels.conduction_graph(*linked))

        super().__init__(part, rows)
        self.parts = parts_of(part)
        kept = sum(plane.stop - plane.start for one in self.parts for plane in one.planes)
        self._room = np.zeros(part.length + kept, np.float32)
        self.x: np.ndarray = self._room[: part.length]

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero."""

        def sweep(part: SegmentPart) -> None:
            edge, _ = part.cut.edges
            kernels.sweep_forward(*self.matrix(part), right, self.x, edge, self.part.slots)

        for_each(sweep, self.parts)
        return self.x

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        self.coarse[:] = 0.0

        def add(part: SegmentPart) -> None:
            edge, _ = part.cut.edges
            kernels.restrict(*self.matrix(part), self.aggregate, x, self.coarse, edge)

        for_each(add, self.parts)
        return self.coarse

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        for part in self.parts:
            for plane, shift in zip(part.planes, part.shifts, strict=True):
                self._room[plane.start + shift : plane.stop + shift] = x[plane]

        def sweep(part: SegmentPart) -> None:
            given = right, self._room, part.cut.edges, self.part.slots, part.shifts
            kernels.sweep_backward(*self.matrix(part), *given)

        for_each(sweep, self.parts)
        return x

    def matrix(self, part: SegmentPart) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rows of a part."""
        found, inside = self.part, part.cut.inside
        return found.table[inside], found.code[inside], found.coupling


def parts_of(part: ConductionSegments) -> list[SegmentPart]:
    """Return the parts of a grid; no block of 2x2x2 is cut."""
    planes = int(part.place[-1, 0]) + 1
    begins = np.searchsorted(part.place[:, 0], np.arange(planes + 1))
    slots = np.append(part.table[begins[:-1], 0], part.slots)
    slots[0] = 0
    cuts = cut_planes(begins, np.diff(slots), np.arange(planes) % 2 == 0, PART_SLOTS)

    def plane_of(segment: int) -> slice:
        """Return the slots of the plane in which a segment is; none beyond the grid."""
        if not 0 <= segment < len(part.table):
            return slice(0, 0)
        z = int(part.place[segment, 0])
        return slice(int(slots[z]), int(slots[z + 1]))

    found, end = [], part.length
    for cut in cuts:
        before, after = plane_of(cut.start - 1), plane_of(cut.stop)
        middle = end + before.stop - before.start
        found.append(SegmentPart(cut, (before, after), (end - before.start, middle - after.start)))
        end = middle + after.stop - after.start
    return found


class ConductionSystem(LinearSystem):
    """The matrix of segments and its multigrid.

    Fluxes are linear in the solution: they add up step by step, and the solution itself, twice as
    long as any other vector, is not kept.

    Attributes
    ----------
    flow : (Z + 1,) float64
        Flux through every section across the first axis, from 1 on the near end face to 0 on the
        far one.
    """

    def __init__(self, part: ConductionSegments, kind: type[np.floating[Any]]) -> None:
        self.part = part
        self.finest = finest = ConductionLevel(part)
        self.multigrid: Multigrid[Any] = Multigrid([finest, *finest.below], k_cycle)
        self.product = np.zeros(part.length, kind)
        self.flow, self._passed = np.zeros((2, int(part.place[-1, 0]) + 2))
        self.flow[0] = self.driven = part.driven

    def power_lost(self, at: Iterate) -> float:
        """Return the power put in less the power dissipated, x . residual.

        Of a residual r that every step takes `length * (matrix times direction)` from, this is the
        sum of `length * (direction . r)` less x . right-hand side.
        """
        return float(at.energy - (self.driven - self.flow[0]))

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector, in the same array at every call."""

        def work(one: SegmentPart) -> None:
            linked = *self.finest.matrix(one), self.part.place[one.cut.inside]
            kernels.multiply(*linked, vector, self.product, self._passed)

        for_each(work, self.finest.parts)
        return self.product

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution by a cycle of multigrid; where it is float32, in the same
        array at every call.
        """
        found = self.multigrid(np.asarray(residual, np.float32))
        return found.astype(residual.dtype, copy=False)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product."""
        return float(dot(a, b))

    def turn(self, direction: np.ndarray, factor: Scalar, z: np.ndarray) -> None:
        """Replace the direction by `z + factor * direction`."""
        for_chunks(lambda a, b: _turn(direction[a:b], factor, z[a:b]), len(direction))

    def advance(
        self, at: Iterate, length: Scalar, direction: np.ndarray, product: np.ndarray
    ) -> None:
        """Take `length * product` from the residual; the flow follows."""
        self.flow += length * self._passed
        add_to(at.residual, -length, product)


@kernel
def _turn(direction, factor, z):
    for i in range(len(direction)):
        direction[i] = z[i] + factor * direction[i]

"""The saddle point of slow flow on a marker-and-cell grid, and a step of SIMPLE as its
preconditioner.

The three velocities are coupled by the pressure alone, so each has a multigrid of its own. The
finest level of all four is matrix-free (`segments`); levels below it are graphs. Vectors are
(velocity along z, y, x, pressure), one after the other, each with the slots of its numbering.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trabecula.measure.transport import segments
from trabecula.measure.transport.finest_level import FinestLevel
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.segments import CellSegments, FaceSegments
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients
from trabecula.numerics.multigrid import Multigrid, k_cycle
from trabecula.numerics.vectors import dot

_ROUGH = 0.03  # residual at which mobility and first pressure are good enough


class MarkerGrid:
    """Unknowns of a marker-and-cell grid, as `segments` describes them, and its matrix."""

    def __init__(
        self, faces: tuple[FaceSegments, ...], cells: CellSegments, edges: np.ndarray, depth: int
    ) -> None:
        self.faces, self.cells, self.depth = faces, cells, depth
        self.volume = float(np.prod(edges))
        self.area = self.volume / edges
        self.pull = self.volume / edges**2
        lengths = [*(face.length for face in faces), cells.length]
        self.bounds = [0, *np.cumsum(lengths).tolist()]
        self.length = self.bounds[4]

    @classmethod
    def of(cls, active: np.ndarray, edges: np.ndarray) -> MarkerGrid:
        """Build the grid of the active voxels."""
        pull = float(np.prod(edges)) / edges**2
        number, count, nodes = segments.number_voxels(active)
        zeros = active.shape[2] + 2  # no segment is longer
        given: tuple[Any, ...]
        faces: list[FaceSegments] = []
        slots: list[np.ndarray] = []
        for axis in range(3):
            slot, most, total = segments.number_faces(active, axis)
            given = (number, slot, axis, pull, most, count)
            found = segments.find_face_segments(*given, 0)[4]
            table, diagonal, share, place, _ = segments.find_face_segments(*given, found)
            both, code = np.unique(diagonal + 1j * share, return_inverse=True)
            kinds = code.astype(np.uint16), both.real.copy(), both.imag.copy()
            faces.append(FaceSegments(table, *kinds, place, most, total, most + zeros))
            slots.append(slot)
        ends = np.array([face.slots for face in faces])
        around = (number, *_three(slots), count, ends)
        found = segments.find_cell_segments(*around, 0)[2]
        table, place, _ = segments.find_cell_segments(*around, found)
        cells = CellSegments(table, place, count, nodes, count + zeros)
        return cls(tuple(faces), cells, edges, len(active))

    def parts(self, x: np.ndarray) -> list[np.ndarray]:
        """Return the velocities along z, y and x, and the pressure, as views of a vector."""
        return [x[a:b] for a, b in zip(self.bounds, self.bounds[1:], strict=False)]

    def apply(self, x: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Set `out` to the whole matrix times (velocity, pressure)."""
        out[:] = 0.0
        *velocity, pressure = self.parts(x)
        *force, outflow = self.parts(out)
        for axis, face in enumerate(self.faces):
            segments.momentum(
                *face[:4],
                self.pull,
                self.area[axis],
                velocity[axis],
                pressure,
                force[axis],
            )
        segments.divergence(self.cells.table, self.area, *_three(velocity), outflow)
        return out

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """Return the whole matrix times (velocity, pressure)."""
        return self.apply(x, np.empty_like(x))

    def driving_force(self) -> np.ndarray:
        """Return the force of a pressure of 1 on the near end face, on the velocity along z."""
        face = self.faces[0]
        near = np.where(face.place[:, 0] == 0, self.area[0], 0.0)
        return segments.spread(face.table, near, face.length)

    def section_flows(self, x: np.ndarray) -> np.ndarray:
        """Return the flow through every section across the first axis."""
        face = self.faces[0]
        flow = segments.section_flows(face.table, face.place, self.parts(x)[0], self.depth + 1)
        return np.asarray(flow * self.area[0])


class FaceLevel(FinestLevel):
    """The viscous matrix of one velocity."""

    def __init__(self, face: FaceSegments, pull: np.ndarray) -> None:
        self.matrix = (*face[:4], pull)

        def rows(number: np.ndarray, a: int, b: int) -> Graph:
            linked = face.table[a:b], face.code[a:b], face.diagonal, face.share, face.place[a:b]
            return Graph(*segments.face_graph(*linked, pull, number))

        super().__init__(face, rows)

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero."""
        segments.sweep_faces_forward(*self.matrix, right, self.x)
        return self.x

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        table, code, _, share, pull = self.matrix
        segments.restrict_faces(table, code, share, pull, self.aggregate, x, self.coarse)
        return self.coarse

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        segments.sweep_faces_backward(*self.matrix, right, x)
        return x


class CellLevel(FinestLevel):
    """The matrix of div (mobility grad)."""

    def __init__(self, cells: CellSegments, mobility: list[np.ndarray], pull: np.ndarray) -> None:
        self.matrix = (cells.table, pull, *_three(mobility))

        def rows(number: np.ndarray, a: int, b: int) -> Graph:
            linked = cells.table[a:b], cells.place[a:b], *_three(mobility), pull, number
            return Graph(*segments.cell_graph(*linked))

        super().__init__(cells, rows)
        self.inverse = np.zeros(cells.slots, np.float32)
        segments.cell_inverse(*self.matrix, self.inverse)

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero."""
        segments.sweep_cells_forward(*self.matrix, self.inverse, right, self.x)
        return self.x

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        segments.restrict_cells(*self.matrix, self.aggregate, x, self.coarse)
        return self.coarse

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        segments.sweep_cells_backward(*self.matrix, self.inverse, right, x)
        return x


class _RoughSystem(LinearSystem):
    """A matrix on segments and its multigrid as a system of `conjugate_gradients`."""

    def __init__(
        self, multiply: Callable[[np.ndarray, np.ndarray], object], multigrid: Multigrid[Any]
    ) -> None:
        self.multiply, self.multigrid = multiply, multigrid

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector."""
        out = np.zeros_like(vector)
        self.multiply(vector, out)
        return out

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution by a cycle of multigrid."""
        return _cycle(self.multigrid, residual, np.zeros_like(residual))

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product."""
        return float(dot(a, b))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve to a residual of a few per cent; `right` is overwritten."""
        limit = _ROUGH**2 * dot(right, right)

        def accept(at: Iterate) -> bool:
            return bool(dot(at.residual, at.residual) <= limit)

        x = np.zeros_like(right)
        return conjugate_gradients(self, x, right, accept=accept, most=20, flexible=True)[0].x


class SimplePreconditioner:
    """A step of SIMPLE; calling it maps a residual to a correction, float32."""

    def __init__(self, flow: MarkerGrid) -> None:
        self.flow = flow
        self.velocity: list[Multigrid[Any]] = []
        self.mobility: list[np.ndarray] = []
        nothing = np.zeros(flow.cells.length, np.float32)
        for axis, face in enumerate(flow.faces):
            level = FaceLevel(face, flow.pull)
            self.velocity.append(_multigrid(level))
            share = segments.spread(face.table, face.share[face.code] * flow.volume, face.length)

            def multiply(x: np.ndarray, out: np.ndarray, axis: int = axis) -> None:
                face = flow.faces[axis]
                segments.momentum(*face[:4], flow.pull, 0.0, x, nothing, out)

            mobility = _RoughSystem(multiply, self.velocity[axis]).solve(share.copy())
            np.divide(mobility, share, out=mobility, where=share > 0)
            self.mobility.append(mobility)
        self.pull = flow.area**2
        self.pressure = _multigrid(CellLevel(flow.cells, self.mobility, self.pull))
        self.outflow = np.zeros(flow.cells.length, np.float32)

    def start(self, kind: Any) -> np.ndarray:
        """Return velocity and pressure of Darcy's law, of this type."""
        flow = self.flow
        x = np.zeros(flow.length, np.float32)
        *velocity, pressure = flow.parts(x)
        velocity[0][:] = self.mobility[0] * flow.driving_force()
        segments.divergence(flow.cells.table, flow.area, *_three(velocity), self.outflow)

        def multiply(p: np.ndarray, out: np.ndarray) -> None:
            segments.multiply_cells(flow.cells.table, self.pull, *_three(self.mobility), p, out)

        pressure[:] = _RoughSystem(multiply, self.pressure).solve(-self.outflow)
        self._push(pressure, velocity)
        return x.astype(kind, copy=False)

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Return a correction of velocity and pressure."""
        flow = self.flow
        x = np.zeros(flow.length, np.float32)
        *velocity, pressure = flow.parts(x)
        *force, outflow = flow.parts(residual)
        for u, cycle, right in zip(velocity, self.velocity, force, strict=True):
            _cycle(cycle, right, u)
        segments.divergence(flow.cells.table, flow.area, *_three(velocity), self.outflow)
        np.subtract(outflow, self.outflow, out=self.outflow, casting="same_kind")
        _cycle(self.pressure, self.outflow, pressure)
        self._push(pressure, velocity)
        pressure += self.outflow * np.float32(1.0 / flow.volume)
        return x

    def _push(self, pressure: np.ndarray, velocity: list[np.ndarray]) -> None:
        for axis, face in enumerate(self.flow.faces):
            area = self.flow.area[axis]
            segments.push(face.table, area, pressure, self.mobility[axis], velocity[axis])


def _multigrid(level: Any) -> Multigrid[Any]:
    return Multigrid([level, *level.below], k_cycle)


def _cycle(multigrid: Multigrid[Any], right: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return x, zeros so far, as the result of a cycle."""
    finest = multigrid.levels[0]
    finest.x = x
    found = multigrid(np.asarray(right, np.float32))
    finest.x = np.zeros(0, np.float32)
    return found


def _three(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z, y, x = parts
    return z, y, x

"""Cells, their nodes, and the sparse operator assembled from them.

The same structures serve every grid of the multigrid: on the finest a cell is a voxel, on coarser
ones a connected part of the solid in a block of voxels. Operators are rows of 3x3 blocks. On the
finest grid rows are shared: a row depends only on the materials of the eight voxels around its
node, so that two phases need at most 255 of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.mechanics.elements import CORNERS

LOADS = 6
"""Load cases solved at once: the last axis of every vector."""

LEAST = 2000  # nodes that are worth a thread
_CHUNK = 4096  # nodes that are summed together: fixed, so that sums do not depend on the threads
_SINGLE = 20_000  # nodes from which on a coarse operator is kept in float32: it only preconditions


@dataclass(frozen=True)
class Cells:
    """The cells of one grid."""

    nodes: np.ndarray
    """(cells, 8) uint32: the node at every corner."""
    kind: np.ndarray
    """(cells,) int32: which of the matrices."""
    matrices: np.ndarray
    """(kinds, 8, 8, 3, 3)."""
    position: np.ndarray
    """(cells, 3) int32: index along every axis."""
    lines: tuple[np.ndarray, ...]
    """For every axis where its cells begin, and the last ends."""
    count: int
    """Number of nodes."""


@dataclass(frozen=True)
class BlockOperator:
    """Row n holds the blocks `values[start[n] ...]` for the nodes `neighbour[first[n] .. first[n +
    1]]`.
    """

    first: np.ndarray
    neighbour: np.ndarray
    start: np.ndarray
    values: np.ndarray
    inverse: np.ndarray
    """(rows, 3, 3): inverse of the diagonal block of every distinct row."""
    row: np.ndarray
    """(count,): the distinct row of every node."""

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.row)


def node_mask(solid: np.ndarray) -> np.ndarray:
    """Mark the nodes of a periodic grid, at the first corner of every voxel, that some voxel of the
    solid touches.
    """
    nodes = np.zeros(solid.shape, bool)
    for corner in CORNERS:
        nodes |= np.roll(solid, corner, axis=(0, 1, 2))
    return nodes


def voxel_cells(kind: np.ndarray, matrices: np.ndarray, edges: tuple[float, ...]) -> Cells:
    """Return the cells of the voxels with `kind` >= 0 on a periodic grid; nodes that touch none of
    them do not exist.
    """
    position = np.argwhere(kind >= 0).astype(np.int32)
    number = np.cumsum(node_mask(kind >= 0).ravel(), dtype=np.int64) - 1
    nodes = np.empty((len(position), 8), np.uint32)
    for c, corner in enumerate(CORNERS):
        z, y, x = ((position + corner) % kind.shape).T
        nodes[:, c] = number[(z.astype(np.int64) * kind.shape[1] + y) * kind.shape[2] + x]
    lines = tuple(np.arange(side + 1) * edge for side, edge in zip(kind.shape, edges, strict=True))
    return Cells(
        nodes, kind[kind >= 0].astype(np.int32), matrices, position, lines, int(number[-1]) + 1
    )


def row_keys(cells: Cells) -> np.ndarray:
    """Assign a number to every node of a grid of voxels: equal where the eight voxels around it are of equal
    kinds.
    """
    keys = np.zeros(cells.count, np.int64)
    base = len(cells.matrices) + 1
    for c in range(8):
        # one cell per node and corner
        keys[cells.nodes[:, c]] += (cells.kind.astype(np.int64) + 1) * base**c
    return keys


def assemble(
    cells: Cells, incidence: tuple[np.ndarray, np.ndarray], keys: np.ndarray | None = None
) -> BlockOperator:
    """Assemble the operator of the cells; nodes of equal `keys` share their row."""
    first, neighbour = _adjacency(cells.nodes, *incidence)
    if keys is None:
        chosen, row = np.arange(cells.count), np.arange(cells.count, dtype=np.int32)
    else:
        _, chosen, inverse = np.unique(keys, return_index=True, return_inverse=True)
        row = inverse.astype(np.int32)
    width = np.diff(first.astype(np.int64))[chosen]
    begin = np.concatenate([[0], np.cumsum(width)])
    exact = keys is not None or cells.count < _SINGLE
    values = np.zeros((begin[-1], 3, 3), np.float64 if exact else np.float32)
    diagonal = np.zeros((len(chosen), 3, 3))
    _fill(
        chosen,
        cells.nodes,
        cells.kind,
        cells.matrices,
        *incidence,
        first,
        neighbour,
        begin,
        values,
        diagonal,
    )
    inverse = np.linalg.pinv(diagonal, rcond=1e-9, hermitian=True)
    return BlockOperator(first, neighbour, begin[row].astype(np.uint32), values, inverse, row)


def incidence(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Return for every node its (cell * 8 + corner): where they begin, and all of them, by corner
    and then by cell.
    """
    return _incidence(cells.nodes, cells.count)


def apply(operator: BlockOperator, vector: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Set `out` = operator times `vector`, (count, 3, LOADS)."""
    o = operator
    for_slabs(
        lambda a, b: _apply(o.first, o.neighbour, o.start, o.values, vector, out, a, b),
        operator.count,
        least=LEAST,
    )
    return out


def relax(operator: BlockOperator, residual: np.ndarray, pace: float, x: np.ndarray) -> None:
    """Add pace * D^-1 residual to x; D holds the diagonal blocks."""
    o = operator
    for_slabs(
        lambda a, b: _relax(o.inverse, o.row, residual, pace, x, a, b), operator.count, least=LEAST
    )


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the inner product of every load case, (LOADS,): by chunks of fixed size, added in
    order.
    """
    parts = np.zeros((-(-len(a) // _CHUNK), LOADS))
    for_slabs(lambda i, j: _dots(a, b, parts, i, j), len(parts), least=1)
    return parts.sum(axis=0)


@kernel
def _incidence(nodes, count):
    first = np.zeros(count + 1, np.int64)
    for cell in range(len(nodes)):
        for c in range(8):
            first[nodes[cell, c] + 1] += 1
    for n in range(count):
        first[n + 1] += first[n]
    at = first[:-1].copy()
    entry = np.empty(len(nodes) * 8, np.int64)
    for c in range(8):
        for cell in range(len(nodes)):
            n = nodes[cell, c]
            entry[at[n]] = cell * 8 + c
            at[n] += 1
    return first, entry


@kernel
def _adjacency(nodes, begin, entry):
    """Return for every node the nodes of its cells, in the order of the incidence."""
    count = len(begin) - 1
    seen = np.full(count, -1, np.int64)
    first = np.zeros(count + 1, np.uint32)
    neighbour = np.empty(0, np.uint32)
    for fill in range(2):
        total = 0
        for n in range(count):
            for i in range(begin[n], begin[n + 1]):
                for b in range(8):
                    m = nodes[entry[i] // 8, b]
                    if seen[m] != n + fill * count:
                        seen[m] = n + fill * count
                        if fill:
                            neighbour[total] = m
                        total += 1
            first[n + 1] = total
        if not fill:
            neighbour = np.empty(total, np.uint32)
    return first, neighbour


@kernel
def _fill(chosen, nodes, kind, matrices, begin, entry, first, neighbour, start, values, diagonal):
    slot = np.zeros(len(begin) - 1, np.int64)
    blocks = np.zeros((1, 3, 3))
    for row in range(len(chosen)):
        n = chosen[row]
        width = first[n + 1] - first[n]
        if width > len(blocks):
            blocks = np.zeros((width, 3, 3))
        blocks[:] = 0
        for k in range(width):
            slot[neighbour[first[n] + k]] = k
        for i in range(begin[n], begin[n + 1]):
            cell, a = entry[i] // 8, entry[i] % 8
            for b in range(8):
                blocks[slot[nodes[cell, b]]] += matrices[kind[cell], a, b]
        for k in range(width):
            values[start[row] + k] = blocks[k]
        diagonal[row] = blocks[slot[n]]


@kernel
def _apply(first, neighbour, start, values, u, y, begin, end):
    # Three rows of accumulators and nine scalars of a block: the form that LLVM keeps in registers
    # (twice as fast).
    s0, s1, s2 = np.zeros(LOADS), np.zeros(LOADS), np.zeros(LOADS)
    for n in range(begin, end):
        for j in range(LOADS):
            s0[j] = 0.0
            s1[j] = 0.0
            s2[j] = 0.0
        at = start[n]
        for k in range(first[n], first[n + 1]):
            v = u[neighbour[k]]
            block = values[at]
            at += 1
            b00, b01, b02 = block[0, 0], block[0, 1], block[0, 2]
            b10, b11, b12 = block[1, 0], block[1, 1], block[1, 2]
            b20, b21, b22 = block[2, 0], block[2, 1], block[2, 2]
            for j in range(LOADS):
                p, q, r = v[0, j], v[1, j], v[2, j]
                s0[j] += b00 * p + b01 * q + b02 * r
                s1[j] += b10 * p + b11 * q + b12 * r
                s2[j] += b20 * p + b21 * q + b22 * r
        for j in range(LOADS):
            y[n, 0, j] = s0[j]
            y[n, 1, j] = s1[j]
            y[n, 2, j] = s2[j]


@kernel
def _relax(inverse, row, residual, pace, x, begin, end):
    for n in range(begin, end):
        d, r, t = inverse[row[n]], residual[n], x[n]
        for i in range(3):
            for j in range(LOADS):
                t[i, j] += pace * (d[i, 0] * r[0, j] + d[i, 1] * r[1, j] + d[i, 2] * r[2, j])


@kernel
def _dots(a, b, parts, begin, end):
    for part in range(begin, end):
        for n in range(part * _CHUNK, min((part + 1) * _CHUNK, len(a))):
            for i in range(3):
                for j in range(LOADS):
                    parts[part, j] += a[n, i, j] * b[n, i, j]

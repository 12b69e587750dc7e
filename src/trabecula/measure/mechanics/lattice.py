"""Cells and their nodes, on the grid of voxels and on coarser ones.

The same structures serve every grid of the multigrid: on the finest a cell is a voxel, on coarser
ones a connected part of the solid in a block of 2x2x2 cells. A strut and its neighbour across a
thin gap may be in one block. Were they one coarse cell, the coarse grid would tie them together,
and the solver would stall on thin structures; so a block becomes as many cells as it has connected
parts, each with nodes of its own (Dick, Georgii, Westermann 2011, doi:10.1109/TVCG.2010.268). Nodes
of neighbouring coarse cells are one where a node of the finer grid, common to both, depends on
them. Displacements of the coarse grid are then displacements of the finer one as well, and its
operator is the finer one's, seen by them (Galerkin).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.mechanics.elements import CORNERS
from trabecula.measure.union_find import join, number_trees

LOADS = 6
"""Load cases solved at once: the last axis of every vector."""

LEAST = 2000  # nodes that are worth a thread


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
class Interpolation:
    """From coarse nodes to fine ones, and its transpose: rows of indices and weights."""

    down: tuple[np.ndarray, np.ndarray, np.ndarray]
    """first, coarse node, weight; a row per fine node."""
    up: tuple[np.ndarray, np.ndarray, np.ndarray]
    """first, fine node, weight; a row per coarse node."""


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
    """Assign a number to every node of a grid of voxels: equal where its eight voxels are of equal
    kinds.
    """
    keys = np.zeros(cells.count, np.int64)
    base = len(cells.matrices) + 1
    for c in range(8):
        # one cell per node and corner
        keys[cells.nodes[:, c]] += (cells.kind.astype(np.int64) + 1) * base**c
    return keys


def incidence(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Return for every node its (cell * 8 + corner): where they begin, and all of them, by corner
    and then by cell.
    """
    return _incidence(cells.nodes, cells.count)


def coarsen(
    cells: Cells, incidence: tuple[np.ndarray, np.ndarray], *, repeated: bool
) -> tuple[Cells, Interpolation]:
    """Return the coarser cells, and the interpolation from their nodes.

    `repeated` says that blocks with equal kinds of cells have equal matrices (only on the grid of
    voxels).
    """
    upper = _upper(cells.lines)
    block = cells.position >> 1
    sides = [len(line) for line in cells.lines]
    number = (block[:, 0].astype(np.int64) * sides[1] + block[:, 1]) * sides[2] + block[:, 2]
    parent, total = _split_blocks(number, *incidence)
    weights = _weights(cells.position, upper)
    corner, count = _corners(parent, total, weights, *incidence)
    down = _interpolation(parent, corner, weights, *incidence)
    position = np.empty((total, 3), np.int32)
    position[parent] = block
    kind, chosen = (
        _kinds(cells, parent, total) if repeated else (np.arange(total), np.arange(total))
    )
    target = np.full(total, -1)
    target[chosen] = np.arange(len(chosen))
    matrices = np.zeros((len(chosen), 8, 8, 3, 3))
    _galerkin(target[parent], cells.kind, cells.matrices, weights, matrices)
    lines = tuple(np.append(line[:-1:2], line[-1]) for line in cells.lines)
    coarse = Cells(
        corner.astype(np.uint32), kind.astype(np.int32), matrices, position, lines, count
    )
    return coarse, Interpolation(down, _transpose(down[0], down[1], down[2], count))


def gather(
    rows: tuple[np.ndarray, np.ndarray, np.ndarray],
    vector: np.ndarray,
    out: np.ndarray,
    *,
    add: bool,
) -> None:
    """Set out (+)= rows times vector."""
    for_slabs(lambda a, b: _gather(*rows, vector, out, add, a, b), len(out), least=LEAST)


def _upper(lines: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return, for both ends of a fine cell, the weight of the upper end of the coarse cell around
    it, (3, most cells, 2).
    """
    table = np.zeros((3, max(len(line) for line in lines), 2))
    for axis, line in enumerate(lines):
        cell = np.arange(len(line) - 1)
        low, high = line[cell & ~1], line[np.minimum((cell & ~1) + 2, len(line) - 1)]
        for end in (0, 1):
            table[axis, cell, end] = (line[cell + end] - low) / (high - low)
    return table


def _weights(position: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return `upper` of every cell, (cells, 3, 2) float64."""
    return np.ascontiguousarray(
        np.stack([upper[axis, position[:, axis]] for axis in range(3)], axis=1)
    )


def _kinds(cells: Cells, parent: np.ndarray, total: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the kind of every coarse cell, and one cell of each kind: the same kinds of cells in
    the same places.
    """
    base = len(cells.matrices) + 1
    key = np.zeros(total, np.int64)
    place = (cells.position & 1) @ np.array([4, 2, 1])
    for c in range(8):
        here = place == c
        key[parent[here]] += (cells.kind[here].astype(np.int64) + 1) * base**c
    # The last block of an odd side is one cell wide.
    sides = np.array([len(line) - 1 for line in cells.lines])
    narrow = ((cells.position == sides - 1) & (sides % 2 == 1)) @ np.array([4, 2, 1])
    marks = np.zeros(total, np.int64)
    marks[parent] = narrow
    _, chosen, kind = np.unique(key + marks * base**8, return_index=True, return_inverse=True)
    return kind, chosen


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
def _split_blocks(block, first, entry):
    """Join the cells of one block that share a node to one coarse cell."""
    tree = np.arange(len(block))
    for n in range(len(first) - 1):
        for i in range(first[n], first[n + 1]):
            for j in range(first[n], i):
                if block[entry[i] // 8] == block[entry[j] // 8]:
                    join(tree, entry[i] // 8, entry[j] // 8)
    return number_trees(tree)


@inline
def _supports(weights, cell, corner, s):
    """Return the weight of the s-th corner of the coarse cell at this corner of a fine cell; 0
    where it has none.
    """
    weight = 1.0
    for axis in range(3):
        bit = corner >> (2 - axis) & 1
        high = weights[cell, axis, bit]
        weight *= high if s >> (2 - axis) & 1 else 1.0 - high
    return weight


@kernel
def _corners(parent, total, weights, first, entry):
    """Return the coarse node at every corner of every coarse cell."""
    tree = np.arange(total * 8)
    support = np.empty(8, np.int64)
    for n in range(len(first) - 1):
        for i in range(first[n], first[n + 1]):
            cell, corner = entry[i] // 8, entry[i] % 8
            # Supporting corners come in the same order in every cell around the node: axes along
            # which it is between two coarse planes are the same for all of them.
            count = 0
            for s in range(8):
                if _supports(weights, cell, corner, s) > 0.0:
                    if i == first[n]:
                        support[count] = parent[cell] * 8 + s
                    else:
                        join(tree, support[count], parent[cell] * 8 + s)
                    count += 1
    number, count = number_trees(tree)
    return number.reshape(total, 8), count


@kernel
def _interpolation(parent, corner, weights, first, entry):
    count = len(first) - 1
    begin = np.zeros(count + 1, np.int64)
    index = np.empty(count * 8, np.uint32)
    weight = np.empty(count * 8)
    total = 0
    for n in range(count):
        cell, c = entry[first[n]] // 8, entry[first[n]] % 8
        for s in range(8):
            w = _supports(weights, cell, c, s)
            if w > 0.0:
                index[total] = corner[parent[cell], s]
                weight[total] = w
                total += 1
        begin[n + 1] = total
    return begin, index[:total].copy(), weight[:total].copy()


@kernel
def _transpose(first, index, weight, count):
    begin = np.zeros(count + 1, np.int64)
    for k in range(len(index)):
        begin[index[k] + 1] += 1
    for n in range(count):
        begin[n + 1] += begin[n]
    at = begin[:-1].copy()
    other = np.empty(len(index), np.uint32)
    value = np.empty(len(index))
    for n in range(len(first) - 1):
        for k in range(first[n], first[n + 1]):
            other[at[index[k]]] = n
            value[at[index[k]]] = weight[k]
            at[index[k]] += 1
    return begin, other, value


@kernel
def _gather(first, index, weight, vector, out, add, begin, end):
    for n in range(begin, end):
        row = out[n]
        if not add:
            row[:] = 0.0
        for k in range(first[n], first[n + 1]):
            v = vector[index[k]]
            w = weight[k]
            for i in range(v.shape[0]):
                for j in range(v.shape[1]):
                    row[i, j] += w * v[i, j]


@kernel
def _galerkin(target, kind, matrices, weights, out):
    """Add W^T K W to out[target] for every fine cell, W[a, A] the weight of coarse corner A at fine
    corner a.
    """
    half = np.zeros((8, 8, 3, 3))
    w = np.zeros((8, 8))
    for cell in range(len(target)):
        if target[cell] < 0:
            continue
        matrix = matrices[kind[cell]]
        for a in range(8):
            for s in range(8):
                w[a, s] = _supports(weights, cell, a, s)
        half[:] = 0.0
        for b in range(8):
            for s in range(8):
                if w[b, s] > 0.0:
                    for a in range(8):
                        for i in range(3):
                            for j in range(3):
                                half[a, s, i, j] += w[b, s] * matrix[a, b, i, j]
        for a in range(8):
            for s in range(8):
                if w[a, s] > 0.0:
                    for t in range(8):
                        for i in range(3):
                            for j in range(3):
                                out[target[cell], s, t, i, j] += w[a, s] * half[a, t, i, j]

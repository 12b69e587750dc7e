"""The marker-and-cell grid as segments of runs along x, and its kernels.

Pressure in voxels, velocity on the faces between two voxels of the void (Harlow and Welch 1965,
doi:10.1063/1.1761178). Everything is multiplied by the volume of a control volume, so that the
viscous matrix is symmetric. Pressure falls along the first axis from 1 on the near end face to 0
on the far one. A face has the place of the voxel above it. Of the faces of the image only those at
the ends of the first axis carry an unknown, with half a control volume.

Unknowns are numbered in raster order, pressures and the velocities along every axis for
themselves. Before the first run and after each is a slot that is always 0, so that the neighbours
of i along x are i - 1 and i + 1, at the ends of a run as well. A *segment* is a part of a run in
which each neighbour along y and z is the next one of a run as well, or missing throughout: of the
neighbours only the first is stored. A missing one is a run of zeros at the end of the vector. So a
node costs a few bytes instead of six indices and weights, and loops have no branches.

Of a velocity the first columns are its own first slot, the length, the neighbours at y - 1, y + 1,
z - 1 and z + 1, and the voxels below and above the face; of a pressure the same six, the faces
below and above along z, along y, and the one below along x (the next one is above).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row

FACE_COLUMNS, CELL_COLUMNS = 8, 11


class FaceSegments(NamedTuple):
    """The faces across one axis that carry a velocity."""

    table: np.ndarray  # int32, (S, FACE_COLUMNS)
    code: np.ndarray  # uint16, (S,)
    diagonal: np.ndarray  # float64, by code: of the viscous matrix
    share: np.ndarray  # float64, by code: of a whole control volume
    place: np.ndarray  # int16, (S, 3): of the first
    slots: int
    """Slots before the zeros."""
    nodes: int
    """Velocities."""
    length: int
    """Of a vector, with the zeros."""


class CellSegments(NamedTuple):
    """The voxels that carry a pressure."""

    table: np.ndarray  # int32, (S, CELL_COLUMNS)
    place: np.ndarray  # int16, (S, 3): of the first
    slots: int
    nodes: int
    length: int


@kernel
def number_voxels(active):
    """Give every active voxel its slot, 0 elsewhere; return also the number of slots, and of
    voxels.
    """
    depth, height, width = active.shape
    slot = np.zeros(active.shape, np.int32)
    at, nodes = 1, 0
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if active[z, y, x]:
                    slot[z, y, x] = at
                    at += 1
                    nodes += 1
                elif x > 0 and active[z, y, x - 1]:
                    at += 1
            if active[z, y, width - 1]:
                at += 1
    return slot, at, nodes


@kernel
def number_faces(active, axis):
    """Give every face across an axis its slot, (Z + 1, Y, X), 0 where it is a wall or a mirror;
    return also the number of slots, and of faces.
    """
    depth, height, width = active.shape
    slot = np.zeros((depth + 1, height, width), np.int32)
    at, nodes = 1, 0
    for z in range(depth + 1):
        for y in range(height):
            before = False
            for x in range(width):
                if z == depth:
                    found = axis == 0 and active[z - 1, y, x]
                elif not active[z, y, x]:
                    found = False
                elif axis == 0:
                    found = z == 0 or active[z - 1, y, x]
                elif axis == 1:
                    found = y > 0 and active[z, y - 1, x]
                else:
                    found = x > 0 and active[z, y, x - 1]
                if found:
                    slot[z, y, x] = at
                    at += 1
                    nodes += 1
                elif before:
                    at += 1
                before = found
            if before:
                at += 1
    return slot, at, nodes


@inline
def slot_at(slot, z, y, x):
    """Return a slot, 0 beyond the grid."""
    depth, height, width = slot.shape
    if z < 0 or y < 0 or x < 0 or z >= depth or y >= height or x >= width:
        return 0
    return slot[z, y, x]


@inline
def continues(table, at, found, zero):
    """Return whether what was found continues the columns of a segment."""
    length = table[at, 1]
    for c in range(2, table.shape[1]):
        begin = table[at, c]
        if found[c] == zero[c]:
            if begin != zero[c]:
                return False
        elif begin == zero[c] or found[c] != begin + length:
            return False
    return True


@inline
def _is_void(cells, z, y, x):
    return z >= 0 and z < cells.shape[0] and cells[z, y, x] > 0


@inline
def _face_diagonal(cells, slot, axis, pull, z, y, x):
    """Return the diagonal of the viscous matrix at a face; see `find_face_segments`."""
    depth, height, width = cells.shape
    at_end = axis == 0 and (z == 0 or z == depth)
    diagonal = 0.0
    for n in range(6):
        d = n >> 1
        step = 2 * (n & 1) - 1
        u, v, w = z + step * (d == 0), y + step * (d == 1), x + step * (d == 2)
        outside = u < 0 or v < 0 or w < 0 or v >= height or w >= width
        outside = outside or u >= depth + (axis == 0)
        if outside and ((d == axis and axis == 0) or (d != axis and d != 0)):
            continue
        strength = pull[d] * (0.5 if at_end and d != 0 else 1.0)
        if d != axis and (outside or slot[u, v, w] == 0):
            open_beside = not outside and (
                _is_void(cells, u, v, w)
                or _is_void(cells, u - (axis == 0), v - (axis == 1), w - (axis == 2))
            )
            strength *= 1.0 if open_beside else 2.0
        diagonal += strength
    return diagonal


@kernel
def find_face_segments(cells, slot, axis, pull, zero, zero_cell, segments):
    """Find the segments of the faces across an axis, and the viscous matrix's diagonal; with 0
    `segments` only count them. pull[d] is volume / edge[d]**2.

    Ahead and behind, a wall face is a velocity of 0 at the distance of an edge. Beside, the wall
    is half an edge off where both voxels are solid; where one of them is, the face between them
    is a velocity of 0 at the distance of an edge (a wall at half of it over half of the face holds
    staircases more firmly, but makes round grains too large: the drag of a simple cubic array of
    spheres 3 to 5 % too high at radii of 6 to 12 voxels, against 1 %). Tangential velocity is 0 on
    the end faces; side faces are mirrors.
    """
    depth, height, width = cells.shape
    table = np.zeros((max(segments, 1), FACE_COLUMNS), np.int32)
    diagonal, share = np.zeros(len(table)), np.ones(len(table))
    place = np.zeros((len(table), 3), np.int16)
    found, empty = np.zeros(FACE_COLUMNS, np.int32), np.zeros(FACE_COLUMNS, np.int32)
    empty[2:6] = zero
    empty[6:8] = zero_cell
    fill = segments > 0
    total = 0
    for z in range(slot.shape[0]):
        for y in range(height):
            last = 0.0
            fresh = True
            for x in range(width):
                i = slot[z, y, x]
                if i == 0:
                    fresh = True
                    continue
                found[0] = i
                found[2] = slot_at(slot, z, y - 1, x)
                found[3] = slot_at(slot, z, y + 1, x)
                found[4] = slot_at(slot, z - 1, y, x)
                found[5] = slot_at(slot, z + 1, y, x)
                found[6] = slot_at(cells, z - (axis == 0), y - (axis == 1), x - (axis == 2))
                found[7] = slot_at(cells, z, y, x)
                for c in range(2, FACE_COLUMNS):
                    if found[c] == 0:
                        found[c] = empty[c]
                own = _face_diagonal(cells, slot, axis, pull, z, y, x)
                at = total - 1 if fill else 0
                if not fresh and own == last and continues(table, at, found, empty):
                    table[at, 1] += 1
                    continue
                at = total if fill else 0
                total += 1
                copy_row(table[at], found)
                table[at, 1] = 1
                fresh, last = False, own
                diagonal[at] = own
                share[at] = 0.5 if axis == 0 and (z == 0 or z == depth) else 1.0
                place[at, 0], place[at, 1], place[at, 2] = z, y, x
    return table, diagonal, share, place, total


@kernel
def find_cell_segments(cells, along_z, along_y, along_x, zero, zeros, segments):
    """Find the segments of the voxels; with 0 `segments` only count them. `zeros` are the first
    zeros of the three velocities.
    """
    depth, height, width = cells.shape
    table = np.zeros((max(segments, 1), CELL_COLUMNS), np.int32)
    place = np.zeros((len(table), 3), np.int16)
    found, empty = np.zeros(CELL_COLUMNS, np.int32), np.zeros(CELL_COLUMNS, np.int32)
    empty[2:6] = zero
    empty[6:8] = zeros[0]
    empty[8:10] = zeros[1]
    empty[10] = zeros[2]
    fill = segments > 0
    total = 0
    for z in range(depth):
        for y in range(height):
            fresh = True
            for x in range(width):
                i = cells[z, y, x]
                if i == 0:
                    fresh = True
                    continue
                found[0] = i
                found[2] = slot_at(cells, z, y - 1, x)
                found[3] = slot_at(cells, z, y + 1, x)
                found[4] = slot_at(cells, z - 1, y, x)
                found[5] = slot_at(cells, z + 1, y, x)
                found[6] = along_z[z, y, x]
                found[7] = along_z[z + 1, y, x]
                found[8] = along_y[z, y, x]
                found[9] = slot_at(along_y, z, y + 1, x)
                # The slot before the first face of a run is 0, as the one after the last.
                found[10] = along_x[z, y, x]
                if found[10] == 0:
                    after = slot_at(along_x, z, y, x + 1)
                    found[10] = after - 1 if after > 0 else zeros[2]
                for c in range(2, 10):
                    if found[c] == 0:
                        found[c] = empty[c]
                at = total - 1 if fill else 0
                if not fresh and continues(table, at, found, empty):
                    table[at, 1] += 1
                    continue
                at = total if fill else 0
                total += 1
                fresh = False
                copy_row(table[at], found)
                table[at, 1] = 1
                place[at, 0], place[at, 1], place[at, 2] = z, y, x
    return table, place, total


@kernel
def spread(table, values, length):
    """Return a vector with the value of its segment at every node, float32."""
    out = np.zeros(length, np.float32)
    for s in range(len(table)):
        for i in range(table[s, 0], table[s, 0] + table[s, 1]):
            out[i] = values[s]
    return out


@kernel
def compact_numbers(table, length):
    """Return the numbers of nodes without the slots between runs, by slot, -1 elsewhere; and how
    many there are.
    """
    number = np.full(length, -1, np.int32)
    nodes = np.int32(0)
    for s in range(len(table)):
        for i in range(table[s, 0], table[s, 0] + table[s, 1]):
            number[i] = nodes
            nodes += 1
    return number, nodes


@kernel
def take_by_slot(number, values):
    """Replace the number of every node by its value, those of no node by 0."""
    for i in range(len(number)):
        number[i] = values[number[i]] if number[i] >= 0 else 0


@kernel
def face_graph(table, code, diagonal, share, place, pull, number):
    """Return the rows of the viscous matrix of one velocity for some segments as the fields of a
    Graph; number is that of a slot's node, -1 where it has none.
    """
    nodes = table[:, 1].sum()
    start, middle = np.zeros(nodes + 1, np.int64), np.zeros(nodes, np.int64)
    own, where = np.zeros(nodes), np.empty((nodes, 3), np.int16)
    weight, other = np.empty(0, np.float32), np.empty(0, np.int32)
    for fill in range(2):
        used = n = 0
        for s in range(len(table)):
            weights = (pull[0], pull[1] * share[code[s]], pull[2] * share[code[s]])
            for k in range(table[s, 1]):
                i = table[s, 0] + k
                own[n] = diagonal[code[s]]
                where[n, 0], where[n, 1], where[n, 2] = place[s, 0], place[s, 1], place[s, 2] + k
                for side in range(6):
                    if side == 3:
                        middle[n] = used
                    d = side if side < 3 else 5 - side
                    step = 1 if side < 3 else 0
                    if d == 2:
                        j = i - 1 if side < 3 else i + 1
                    else:
                        j = table[s, (5 if d == 0 else 3) - step] + k
                    if number[j] >= 0:
                        if fill:
                            other[used], weight[used] = number[j], weights[d]
                        used += 1
                n += 1
                start[n] = used
        if not fill:
            weight, other = np.empty(used, np.float32), np.empty(used, np.int32)
    return start, middle, other, weight, own, where


@kernel
def cell_graph(table, place, mobility_z, mobility_y, mobility_x, pull, number):
    """Return the rows of the matrix of div (mobility grad) over the voxels of some segments as the
    fields of a Graph; pull[d] is area**2.
    """
    nodes = table[:, 1].sum()
    start, middle = np.zeros(nodes + 1, np.int64), np.zeros(nodes, np.int64)
    own, where = np.zeros(nodes), np.empty((nodes, 3), np.int16)
    weight, other = np.empty(0, np.float32), np.empty(0, np.int32)
    for fill in range(2):
        used = n = 0
        for s in range(len(table)):
            for k in range(table[s, 1]):
                i = table[s, 0] + k
                own[n] = 0.0
                where[n, 0], where[n, 1], where[n, 2] = place[s, 0], place[s, 1], place[s, 2] + k
                for side in range(6):
                    if side == 3:
                        middle[n] = used
                    d = side if side < 3 else 5 - side
                    low = 1 if side < 3 else 0
                    if d == 2:
                        j = i + 1 - 2 * low
                        strength = mobility_x[table[s, 10] + k + 1 - low]
                    elif d == 1:
                        j = table[s, 3 - low] + k
                        strength = mobility_y[table[s, 9 - low] + k]
                    else:
                        j = table[s, 5 - low] + k
                        strength = mobility_z[table[s, 7 - low] + k]
                    strength = np.float32(strength * pull[d])
                    own[n] += strength
                    if number[j] >= 0:
                        if fill:
                            other[used], weight[used] = number[j], strength
                        used += 1
                n += 1
                start[n] = used
        if not fill:
            weight, other = np.empty(used, np.float32), np.empty(used, np.int32)
    return start, middle, other, weight, own, where


@kernel
def momentum(table, code, diagonal, share, pull, area, velocity, pressure, force):
    """Set the viscous force less the force of the pressure on every face across one axis."""
    kind = force.dtype.type
    wz, push_area = kind(pull[0]), kind(area)
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        own, wy, wx = (
            kind(diagonal[code[s]]),
            kind(pull[1] * share[code[s]]),
            kind(pull[2] * share[code[s]]),
        )
        i = velocity[first - 1 : first + length + 1]
        a, b = velocity[table[s, 2] :], velocity[table[s, 3] :]
        c, d = velocity[table[s, 4] :], velocity[table[s, 5] :]
        low, high = pressure[table[s, 6] :], pressure[table[s, 7] :]
        out = force[first : first + length]
        for k in range(length):
            out[k] = (
                own * i[k + 1]
                - wx * (i[k] + i[k + 2])
                - wy * (a[k] + b[k])
                - wz * (c[k] + d[k])
                - push_area * (low[k] - high[k])
            )


@kernel
def divergence(table, area, along_z, along_y, along_x, out):
    """Set the outflow of every voxel."""
    kind = out.dtype.type
    az, ay, ax = kind(area[0]), kind(area[1]), kind(area[2])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        z0, z1 = along_z[table[s, 6] :], along_z[table[s, 7] :]
        y0, y1 = along_y[table[s, 8] :], along_y[table[s, 9] :]
        x0 = along_x[table[s, 10] :]
        row = out[first : first + length]
        for k in range(length):
            row[k] = az * (z1[k] - z0[k]) + ay * (y1[k] - y0[k]) + ax * (x0[k + 1] - x0[k])


@kernel
def push(table, area, pressure, mobility, velocity):
    """Add mobility * area * (pressure below a face - pressure above it) to a velocity."""
    factor = velocity.dtype.type(area)
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        low, high = pressure[table[s, 6] :], pressure[table[s, 7] :]
        m, u = mobility[first : first + length], velocity[first : first + length]
        for k in range(length):
            u[k] += m[k] * factor * (low[k] - high[k])


@kernel
def sweep_faces_forward(table, code, diagonal, share, pull, right, x):
    """Sweep once by Gauss-Seidel from zero: only neighbours before a node have a value yet."""
    wz = np.float32(pull[0])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        inverse = np.float32(1.0 / diagonal[code[s]])
        wy, wx = (
            np.float32(pull[1] * share[code[s]]),
            np.float32(pull[2] * share[code[s]]) * inverse,
        )
        a, c = x[table[s, 2] :], x[table[s, 4] :]
        r, out = right[first : first + length], x[first : first + length]
        for k in range(length):
            out[k] = (r[k] + wy * a[k] + wz * c[k]) * inverse
        before = x[first - 1]
        for k in range(length):
            before = out[k] + wx * before
            out[k] = before


@kernel
def restrict_faces(table, code, share, pull, aggregate, x, coarse):
    """Set the residual of a forward sweep, summed over aggregates: the later neighbours'."""
    coarse[:] = 0.0
    wz = np.float32(pull[0])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        wy, wx = np.float32(pull[1] * share[code[s]]), np.float32(pull[2] * share[code[s]])
        b, d, e = x[table[s, 3] :], x[table[s, 5] :], x[first + 1 :]
        at = aggregate[first : first + length]
        for k in range(length):
            coarse[at[k]] += wx * e[k] + wy * b[k] + wz * d[k]


@kernel
def sweep_faces_backward(table, code, diagonal, share, pull, right, x):
    """Sweep once by Gauss-Seidel, the last node first."""
    wz = np.float32(pull[0])
    for s in range(len(table) - 1, -1, -1):
        first, length = table[s, 0], table[s, 1]
        inverse = np.float32(1.0 / diagonal[code[s]])
        wy, wx = np.float32(pull[1] * share[code[s]]), np.float32(pull[2] * share[code[s]])
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[table[s, 4] :], x[table[s, 5] :]
        i = x[first - 1 : first + length + 1]
        r = right[first : first + length]
        after = i[length + 1]
        for k in range(length - 1, -1, -1):
            rest = r[k] + wy * (a[k] + b[k]) + wz * (c[k] + d[k])
            after = (rest + wx * (i[k] + after)) * inverse
            i[k + 1] = after


@kernel
def prolong(table, aggregate, correction, x):
    """Add the correction of its aggregate to every node."""
    for s in range(len(table)):
        for i in range(table[s, 0], table[s, 0] + table[s, 1]):
            x[i] += correction[aggregate[i]]


@kernel
def cell_inverse(table, pull, mz, my, mx, out):
    """Set the inverse of the diagonal of the pressure's matrix."""
    for s in range(len(table)):
        z0, z1, y0, y1 = table[s, 6], table[s, 7], table[s, 8], table[s, 9]
        x0 = table[s, 10]
        for k in range(table[s, 1]):
            total = pull[0] * (mz[z0 + k] + mz[z1 + k]) + pull[1] * (my[y0 + k] + my[y1 + k])
            total += pull[2] * (mx[x0 + k] + mx[x0 + k + 1])
            out[table[s, 0] + k] = 1.0 / total


@kernel
def multiply_cells(table, pull, mz, my, mx, x, out):
    """Set the matrix of div (mobility grad) times x."""
    wz, wy, wx = np.float32(pull[0]), np.float32(pull[1]), np.float32(pull[2])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        i = x[first - 1 : first + length + 1]
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[table[s, 4] :], x[table[s, 5] :]
        z0, z1 = mz[table[s, 6] :], mz[table[s, 7] :]
        y0, y1, x0 = my[table[s, 8] :], my[table[s, 9] :], mx[table[s, 10] :]
        row = out[first : first + length]
        for k in range(length):
            v = i[k + 1]
            row[k] = (
                wz * (z0[k] * (v - c[k]) + z1[k] * (v - d[k]))
                + wy * (y0[k] * (v - a[k]) + y1[k] * (v - b[k]))
                + wx * (x0[k] * (v - i[k]) + x0[k + 1] * (v - i[k + 2]))
            )


@kernel
def sweep_cells_forward(table, pull, mz, my, mx, inverse, right, x):
    """Sweep once by Gauss-Seidel from zero."""
    wz, wy, wx = np.float32(pull[0]), np.float32(pull[1]), np.float32(pull[2])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        a, c = x[table[s, 2] :], x[table[s, 4] :]
        z0, y0, x0 = mz[table[s, 6] :], my[table[s, 8] :], mx[table[s, 10] :]
        d = inverse[first : first + length]
        r, out = right[first : first + length], x[first : first + length]
        for k in range(length):
            out[k] = (r[k] + wy * y0[k] * a[k] + wz * z0[k] * c[k]) * d[k]
        before = x[first - 1]
        for k in range(length):
            before = out[k] + wx * x0[k] * d[k] * before
            out[k] = before


@kernel
def restrict_cells(table, pull, mz, my, mx, aggregate, x, coarse):
    """Set the residual of a forward sweep, summed over aggregates."""
    coarse[:] = 0.0
    wz, wy, wx = np.float32(pull[0]), np.float32(pull[1]), np.float32(pull[2])
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        b, d, e = x[table[s, 3] :], x[table[s, 5] :], x[first + 1 :]
        z1, y1, x1 = mz[table[s, 7] :], my[table[s, 9] :], mx[table[s, 10] + 1 :]
        at = aggregate[first : first + length]
        for k in range(length):
            coarse[at[k]] += wx * x1[k] * e[k] + wy * y1[k] * b[k] + wz * z1[k] * d[k]


@kernel
def sweep_cells_backward(table, pull, mz, my, mx, inverse, right, x):
    """Sweep once by Gauss-Seidel, the last node first."""
    wz, wy, wx = np.float32(pull[0]), np.float32(pull[1]), np.float32(pull[2])
    for s in range(len(table) - 1, -1, -1):
        first, length = table[s, 0], table[s, 1]
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[table[s, 4] :], x[table[s, 5] :]
        z0, z1 = mz[table[s, 6] :], mz[table[s, 7] :]
        y0, y1, x0 = my[table[s, 8] :], my[table[s, 9] :], mx[table[s, 10] :]
        i = x[first - 1 : first + length + 1]
        own, r = inverse[first : first + length], right[first : first + length]
        after = i[length + 1]
        for k in range(length - 1, -1, -1):
            rest = r[k] + wy * (y0[k] * a[k] + y1[k] * b[k])
            rest += wz * (z0[k] * c[k] + z1[k] * d[k])
            after = (rest + wx * (x0[k] * i[k] + x0[k + 1] * after)) * own[k]
            i[k + 1] = after


@kernel
def section_flows(table, place, velocity, sections):
    """Sum the velocities through every section across the first axis."""
    flow = np.zeros(sections)
    for s in range(len(table)):
        total = 0.0
        for i in range(table[s, 0], table[s, 0] + table[s, 1]):
            total += velocity[i]
        flow[place[s, 0]] += total
    return flow

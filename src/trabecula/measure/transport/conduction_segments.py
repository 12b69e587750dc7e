"""The voxels that conduct as segments of runs along x, and the kernels of Laplace's equation on
them.

Finite volumes, one unknown a voxel, seven points. Unknowns are numbered in raster order with a slot
that is always 0 before the first run and after each (see `segments`). A *segment* is a part of a
run in which all voxels have one label, and each neighbour along y and z one label as well, or is
missing throughout. So the couplings of a segment are a few numbers, which many segments share: a
node costs a few bytes instead of six indices and weights.

The columns of a segment are its first slot, its length, and the first of the neighbours at y - 1,
y + 1, z - 1 and z + 1; a missing one is a run of zeros at the end of the vector. Those of its
couplings are the ones to these four, the one along x inside the segment, the ones to the voxel
before the first and after the last, those to end faces, the sum of these and of the first four, and
the one that a voxel of its kind has to an end face.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.measure.transport.segments import continues, number_voxels, slot_at

COLUMNS = 6
_INSIDE, _BEFORE, _AFTER, _TO_ENDS, _BESIDE, _END = 4, 5, 6, 7, 8, 9


class ConductionSegments(NamedTuple):
    """The voxels that conduct and their couplings."""

    table: np.ndarray  # int32, (S, COLUMNS)
    code: np.ndarray  # int32, (S,)
    coupling: np.ndarray  # float64, by code: (C, 10)
    place: np.ndarray  # int16, (S, 3): of the first
    slots: int
    """Slots before the zeros."""
    nodes: int
    """Voxels."""
    length: int
    """Of a vector, with the zeros."""

    @property
    def matrix(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the arrays that a product needs."""
        return self.table, self.code, self.coupling

    def driving_flux(self, kind: type[np.floating[Any]]) -> np.ndarray:
        """Return the flux into every voxel from 1 on the near end face, where all voxels are 0."""
        out = np.zeros(self.length, kind)
        set_driving_flux(*self.matrix, self.place, out)
        return out

    def section_fluxes(self, x: np.ndarray) -> np.ndarray:
        """Return the flux through every section across the first axis."""
        return np.asarray(sum_sections(*self.matrix, self.place, x))

    @classmethod
    def of(
        cls,
        labels: np.ndarray,
        active: np.ndarray,
        kinds: np.ndarray,
        face: np.ndarray,
        end: np.ndarray,
    ) -> ConductionSegments:
        """Find the segments of the active voxels.

        Labels that conduct have kinds[label] of 1 to 255. face[a, b, d] is the coupling of kinds a
        and b along axis d, end[a] to an end face; those of kind 0 are 0.
        """
        slot, slots, nodes = number_voxels(active)
        given = (labels, kinds, slot, slots)
        found = find_segments(*given, 0, 1)[3]
        most = int(kinds.max())
        codes = min(found, 4 * most * (most + 1) ** 6)
        table, code, place, _, keys = find_segments(*given, found, 1 << (2 * codes).bit_length())
        zeros = labels.shape[2] + 2  # no segment is longer
        return cls(table, code, couplings_of(keys, face, end), place, slots, nodes, slots + zeros)


@inline
def _kind_at(labels, kinds, slot, z, y, x):
    """Return the kind of a voxel that has a slot, else 0."""
    return kinds[labels[z, y, x]] if slot_at(slot, z, y, x) > 0 else np.int64(0)


@inline
def _code_of(key, keys, codes, count):
    """Return the code of a key in the hash table, a new one where it is not there, and their
    count.
    """
    at = (key ^ (key >> 29) ^ (key >> 13)) * 0x9E3779B1 & (len(keys) - 1)
    while keys[at] != key:
        if keys[at] < 0:
            keys[at], codes[at] = key, count
            count += 1
            break
        at = (at + 1) & (len(keys) - 1)
    return codes[at], count


@kernel
def find_segments(labels, kinds, slot, zero, segments, table_size):
    """Find the segments of the voxels that have a slot; with 0 `segments` only count them. kinds[a]
    is 1 or more for labels that conduct.

    Returns also the keys of the couplings by code: the kinds, 0 where nothing conducts, of the
    voxels and of their neighbours at y - 1, y + 1, z - 1, z + 1, before and after the segment, 8
    bits each, and two bits for the near and the far end face.
    """
    depth, height, width = slot.shape
    table = np.zeros((max(segments, 1), COLUMNS), np.int32)
    code, place = np.zeros(len(table), np.int32), np.zeros((len(table), 3), np.int16)
    keys, codes = np.full(table_size, -1, np.int64), np.zeros(table_size, np.int32)
    found, empty = np.zeros(COLUMNS, np.int32), np.zeros(COLUMNS, np.int32)
    empty[2:] = zero
    fill = segments > 0
    total = count = 0
    for z in range(depth):
        faces = np.int64(z == 0) + 2 * np.int64(z == depth - 1)
        for y in range(height):
            beside = first = own = np.int64(0)
            for x in range(width + 1):
                before, own = own, _kind_at(labels, kinds, slot, z, y, x)
                key = own
                at = total - 1 if fill else 0
                if own:
                    found[0] = slot_at(slot, z, y, x)
                    for c in range(2, COLUMNS):
                        step = 2 * (c & 1) - 1
                        u, v = z + step * (c > 3), y + step * (c < 4)
                        found[c] = slot_at(slot, u, v, x)
                        key = key << 8 | _kind_at(labels, kinds, slot, u, v, x)
                        if found[c] == 0:
                            found[c] = zero
                    if before and key == beside and continues(table, at, found, empty):
                        table[at, 1] += 1
                        continue
                if before and fill:
                    whole = ((beside << 8 | first) << 8 | own) << 2 | faces
                    code[at], count = _code_of(whole, keys, codes, count)
                if own:
                    at = total if fill else 0
                    total += 1
                    beside, first = key, before
                    copy_row(table[at], found)
                    table[at, 1] = 1
                    place[at, 0], place[at, 1], place[at, 2] = z, y, x
    used = np.zeros(count, np.int64)
    for k in range(len(keys)):
        if keys[k] >= 0:
            used[codes[k]] = keys[k]
    return table, code, place, total, used


def couplings_of(keys: np.ndarray, face: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the couplings of keys, (C, 10): face[a, b, d] between kinds a and b along axis d,
    end[a] to an end face; those of kind 0 are 0.
    """
    after, before, z1, z0, y1, y0, own = [keys >> (2 + 8 * n) & 255 for n in range(7)]
    ends = (keys & 1) + (keys >> 1 & 1)
    out = np.empty((len(keys), 10))
    for column, other in enumerate((y0, y1, z0, z1, own, before, after)):
        out[:, column] = face[own, other, (1, 1, 0, 0, 2, 2, 2)[column]]
    out[:, _END] = end[own]
    out[:, _TO_ENDS] = ends * end[own]
    out[:, _BESIDE] = out[:, :4].sum(axis=1) + out[:, _TO_ENDS]
    return out


@inline
def _row(coupling, code, kind):
    """Return the couplings of a segment in a vector's precision."""
    w = coupling[code]
    return (
        (kind(w[0]), kind(w[1]), kind(w[2]), kind(w[3])),
        kind(w[_INSIDE]),
        kind(w[_BEFORE]),
        kind(w[_AFTER]),
        kind(w[_BESIDE]),
    )


@kernel
def multiply(table, code, coupling, x, out):
    """Set the matrix times x: the sum of couplings times differences, which keeps the digits that a
    diagonal times x would lose in float32.
    """
    kind = out.dtype.type
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        (y0, y1, z0, z1), inside, before, after, _ = _row(coupling, code[s], kind)
        to_ends = kind(coupling[code[s], _TO_ENDS])
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[table[s, 4] :], x[table[s, 5] :]
        i = x[first - 1 : first + length + 1]
        row = out[first : first + length]
        for k in range(length):
            low = before if k == 0 else inside
            high = after if k == length - 1 else inside
            v = i[k + 1]
            row[k] = (
                (low * (v - i[k]) + high * (v - i[k + 2]))
                + (y0 * (v - a[k]) + y1 * (v - b[k]))
                + (z0 * (v - c[k]) + z1 * (v - d[k]))
                + to_ends * v
            )


@kernel
def sweep_forward(table, code, coupling, right, x):
    """Sweep once by Gauss-Seidel from zero: only neighbours before a node have a value yet."""
    one = np.float32(1.0)
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        (y0, _, z0, _), inside, before, after, beside = _row(coupling, code[s], np.float32)
        a, c = x[table[s, 2] :], x[table[s, 4] :]
        r, out = right[first : first + length], x[first : first + length]
        for k in range(length):
            out[k] = r[k] + y0 * a[k] + z0 * c[k]
        if length == 1:
            out[0] = (out[0] + before * x[first - 1]) / (beside + before + after)
            continue
        last = (out[0] + before * x[first - 1]) / (beside + before + inside)
        out[0] = last
        inverse = one / (beside + inside + inside)
        pass_on = inside * inverse
        for k in range(1, length - 1):
            last = out[k] * inverse + pass_on * last
            out[k] = last
        out[length - 1] = (out[length - 1] + inside * last) / (beside + inside + after)


@kernel
def restrict(table, code, coupling, aggregate, x, coarse):
    """Set the residual of a forward sweep, summed over aggregates: the later neighbours'."""
    coarse[:] = 0.0
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        (_, y1, _, z1), inside, _, after, _ = _row(coupling, code[s], np.float32)
        b, d, e = x[table[s, 3] :], x[table[s, 5] :], x[first + 1 :]
        at = aggregate[first : first + length]
        for k in range(length - 1):
            coarse[at[k]] += inside * e[k] + y1 * b[k] + z1 * d[k]
        k = length - 1
        coarse[at[k]] += after * e[k] + y1 * b[k] + z1 * d[k]


@kernel
def sweep_backward(table, code, coupling, right, x):
    """Sweep once by Gauss-Seidel, the last node first."""
    one = np.float32(1.0)
    rest = np.empty(table[:, 1].max(), np.float32)
    for s in range(len(table) - 1, -1, -1):
        first, length = table[s, 0], table[s, 1]
        (y0, y1, z0, z1), inside, before, after, beside = _row(coupling, code[s], np.float32)
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[table[s, 4] :], x[table[s, 5] :]
        i = x[first - 1 : first + length + 1]
        r = right[first : first + length]
        for k in range(length):
            rest[k] = r[k] + (y0 * a[k] + y1 * b[k]) + (z0 * c[k] + z1 * d[k])
        rest[0] += before * i[0]
        for k in range(1, length):
            rest[k] += inside * i[k]
        last = rest[length - 1] + after * i[length + 1]
        if length == 1:
            i[1] = last / (beside + before + after)
            continue
        last /= beside + inside + after
        i[length] = last
        inverse = one / (beside + inside + inside)
        pass_on = inside * inverse
        for k in range(length - 2, 0, -1):
            last = rest[k] * inverse + pass_on * last
            i[k + 1] = last
        i[1] = (rest[0] + inside * last) / (beside + before + inside)


@kernel
def set_driving_flux(table, code, coupling, place, out):
    """Set the couplings of the first plane to its end face."""
    for s in range(len(table)):
        if place[s, 0] == 0:
            out[table[s, 0] : table[s, 0] + table[s, 1]] = coupling[code[s], _END]


@kernel
def sum_sections(table, code, coupling, place, x):
    """Return the flux through every section across the first axis, from 1 on the near end face to 0
    on the far one.
    """
    depth = place[len(place) - 1, 0] + 1
    flux = np.zeros(depth + 1)
    for s in range(len(table)):
        z, length, up = place[s, 0], table[s, 1], coupling[code[s], 3]
        i = x[table[s, 0] : table[s, 0] + length]
        d = x[table[s, 5] :]
        total = near = 0.0
        for k in range(length):
            total += up * (i[k] - d[k])
            near += i[k]
        flux[z + 1] += total
        if z == 0:
            flux[0] += coupling[code[s], _END] * (length - near)
        if z == depth - 1:
            flux[depth] += coupling[code[s], _END] * near
    return flux


@kernel
def conduction_graph(table, code, coupling, place, number):
    """Return the rows of the matrix for some segments as the fields of a Graph; number is that of a
    slot's node, -1 where it has none.
    """
    nodes = table[:, 1].sum()
    start, middle = np.zeros(nodes + 1, np.int64), np.zeros(nodes, np.int64)
    other, weight = np.empty(6 * nodes, np.int32), np.empty(6 * nodes, np.float32)
    own, where = np.zeros(nodes), np.empty((nodes, 3), np.int16)
    used = n = 0
    for s in range(len(table)):
        w, length = coupling[code[s]], table[s, 1]
        for k in range(length):
            i = table[s, 0] + k
            low = w[_BEFORE] if k == 0 else w[_INSIDE]
            high = w[_AFTER] if k == length - 1 else w[_INSIDE]
            own[n] = w[_BESIDE] + low + high
            where[n, 0], where[n, 1], where[n, 2] = place[s, 0], place[s, 1], place[s, 2] + k
            for side in range(6):
                if side == 3:
                    middle[n] = used
                if side == 0:
                    j, strength = table[s, 4] + k, w[2]
                elif side == 1:
                    j, strength = table[s, 2] + k, w[0]
                elif side == 2:
                    j, strength = i - 1, low
                elif side == 3:
                    j, strength = i + 1, high
                elif side == 4:
                    j, strength = table[s, 3] + k, w[1]
                else:
                    j, strength = table[s, 5] + k, w[3]
                if number[j] >= 0:
                    other[used], weight[used] = number[j], strength
                    used += 1
            n += 1
            start[n] = used
    return start, middle, other[:used].copy(), weight[:used].copy(), own, where

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
from trabecula.engine.parallel import for_slabs
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

    @property
    def driven(self) -> float:
        """Return the sum of the driving flux."""
        near = slice(0, int(np.searchsorted(self.place[:, 0], 1)))
        return float(self.coupling[self.code[near], _END] @ self.table[near, 1])

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
        given, counts = (labels, kinds, slot, slots), np.zeros(len(labels), np.int64)

        def count(start: int, stop: int) -> None:
            none = np.zeros((0, COLUMNS), np.int32), np.zeros((0, 3), np.int16)
            find_segments(*given, *none, np.zeros(0, np.int64), counts, start, stop)

        for_slabs(count, len(labels))
        ends = [0, *np.cumsum(counts).tolist()]
        table, place = np.zeros((ends[-1], COLUMNS), np.int32), np.zeros((ends[-1], 3), np.int16)
        key = np.zeros(ends[-1], np.int64)

        def fill(start: int, stop: int) -> None:
            inside = slice(ends[start], ends[stop])
            find_segments(*given, table[inside], place[inside], key[inside], counts, start, stop)

        for_slabs(fill, len(labels))
        most = int(kinds.max())
        codes = min(len(key), 4 * most * (most + 1) ** 6)
        code, keys = number_keys(key, 1 << (2 * codes).bit_length())
        zeros = labels.shape[2] + 2  # no segment is longer
        return cls(table, code, couplings_of(keys, face, end), place, slots, nodes, slots + zeros)


@inline
def _kind_at(labels, kinds, slot, z, y, x):
    """Return the kind of a voxel that has a slot, else 0."""
    return kinds[labels[z, y, x]] if slot_at(slot, z, y, x) > 0 else np.int64(0)


@kernel
def find_segments(labels, kinds, slot, zero, table, place, key, counts, start, stop):
    """Find the segments of the voxels of planes start..stop that have a slot; where there is no
    room for them only count them, plane by plane. kinds[a] is 1 or more for labels that conduct.

    A segment's key has the kinds, 0 where nothing conducts, of its voxels and of their neighbours
    at y - 1, y + 1, z - 1, z + 1, before and after it, 8 bits each, and two bits for the near and
    the far end face.
    """
    depth, height, width = slot.shape
    found, empty = np.zeros(COLUMNS, np.int32), np.zeros(COLUMNS, np.int32)
    empty[2:] = zero
    last = np.zeros((1, COLUMNS), np.int32)
    total = 0
    for z in range(start, stop):
        faces = np.int64(z == 0) + 2 * np.int64(z == depth - 1)
        counts[z] = -total
        for y in range(height):
            beside = first = own = np.int64(0)
            for x in range(width + 1):
                before, own = own, _kind_at(labels, kinds, slot, z, y, x)
                around = own
                if own:
                    found[0] = slot_at(slot, z, y, x)
                    for c in range(2, COLUMNS):
                        step = 2 * (c & 1) - 1
                        u, v = z + step * (c > 3), y + step * (c < 4)
                        found[c] = slot_at(slot, u, v, x)
                        around = around << 8 | _kind_at(labels, kinds, slot, u, v, x)
                        if found[c] == 0:
                            found[c] = zero
                    if before and around == beside and continues(last, 0, found, empty):
                        last[0, 1] += 1
                        continue
                if before and len(table):
                    copy_row(table[total - 1], last[0])
                    key[total - 1] = ((beside << 8 | first) << 8 | own) << 2 | faces
                if own:
                    beside, first = around, before
                    copy_row(last[0], found)
                    last[0, 1] = 1
                    if len(table):
                        place[total, 0], place[total, 1], place[total, 2] = z, y, x
                    total += 1
        counts[z] += total


@kernel
def number_keys(key, table_size):
    """Return the code of every key, and the key of every code, which are numbered as they come."""
    keys, codes = np.full(table_size, -1, np.int64), np.zeros(table_size, np.int32)
    code, count = np.empty(len(key), np.int32), 0
    for s in range(len(key)):
        own = key[s]
        at = (own ^ (own >> 29) ^ (own >> 13)) * 0x9E3779B1 & (table_size - 1)
        while keys[at] >= 0 and keys[at] != own:
            at = (at + 1) & (table_size - 1)
        if keys[at] < 0:
            keys[at], codes[at] = own, count
            count += 1
        code[s] = codes[at]
    used = np.zeros(count, np.int64)
    for n in range(table_size):
        if keys[n] >= 0:
            used[codes[n]] = keys[n]
    return code, used


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
def multiply(table, code, coupling, place, x, out, flux):
    """Set the matrix times x of some segments: the sum of couplings times differences, which keeps
    the digits that a diagonal times x would lose in float32.

    Set also the flux through every section (Z + 1,) float64 that they end, where both end faces are
    0: towards the far end face, through it and through the near one.
    """
    kind = out.dtype.type
    far = len(flux) - 1
    flux[0 if place[0, 0] == 0 else place[0, 0] + 1 : place[len(place) - 1, 0] + 2] = 0.0
    for s in range(len(table)):
        first, length, z = table[s, 0], table[s, 1], place[s, 0]
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
        passed = own = 0.0
        for k in range(length):
            own += i[k + 1]
            passed += np.float64(i[k + 1]) - np.float64(d[k])
        if z + 1 < far:
            flux[z + 1] += coupling[code[s], 3] * passed
        else:
            flux[far] += coupling[code[s], _END] * own
        if z == 0:
            flux[0] -= coupling[code[s], _END] * own


@kernel
def sweep_forward(table, code, coupling, right, x, edge, zeros):
    """Sweep some segments once by Gauss-Seidel from zero: only neighbours before a node have a
    value yet. At z - 1 the segments before `edge` have none of the same part; from `zeros` on x
    stays 0.
    """
    one = np.float32(1.0)
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        (y0, _, z0, _), inside, before, after, beside = _row(coupling, code[s], np.float32)
        a, c = x[table[s, 2] :], x[zeros if s < edge else table[s, 4] :]
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
def restrict(table, code, coupling, aggregate, x, coarse, edge):
    """Add the residual of a forward sweep to aggregates: the later neighbours', and before `edge`
    that of those at z - 1.
    """
    for s in range(len(table)):
        first, length = table[s, 0], table[s, 1]
        (_, y1, z0, z1), inside, _, after, _ = _row(coupling, code[s], np.float32)
        b, d, e = x[table[s, 3] :], x[table[s, 5] :], x[first + 1 :]
        at = aggregate[first : first + length]
        for k in range(length - 1):
            coarse[at[k]] += inside * e[k] + y1 * b[k] + z1 * d[k]
        k = length - 1
        coarse[at[k]] += after * e[k] + y1 * b[k] + z1 * d[k]
        if s < edge:
            c = x[table[s, 4] :]
            for k in range(length):
                coarse[at[k]] += z0 * c[k]


@kernel
def sweep_backward(table, code, coupling, right, x, edges, zeros, shifts):
    """Sweep some segments once by Gauss-Seidel, the last node first.

    The segments before edges[0] have neighbours of another part at z - 1, those from edges[1] on at
    z + 1: their values stand `shifts` slots farther on.
    """
    one = np.float32(1.0)
    rest = np.empty(table[:, 1].max(), np.float32)
    for s in range(len(table) - 1, -1, -1):
        first, length = table[s, 0], table[s, 1]
        (y0, y1, z0, z1), inside, before, after, beside = _row(coupling, code[s], np.float32)
        low, high = np.int64(table[s, 4]), np.int64(table[s, 5])
        if s < edges[0] and low < zeros:
            low += shifts[0]
        if s >= edges[1] and high < zeros:
            high += shifts[1]
        a, b = x[table[s, 2] :], x[table[s, 3] :]
        c, d = x[low:], x[high:]
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

"""Kernels of conduction along the first axis: finite volumes, one unknown a voxel, seven points."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel


@kernel
def enumerate_voxels(active):
    """Label every active voxel in raster order, -1 elsewhere; return also their count."""
    number = np.empty(active.shape, np.int32)
    count = 0
    for z in range(active.shape[0]):
        for y in range(active.shape[1]):
            for x in range(active.shape[2]):
                number[z, y, x] = count if active[z, y, x] else -1
                count += active[z, y, x]
    return number, count


@kernel
def assemble(labels, number, count, face, end):
    """Assemble the couplings of active voxels: face[a, b, d] between labels a and b along axis d,
    end[a] to an end face.

    Returns the fields of a Graph, and the coupling of every voxel of the first plane to its end
    face times 1 (the right-hand side for 1 on that face and 0 on the other).
    """
    depth, height, width = number.shape
    start, middle = np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    other, weight = np.empty(6 * count, np.int32), np.empty(6 * count, np.float32)
    diagonal, right, place = np.zeros(count), np.zeros(count), np.empty((count, 3), np.int16)
    used = 0
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                i = number[z, y, x]
                if i < 0:
                    continue
                a = labels[z, y, x]
                place[i, 0], place[i, 1], place[i, 2] = z, y, x
                for n in range(6):
                    if n == 3:
                        middle[i] = used
                    d = n if n < 3 else 5 - n
                    step = -1 if n < 3 else 1
                    u, v, w = z + step * (d == 0), y + step * (d == 1), x + step * (d == 2)
                    if u < 0 or v < 0 or w < 0 or u == depth or v == height or w == width:
                        continue
                    j = number[u, v, w]
                    if j >= 0:
                        other[used] = j
                        weight[used] = face[a, labels[u, v, w], d]
                        diagonal[i] += weight[used]
                        used += 1
                if z == 0:
                    diagonal[i] += end[a]
                    right[i] = end[a]
                if z == depth - 1:
                    diagonal[i] += end[a]
                start[i + 1] = used
    return start, middle, other[:used].copy(), weight[:used].copy(), diagonal, place, right


@kernel
def section_fluxes(labels, number, face, end, potential):
    """Return the flux through every section across the first axis, from 1 on the near end face to 0
    on the far one.
    """
    depth, height, width = number.shape
    flux = np.zeros(depth + 1)
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                i = number[z, y, x]
                if i < 0:
                    continue
                a = labels[z, y, x]
                if z == 0:
                    flux[0] += end[a] * (1.0 - potential[i])
                if z == depth - 1:
                    flux[depth] += end[a] * potential[i]
                elif number[z + 1, y, x] >= 0:
                    weight = np.float32(face[a, labels[z + 1, y, x], 0])
                    flux[z + 1] += weight * (potential[i] - potential[number[z + 1, y, x]])
    return flux

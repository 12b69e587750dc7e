"""Kernels of the two grids of transport along the first axis.

Conduction: finite volumes, one unknown a voxel, seven points.

Flow: the marker-and-cell grid, pressure in voxels, velocity on the faces between two voxels of the
void (Harlow and Welch 1965, doi:10.1063/1.1761178). Everything is multiplied by the volume of a
control volume, so that the viscous matrix is symmetric. Pressure falls along the first axis from 1
on the near end face to 0 on the far one. Faces are numbered axis by axis, each in raster order; a
face has the place of the voxel above it. Of the faces of the image only those at the ends of the
first axis carry an unknown, with half a control volume.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel


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


@kernel
def enumerate_faces(number):
    """Label every face, (3, Z + 1, Y, X), -1 where it is a wall or a mirror; return also the first
    of every axis, and the end.
    """
    depth, height, width = number.shape
    bounds = np.zeros(4, np.int64)
    faces = np.full((3, depth + 1, height, width), -1, np.int32)
    count = 0
    for d in range(3):
        for z in range(depth + 1):
            for y in range(height):
                for x in range(width):
                    if z == depth:
                        found = d == 0 and number[z - 1, y, x] >= 0
                    elif number[z, y, x] < 0:
                        found = False
                    elif d == 0:
                        found = z == 0 or number[z - 1, y, x] >= 0
                    elif d == 1:
                        found = y > 0 and number[z, y - 1, x] >= 0
                    else:
                        found = x > 0 and number[z, y, x - 1] >= 0
                    if found:
                        faces[d, z, y, x] = count
                        count += 1
        bounds[d + 1] = count
    return faces, bounds


@kernel
def link(number, faces, cells, count):
    """Return the faces of every voxel, (N, 6): low z, y, x, high z, y, x; and the voxels of every
    face, (M, 2): -1 is an end.
    """
    depth, height, width = number.shape
    faces_of, cells_of = np.full((cells, 6), -1, np.int32), np.full((count, 2), -1, np.int32)
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                i = number[z, y, x]
                if i < 0:
                    continue
                for d in range(3):
                    u, v, w = z + (d == 0), y + (d == 1), x + (d == 2)
                    faces_of[i, d] = faces[d, z, y, x]
                    if v < height and w < width:
                        faces_of[i, 3 + d] = faces[d, u, v, w]
                    if faces_of[i, d] >= 0:
                        cells_of[faces_of[i, d], 1] = i
                    if faces_of[i, 3 + d] >= 0:
                        cells_of[faces_of[i, 3 + d], 0] = i
    return faces_of, cells_of


@inline
def _is_void(number, z, y, x):
    return z >= 0 and z < number.shape[0] and number[z, y, x] >= 0


@kernel
def assemble_viscous(number, faces, count, pull):
    """Assemble the viscous matrix of all velocities as the fields of a Graph; pull[d] is volume /
    edge[d]**2.

    Ahead and behind, a wall face is a velocity of 0 at the distance of an edge. Beside, the wall
    is half an edge off where both voxels are solid; where one of them is, the face between them
    is a velocity of 0 at the distance of an edge (a wall at half of it over half of the face holds
    staircases more firmly, but makes round grains too large: the drag of a simple cubic array of
    spheres 3 to 5 % too high at radii of 6 to 12 voxels, against 1 %). Tangential velocity is 0 on
    the end faces; side faces are mirrors.
    """
    depth, height, width = number.shape
    start, middle = np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    other, weight = np.empty(6 * count, np.int32), np.empty(6 * count, np.float32)
    diagonal, place = np.zeros(count), np.empty((count, 3), np.int16)
    used = 0
    for a in range(3):
        for z in range(depth + (a == 0)):
            for y in range(height):
                for x in range(width):
                    i = faces[a, z, y, x]
                    if i < 0:
                        continue
                    place[i, 0], place[i, 1], place[i, 2] = z, y, x
                    at_end = a == 0 and (z == 0 or z == depth)
                    for n in range(6):
                        if n == 3:
                            middle[i] = used
                        d = n if n < 3 else 5 - n
                        step = -1 if n < 3 else 1
                        u, v, w = z + step * (d == 0), y + step * (d == 1), x + step * (d == 2)
                        outside = (
                            u < 0
                            or v < 0
                            or w < 0
                            or u >= depth + (a == 0)
                            or v >= height
                            or w >= width
                        )
                        if outside and ((d == a and a == 0) or (d != a and d != 0)):
                            continue
                        strength = np.float32(pull[d] * (0.5 if at_end and d != 0 else 1.0))
                        if not outside and faces[a, u, v, w] >= 0:
                            other[used], weight[used] = faces[a, u, v, w], strength
                            diagonal[i] += strength
                            used += 1
                        elif d == a:
                            diagonal[i] += strength
                        else:
                            open_beside = not outside and (
                                _is_void(number, u, v, w)
                                or _is_void(number, u - (a == 0), v - (a == 1), w - (a == 2))
                            )
                            diagonal[i] += strength * (1.0 if open_beside else 2.0)
                    start[i + 1] = used
    return start, middle, other[:used].copy(), weight[:used].copy(), diagonal, place


@kernel
def assemble_pressure(faces_of, cells_of, mobility, area, place):
    """Assemble the matrix of div (mobility grad) over the voxels, as the fields of a Graph; area[d]
    of a face.
    """
    count = len(faces_of)
    start, middle = np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    other, weight = np.empty(6 * count, np.int32), np.empty(6 * count, np.float32)
    diagonal = np.zeros(count)
    used = 0
    for i in range(count):
        for n in range(6):
            if n == 3:
                middle[i] = used
            f = faces_of[i, n]
            if f < 0:
                continue
            j = cells_of[f, 0] if n < 3 else cells_of[f, 1]
            strength = np.float32(mobility[f] * area[n % 3] ** 2)
            diagonal[i] += strength
            if j >= 0:
                other[used], weight[used] = j, strength
                used += 1
        start[i + 1] = used
    return start, middle, other[:used].copy(), weight[:used].copy(), diagonal, place


@kernel
def momentum(start, other, weight, diagonal, cells_of, bounds, area, velocity, pressure):
    """Return the viscous force less the force of the pressure, on every control volume."""
    force = np.empty(len(velocity))
    for d in range(3):
        for f in range(bounds[d], bounds[d + 1]):
            total = diagonal[f] * velocity[f]
            for k in range(start[f], start[f + 1]):
                total -= weight[k] * velocity[other[k]]
            if cells_of[f, 0] >= 0:
                total -= area[d] * pressure[cells_of[f, 0]]
            if cells_of[f, 1] >= 0:
                total += area[d] * pressure[cells_of[f, 1]]
            force[f] = total
    return force


@kernel
def divergence(faces_of, area, velocity):
    """Return the outflow of every voxel."""
    out = np.empty(len(faces_of), velocity.dtype)
    for i in range(len(faces_of)):
        total = 0.0
        for d in range(3):
            if faces_of[i, 3 + d] >= 0:
                total += area[d] * velocity[faces_of[i, 3 + d]]
            if faces_of[i, d] >= 0:
                total -= area[d] * velocity[faces_of[i, d]]
        out[i] = total
    return out


@kernel
def push(cells_of, bounds, area, pressure, mobility, velocity):
    """Add mobility * area * (pressure before a face - pressure behind it) to velocity; the pressure
    beyond the ends is 0.
    """
    for d in range(3):
        for f in range(bounds[d], bounds[d + 1]):
            drop = 0.0
            if cells_of[f, 0] >= 0:
                drop += pressure[cells_of[f, 0]]
            if cells_of[f, 1] >= 0:
                drop -= pressure[cells_of[f, 1]]
            velocity[f] += mobility[f] * area[d] * drop


@kernel
def section_flows(faces, velocity):
    """Sum the velocities through every section across the first axis."""
    flow = np.zeros(faces.shape[1])
    for z in range(faces.shape[1]):
        for y in range(faces.shape[2]):
            for x in range(faces.shape[3]):
                if faces[0, z, y, x] >= 0:
                    flow[z] += velocity[faces[0, z, y, x]]
    return flow

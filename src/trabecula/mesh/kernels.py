"""Marching cubes in two passes, and smoothing: plain functions on arrays.

Glossary: `solid` is the padded volume (Z, Y, X), 0 or 1; a cube has the voxel (z, y, x) as its
lowest corner.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel


@inline
def _configuration(solid, z, y, x):
    """Return the configuration of a cube, a bit for each corner: see `mesh.table`."""
    return (
        solid[z, y, x]
        | solid[z, y, x + 1] << 1
        | solid[z, y + 1, x] << 2
        | solid[z, y + 1, x + 1] << 3
        | solid[z + 1, y, x] << 4
        | solid[z + 1, y, x + 1] << 5
        | solid[z + 1, y + 1, x] << 6
        | solid[z + 1, y + 1, x + 1] << 7
    )


@kernel
def count(solid, case_counts):
    """Count vertices and triangles.

    The border of `solid` is void, so no cut edge is in the last planes.
    """
    vertices = 0
    triangles = 0
    depth, height, width = solid.shape
    for z in range(depth - 1):
        for y in range(height - 1):
            for x in range(width - 1):
                here = solid[z, y, x]
                vertices += here != solid[z, y, x + 1]
                vertices += here != solid[z, y + 1, x]
                vertices += here != solid[z + 1, y, x]
                triangles += case_counts[_configuration(solid, z, y, x)]
    return vertices, triangles


@kernel
def fill(solid, case_counts, case_edges, edge_offsets, vertices, faces):
    """Write the vertices, in voxels, at the middle of every cut edge, and the triangles.

    `numbers` holds the vertex on every edge of two planes of voxels and of the edges between them:
    0, 1 are the x edges of even and odd planes, 2, 3 the y edges, 4 the z edges. `edge_offsets`
    (12, 4) is x, y, z of an edge's lower corner and its axis.
    """
    depth, height, width = solid.shape
    numbers = np.zeros((5, height, width), np.int32)
    v = 0
    f = 0
    for z in range(depth - 1):
        above = (z + 1) & 1
        for y in range(height - 1):
            for x in range(width - 1):
                # Plane 0 is void all over, so that numbering starts with plane 1.
                up = solid[z + 1, y, x]
                if up != solid[z + 1, y, x + 1]:
                    numbers[above, y, x] = v
                    vertices[v, 0], vertices[v, 1], vertices[v, 2] = x, y - 0.5, z + 0.5
                    v += 1
                if up != solid[z + 1, y + 1, x]:
                    numbers[2 + above, y, x] = v
                    vertices[v, 0], vertices[v, 1], vertices[v, 2] = x - 0.5, y, z + 0.5
                    v += 1
                if up != solid[z, y, x]:
                    numbers[4, y, x] = v
                    vertices[v, 0], vertices[v, 1], vertices[v, 2] = x - 0.5, y - 0.5, z
                    v += 1
        for y in range(height - 1):
            for x in range(width - 1):
                case = _configuration(solid, z, y, x)
                for t in range(case_counts[case]):
                    for k in range(3):
                        edge = case_edges[case, 3 * t + k]
                        axis = edge_offsets[edge, 3]
                        plane = 4 if axis == 2 else 2 * axis + ((z + edge_offsets[edge, 2]) & 1)
                        faces[f, k] = numbers[
                            plane, y + edge_offsets[edge, 1], x + edge_offsets[edge, 0]
                        ]
                    f += 1


@kernel
def degrees(faces, degree):
    """Add to `degree` the number of neighbours of every vertex: of its faces, if it is closed."""
    for f in range(len(faces)):
        for k in range(3):
            degree[faces[f, k]] += 1


@kernel
def relax(vertices, faces, degree, factor, box, sums):
    """Move every vertex by `factor` of the way to the mean of its neighbours (Taubin's umbrella).

    In a closed surface every edge runs once in each direction, so the next corner of every face
    visits every neighbour once. A coordinate in a face of the box 0..box stays there: cut faces
    stay flat.
    """
    sums[:] = 0.0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for k in range(3):
            sums[a, k] += vertices[b, k]
            sums[b, k] += vertices[c, k]
            sums[c, k] += vertices[a, k]
    for v in range(len(vertices)):
        for k in range(3):
            old = vertices[v, k]
            if old != 0.0 and old != box[k]:
                new = old + factor * (sums[v, k] / degree[v] - old)
                vertices[v, k] = min(max(new, 0.0), box[k])


@kernel
def unite(faces, parent):
    """Unite the corners of every face: `parent[v]` becomes the smallest vertex of v's component."""
    for f in range(len(faces)):
        for k in range(2):
            a, b = faces[f, k], faces[f, k + 1]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            if a < b:
                parent[b] = a
            else:
                parent[a] = b
    for v in range(len(parent)):
        parent[v] = parent[parent[v]]


@inline
def _passes(a, b, points, z, y):
    """Return the winding of the edge a -> b about the line (z, y).

    1 where it passes the line upwards in z on the side of larger y, -1 downwards, 0 elsewhere. The
    test takes the ends in a fixed order, so that b -> a gives exactly the opposite.
    """
    up = points[a, 0] <= z
    if up != (points[b, 0] > z):
        return 0
    if not up:
        a, b = b, a
    # Now a is at or below the line and b above: the edge crosses z at a larger y than the line's
    # where this is > 0.
    side = (points[b, 1] - points[a, 1]) * (z - points[a, 0]) - (y - points[a, 1]) * (
        points[b, 0] - points[a, 0]
    )
    if side <= 0.0:
        return 0
    return 1 if up else -1


@inline
def _crossing(a, b, c, points, z, y):
    """Return the x of a triangle's plane on the line (z, y), clamped to the triangle's range."""
    z1, y1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    z2, y2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    x1, x2 = points[b, 2] - points[a, 2], points[c, 2] - points[a, 2]
    area = z1 * y2 - z2 * y1
    dz, dy = z - points[a, 0], y - points[a, 1]
    low = min(points[a, 2], points[b, 2], points[c, 2])
    high = max(points[a, 2], points[b, 2], points[c, 2])
    # A triangle seen edge-on is met by rounding only; any point of it will do.
    x = (
        low
        if area == 0.0
        else points[a, 2] + ((dz * y2 - dy * z2) * x1 + (dy * z1 - dz * y1) * x2) / area
    )
    return min(max(x, low), high)


@kernel
def fill_rows(points, faces, values, start, stop):
    """Write 1 into the voxels of slices start..stop whose centres have a non-zero winding number.

    `points` (V, 3) is z, y, x in voxels; `values` (Z, Y, X) int8 is 0 and receives first the
    crossings, each at the first voxel whose centre is beyond it, then the result.
    """
    _, height, width = values.shape
    # First and last crossing of every row: it is empty beyond them.
    low = np.full((stop - start, height), width, np.int32)
    high = np.zeros((stop - start, height), np.int32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        z0 = min(points[a, 0], points[b, 0], points[c, 0])
        z1 = max(points[a, 0], points[b, 0], points[c, 0])
        if z1 < start or z0 > stop:
            continue
        y0 = min(points[a, 1], points[b, 1], points[c, 1])
        y1 = max(points[a, 1], points[b, 1], points[c, 1])
        top, bottom = max(y0 - 0.5, 0.0), min(y1 - 0.5, height - 1.0)
        for k in range(
            int(np.ceil(max(z0 - 0.5, start))), int(np.floor(min(z1 - 0.5, stop - 1.0))) + 1
        ):
            z = k + 0.5
            for j in range(int(np.ceil(top)), int(np.floor(bottom)) + 1):
                y = j + 0.5
                turns = (
                    _passes(a, b, points, z, y)
                    + _passes(b, c, points, z, y)
                    + _passes(c, a, points, z, y)
                )
                if turns != 0:
                    first = np.ceil(_crossing(a, b, c, points, z, y) - 0.5)
                    if first < width:
                        x = int(max(first, 0.0))
                        values[k, j, x] += turns
                        low[k - start, j] = min(low[k - start, j], x)
                        high[k - start, j] = max(high[k - start, j], x)
                    else:
                        high[k - start, j] = width - 1
    for k in range(start, stop):
        for j in range(height):
            row = values[k, j]
            winding = np.int8(0)
            for x in range(low[k - start, j], high[k - start, j] + 1):
                winding += row[x]
                row[x] = winding != 0

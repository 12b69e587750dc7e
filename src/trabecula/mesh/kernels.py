"""Marching cubes in two passes, and smoothing: plain functions on arrays.

Glossary: `solid` is the padded volume (Z, Y, X), 0 or 1; a cube has the voxel (z, y, x) as its lowest corner.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel


@inline
def _configuration(solid, z, y, x):
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
    """Numbers of vertices and of triangles. The border of `solid` is void, so no cut edge lies in the last planes."""
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

    `numbers` holds the vertex on every edge of two planes of voxels and of the edges between them: 0, 1 are the x edges
    of even and odd planes, 2, 3 the y edges, 4 the z edges. `edge_offsets` (12, 4) is x, y, z of an edge's lower corner
    and its axis.
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
                        faces[f, k] = numbers[plane, y + edge_offsets[edge, 1], x + edge_offsets[edge, 0]]
                    f += 1


@kernel
def degrees(faces, degree):
    """Add to `degree` how many neighbours every vertex has (in a closed surface: how many faces)."""
    for f in range(len(faces)):
        for k in range(3):
            degree[faces[f, k]] += 1


@kernel
def relax(vertices, faces, degree, factor, box, sums):
    """Move every vertex by `factor` of the way to the mean of its neighbours (the umbrella operator of Taubin).

    In a closed surface every edge runs once in each direction, so taking only the next corner of every face visits
    every neighbour once. A coordinate that lies in a face of the box 0..box stays there: cut faces stay flat.
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
    """Union-find over the corners of every face: afterwards `parent[v]` is the smallest vertex of v's component."""
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

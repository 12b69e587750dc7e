"""The ray marcher of stills, on arrays: `rays` finds the surface, `shading` gives its light."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.view.rays import FAR, hit, point
from trabecula.view.shading import DEPTH, add_reflection, openness, way_through


@kernel
def blur_axis(values, weights, out):
    """Convolve (A, B, C) along its middle axis with weights that sum to 256; edge values are
    repeated.
    """
    reach = len(weights) // 2
    for a in range(values.shape[0]):
        for b in range(values.shape[1]):
            for c in range(values.shape[2]):
                total = 128
                for k in range(len(weights)):
                    total += (
                        weights[k] * values[a, min(max(b + k - reach, 0), values.shape[1] - 1), c]
                    )
                out[a, b, c] = total >> 8


@inline
def _label(labels, x, y, z, normal):
    """Return the label a quarter of a voxel below the surface."""
    i = min(max(int(x - 0.25 * normal[0]), 0), labels.shape[2] - 1)
    j = min(max(int(y - 0.25 * normal[1]), 0), labels.shape[1] - 1)
    k = min(max(int(z - 0.25 * normal[2]), 0), labels.shape[0] - 1)
    return labels[k, j, i]


@kernel
def march(
    field, labels, occupied, pyramid, offsets, shapes, camera, stretch, box, plane, directions,
    lights, strength, palette, finishes, sampling, first, last, out,
):  # fmt: skip
    """Shade the rows `first`..`last` of `out` (H, W, 3), linear light, with sampling**2 rays a
    pixel.

    camera (4, 3): middle of the upper left pixel, steps to the next pixel and the next row
    (voxels), direction of the rays (voxels per unit length). palette: background, dye of cut faces,
    nothing, phases. finishes: a row a phase. The rest is as in `rays` and `shading`.
    """
    direction = camera[3]
    origin, normal = np.empty(3), np.empty(3)
    share = 1.0 / (sampling * sampling)
    for row in range(first, last):
        for column in range(out.shape[1]):
            for s in range(sampling * sampling):
                right = column + (s % sampling + 0.5) / sampling - 0.5
                down = row + (s // sampling + 0.5) / sampling - 0.5
                for k in range(3):
                    origin[k] = camera[0, k] + right * camera[1, k] + down * camera[2, k]
                t, flat = hit(
                    field, occupied, origin, direction, box, plane, stretch, lights[1], normal
                )
                if t == FAR:
                    for c in range(3):
                        out[row, column, c] += share * palette[0, c]
                    continue
                x, y, z = point(origin, direction, t)
                phase = _label(labels, x, y, z, normal)
                nx, ny, nz = normal[0] / stretch[0], normal[1] / stretch[1], normal[2] / stretch[2]
                way = way_through(
                    pyramid, offsets, shapes, x + nx, y + ny, z + nz, lights[0], box, plane, stretch
                )  # fmt: skip
                inner = 0.0
                if finishes[phase, 3] > 0:
                    inner = way_through(
                        pyramid, offsets, shapes, x - DEPTH * nx, y - DEPTH * ny, z - DEPTH * nz,
                        lights[0], box, plane, stretch,
                    )  # fmt: skip
                around = openness(
                    pyramid, offsets, shapes, directions, x + nx, y + ny, z + nz, normal, box,
                    plane, stretch,
                )  # fmt: skip
                add_reflection(
                    palette[3 + phase], finishes[phase], palette[1 if flat else 2], normal, lights,
                    strength, way, inner, around, out[row, column], share,
                )  # fmt: skip

"""Gaussian smoothing, one axis after another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs

_REACH = 3.5  # of the kernel, in sigma: what is cut off weighs 5e-4


def gaussian(values: np.ndarray, sigma: float | Sequence[float] | np.ndarray) -> np.ndarray:
    """Smooth values with a Gaussian of `sigma` voxels (one, or one per axis); beyond the faces the
    last voxel is repeated.

    Returns
    -------
    smooth : float32 array, the shape of `values`
    """
    smooth = np.ascontiguousarray(values, np.float32)
    sigmas = np.broadcast_to(np.asarray(sigma, np.float64), (smooth.ndim,))
    for axis, width in enumerate(sigmas):
        if width > 0 and smooth.shape[axis] > 1:
            smooth = _along(smooth, axis, _weights(float(width)))
    return smooth if smooth is not values else smooth.copy()


def reach_of(sigma: float) -> int:
    """Return the voxels to either side that a smoothed voxel depends on."""
    return int(np.ceil(_REACH * sigma))


def _weights(sigma: float) -> np.ndarray:
    """Return the weights of offsets 0, 1, 2, ...; both sides together sum to 1."""
    offset = np.arange(reach_of(sigma) + 1)
    weight = np.exp(-0.5 * (offset / sigma) ** 2)
    return (weight / (2 * weight.sum() - weight[0])).astype(np.float32)


def _along(values: np.ndarray, axis: int, weights: np.ndarray) -> np.ndarray:
    side = values.shape[axis]
    lines = values.reshape(-1, side, int(np.prod(values.shape[axis + 1 :])))
    out = np.empty_like(lines)
    for_slabs(lambda a, b: _convolve(lines, weights, out, a, b), len(lines) * side)
    return out.reshape(values.shape)


@kernel
def _convolve(lines, weights, out, begin, end):
    """Convolve rows; row k = line * side + place; along the last axis a row is one voxel."""
    _, side, width = lines.shape
    last = side - 1
    for k in range(begin, end):
        line, at = k // side, k % side
        if width == 1:
            total = weights[0] * lines[line, at, 0]
            for t in range(1, len(weights)):
                total += weights[t] * (
                    lines[line, max(at - t, 0), 0] + lines[line, min(at + t, last), 0]
                )
            out[line, at, 0] = total
            continue
        row = out[line, at]
        middle = lines[line, at]
        for x in range(width):
            row[x] = weights[0] * middle[x]
        for t in range(1, len(weights)):
            weight = weights[t]
            low, high = lines[line, max(at - t, 0)], lines[line, min(at + t, last)]
            for x in range(width):
                row[x] += weight * (low[x] + high[x])

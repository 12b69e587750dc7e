"""Neighbourhood vectors: cubes of w^3 voxels, projected on their principal components, exactly.

The fields are int8 and the basis is rounded to integers small enough that every partial sum of a projection stays below
2^24, so float32 matrix products are exact: whatever the BLAS, its threads and the size of the batch, the bits agree.
Distances between int16 features then are exact int32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs, one_blas_thread

SCALE = 8
"""A feature is SCALE times the projection, so a squared distance is SCALE**2 times the neighbourhood's (at most 2^31)."""

_EXACT = 2**24 / 127 * 0.98
_SAMPLES = 8192
_ROWS = 1 << 12  # rows a product takes at once: 8 MiB of float32 for 8^3, about the cache


@dataclass(frozen=True)
class Basis:
    """Principal components of the neighbourhoods of an exemplar.

    `vectors` is (C * w^3, D) float32 holding integers; `scale` is what an orthonormal vector was multiplied by;
    `explained` the share of variance kept, 0..1.
    """

    vectors: np.ndarray
    scale: float
    width: int
    explained: float


def principal_basis(field: np.ndarray, *, width: int, variance: float, most: int) -> Basis:
    """The leading components of the neighbourhoods of (C, Z, Y, X) int8: as many as explain `variance`, up to `most`.

    The covariance comes from up to 8192 neighbourhoods spread evenly over the exemplar, summed exactly.
    """
    windows = _windows(field, width, 1)
    corners = np.unravel_index(_spread(int(np.prod(windows.shape[1:4]))), windows.shape[1:4])
    sample = _rows(windows, corners).astype(np.float64)
    total = sample.sum(0)
    with one_blas_thread():
        covariance = sample.T @ sample - np.outer(total, total) / len(sample)
        eigenvalues, vectors = np.linalg.eigh(covariance)
    eigenvalues, vectors = np.maximum(eigenvalues[::-1], 0), vectors[:, ::-1]
    share = np.cumsum(eigenvalues) / max(eigenvalues.sum(), 1e-30)
    count = min(most, int(np.searchsorted(share, variance)) + 1, len(share))
    kept = vectors[:, :count]
    # An eigenvector's sign is arbitrary and differs between LAPACKs: the entry of largest size is made positive.
    kept = kept * np.sign(kept[np.abs(kept).argmax(0), np.arange(count)])
    scale = _EXACT / np.sqrt(len(kept))
    return Basis(np.rint(kept * scale).astype(np.float32), scale, width, float(share[count - 1]))


def project(field: np.ndarray, basis: Basis, *, step: int) -> np.ndarray:
    """Features (gz, gy, gx, D) int16 of the neighbourhoods at every `step`-th corner of (C, Z, Y, X) int8."""
    windows = _windows(field, basis.width, step)
    grid = windows.shape[1:4]
    features = np.empty((*grid, basis.vectors.shape[1]), np.int16)
    factor = np.float32(SCALE / basis.scale)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            for y0 in range(0, grid[1], max(1, _ROWS // grid[2])):
                block = windows[:, z, y0 : y0 + max(1, _ROWS // grid[2])]
                rows = np.ascontiguousarray(block.transpose(1, 2, 0, 3, 4, 5), np.float32).reshape(
                    -1, len(basis.vectors)
                )
                features[z, y0 : y0 + block.shape[1]] = np.rint(rows @ basis.vectors * factor).reshape(
                    block.shape[1], grid[2], -1
                )

    for_slabs(work, grid[0], least=2)
    return features


def basis_bytes(length: int) -> int:
    """Memory that `principal_basis` takes for vectors of `length`: the sample in float64, and the eigenproblem."""
    return 8 * _SAMPLES * length + 24 * length**2


def block_bytes(basis: Basis, grid: tuple[int, ...]) -> int:
    """Memory that `project` takes per thread beyond its result."""
    length, count = basis.vectors.shape
    return min(_ROWS, grid[1] * grid[2]) * (4 * length + 16 * count)


def grid_shape(shape: tuple[int, ...], *, width: int, step: int) -> tuple[int, ...]:
    """How many neighbourhoods, `step` apart, cover `shape`; the last may reach past its end."""
    return tuple(-(-(max(side, width) - width) // step) + 1 for side in shape)


def covered_shape(grid: tuple[int, ...], *, width: int, step: int) -> tuple[int, ...]:
    """The voxels that a grid of neighbourhoods covers."""
    return tuple((count - 1) * step + width for count in grid)


def _windows(field: np.ndarray, width: int, step: int) -> np.ndarray:
    views = np.lib.stride_tricks.sliding_window_view(field, (1, width, width, width))
    return views[:, ::step, ::step, ::step, 0]


def _rows(windows: np.ndarray, corners: tuple[np.ndarray, ...]) -> np.ndarray:
    picked = windows[:, corners[0], corners[1], corners[2]]
    return picked.transpose(1, 0, 2, 3, 4).reshape(len(corners[0]), -1)


def _spread(count: int) -> np.ndarray:
    if count <= _SAMPLES:
        return np.arange(count)
    return np.arange(_SAMPLES) * count // _SAMPLES

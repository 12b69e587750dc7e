"""Principal components of neighbourhoods, with the same bits on every machine.

LAPACK chooses its instructions by the processor, so its last bits differ between machines, and a
search that depends on them takes another path. Here every sum runs in a fixed order: subspace
iteration (Halko, Martinsson, Tropp 2011, doi:10.1137/090771806, section 4.5) and a small Jacobi
rotation scheme. It is also faster than a full decomposition where few vectors of many are wanted.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import one_blas_thread
from trabecula.synth.shared.matching.neighbourhoods import Basis, block_sums, box_of, gather

_EXACT = 2**24 / 127 * 0.98  # over the largest value and the norm of its row
_SAMPLES = 8192
_WIDE = 8  # voxels: a neighbourhood that is described by enough blocks
# of the variance that may be dropped, the share that is left for sums over blocks
_BLOCKS_MISS = 0.4
_ITERATIONS = 12
_SPARE = 8  # vectors carried along beyond those wanted: they speed up the last ones


def principal_basis(
    field: np.ndarray,
    allowed: np.ndarray | None = None,
    *,
    width: int,
    variance: float,
    most: int,
    grain: int = 1,
    flat: bool = False,
) -> Basis:
    """Return the leading components of the neighbourhoods of (C, Z, Y, X) int8: as many as explain
    `variance`, up to `most`.

    The covariance comes from up to 8192 neighbourhoods spread evenly over those that are `allowed`
    ((gz, gy, gx) bool, by their first corner; default all), summed exactly. `grain` 2 needs an even
    width. `flat` neighbourhoods are squares of one plane z.
    """
    box, grains = box_of(width, flat=flat), box_of(grain, flat=flat)
    grid = tuple(side - reach + 1 for side, reach in zip(field.shape[1:], box, strict=True))
    ones = np.arange(np.prod(grid)) if allowed is None else np.flatnonzero(allowed)
    chosen = ones[_spread(len(ones))]
    blocks = np.ascontiguousarray(block_sums(field, grains))
    sample = np.empty((len(chosen), len(field) * int(np.prod(box) // np.prod(grains))), np.float32)
    places = np.unravel_index(chosen, grid)
    corners = np.asarray(np.ravel_multi_index(places, blocks.shape[1:]))
    gather(blocks, corners, box, grains, sample)
    total = sample.sum(0, dtype=np.float64)
    with one_blas_thread():
        covariance = _gram(sample, exact=grain == 1) - np.outer(total, total) / len(sample)
    count = min(most, len(covariance))
    eigenvalues, vectors = leading_vectors(covariance, count)
    share = np.cumsum(np.maximum(eigenvalues, 0)) / max(np.trace(covariance), 1e-30)
    count = min(count, int(np.searchsorted(share, variance)) + 1)
    kept = vectors[:, :count]
    # An eigenvector's sign is arbitrary: the entry of largest size is made positive.
    kept = kept * np.where(kept[np.abs(kept).argmax(0), np.arange(count)] < 0, -1.0, 1.0)
    scale = _EXACT / np.sqrt(len(kept)) / int(np.prod(grains))
    return Basis(
        np.rint(kept * scale).astype(np.float32), scale, width, float(share[count - 1]), grain, flat
    )


def _gram(sample: np.ndarray, *, exact: bool) -> np.ndarray:
    """Compute sample.T @ sample in whole numbers: float32 products of int8 values over 1024 rows at
    a time stay below 2^24.
    """
    if not exact:  # sums of blocks are too large for that
        wide = sample.astype(np.float64)
        return wide.T @ wide
    total = np.zeros((sample.shape[1],) * 2)
    for start in range(0, len(sample), 1024):
        rows = sample[start : start + 1024]
        total += rows.T @ rows
    return total


def basis_bytes(length: int, count: int) -> int:
    """Forecast the memory of `principal_basis` for `count` vectors of `length`: the sample in
    float32, and covariances.
    """
    return 4 * min(_SAMPLES, count) * length + 28 * length**2


def _spread(count: int) -> np.ndarray:
    if count <= _SAMPLES:
        return np.arange(count)
    return np.arange(_SAMPLES) * count // _SAMPLES


def grain_of(width: int, *, smooth: bool) -> int:
    """Return the edge of the blocks whose sums describe neighbourhoods of a width: 2 where the
    field is smooth, else 1.

    Distances on the finest level are so smooth that ten components hold them, and those of blocks
    are nearly the same ones.
    """
    return 2 if smooth and width >= _WIDE and width % 2 == 0 else 1


def variance_in(grain: int, variance: float) -> float:
    """Return the share of the blocks' variance to keep for `variance` of all: the variance within a
    block is missing from it.
    """
    return variance if grain == 1 else 1 - (1 - variance) * _BLOCKS_MISS


def leading_vectors(covariance: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the `count` largest eigenvalues, falling, and their orthonormal vectors (n, count), of
    a symmetric float64 matrix.
    """
    n = len(covariance)
    block = min(n, count + _SPARE)
    matrix = np.ascontiguousarray(covariance, np.float64)
    # A start that is no eigenvector's orthogonal complement: columns of the matrix itself, spread
    # evenly.
    basis = np.ascontiguousarray(matrix[:, np.arange(block) * n // block])
    for _ in range(_ITERATIONS):
        _orthonormalise(basis)
        basis = _product(matrix, basis)
    _orthonormalise(basis)
    image = _product(matrix, basis)
    small = _product(np.ascontiguousarray(basis.T), image)
    turn = _jacobi((small + small.T) / 2)
    values = np.diagonal(_product(np.ascontiguousarray(turn.T), _product(small, turn)))
    order = np.argsort(-values, kind="stable")[:count]
    return values[order], _product(basis, np.ascontiguousarray(turn[:, order]))


@kernel
def _product(a, b):
    result = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                result[i, j] += a[i, k] * b[k, j]
    return result


@kernel
def _orthonormalise(basis):
    """Orthonormalise columns by Gram and Schmidt, twice over; a column that depends on those before
    becomes zero.
    """
    n, count = basis.shape
    for j in range(count):
        before = 0.0
        for i in range(n):
            before += basis[i, j] * basis[i, j]
        for _ in range(2):
            for k in range(j):
                along = 0.0
                for i in range(n):
                    along += basis[i, k] * basis[i, j]
                for i in range(n):
                    basis[i, j] -= along * basis[i, k]
        length = 0.0
        for i in range(n):
            length += basis[i, j] * basis[i, j]
        scale = 1 / np.sqrt(length) if length > 1e-20 * before else 0.0
        for i in range(n):
            basis[i, j] *= scale


@kernel
def _jacobi(matrix):
    """Return the rotation (n, n) that makes a small symmetric matrix diagonal, by cyclic sweeps."""
    n = len(matrix)
    a = matrix.copy()
    turn = np.eye(n)
    for _ in range(30):
        off, all_of_it = 0.0, 0.0
        for p in range(n):
            for q in range(n):
                all_of_it += a[p, q] * a[p, q]
                off += a[p, q] * a[p, q] if p != q else 0.0
        if off <= 1e-24 * all_of_it:
            break
        for p in range(n):
            for q in range(p + 1, n):
                if a[p, q] == 0:
                    continue
                half = (a[q, q] - a[p, p]) / (2 * a[p, q])
                t = 1 / (abs(half) + np.sqrt(half * half + 1))
                t = t if half >= 0 else -t
                c = 1 / np.sqrt(t * t + 1)
                s = t * c
                for k in range(n):
                    a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
                for k in range(n):
                    a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
                for k in range(n):
                    turn[k, p], turn[k, q] = (
                        c * turn[k, p] - s * turn[k, q],
                        s * turn[k, p] + c * turn[k, q],
                    )
    return turn

"""The leading eigenvectors of a covariance, the same bits on every machine.

LAPACK chooses its instructions by the processor, so its last bits differ between machines, and a
search that hangs on them takes another path. Here every sum runs in a fixed order: subspace
iteration (Halko, Martinsson, Tropp 2011, doi:10.1137/090771806, section 4.5) and a small Jacobi
rotation scheme. It is also faster than a full decomposition where few vectors of many are wanted.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel

_ITERATIONS = 12
_SPARE = 8  # vectors carried along beyond those wanted: they speed up the last ones


def leading_vectors(covariance: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` largest eigenvalues, falling, and their orthonormal vectors (n, count), of a
    symmetric float64 matrix.
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
    """Gram and Schmidt, twice over, by columns; a column that depends on those before becomes zero."""
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
    """The rotation (n, n) that makes a small symmetric matrix diagonal, by cyclic sweeps."""
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

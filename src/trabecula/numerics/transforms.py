"""Fourier transforms: fast sides, and sums over all pairs of voxels an offset apart."""

from __future__ import annotations

import numpy as np


def fast_side(side: int) -> int:
    """Return the smallest number from `side` up whose only prime factors are 2, 3 and 5.

    7 and 11 cost NumPy's real transform twice the time.
    """
    while True:
        rest = side
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return side
        side += 1


def sums_by_offset(values: np.ndarray, reach: tuple[int, ...]) -> np.ndarray:
    """Return the sum of v(x) v(x + k) over the pairs that fit into the array, for every offset k.

    Where an offset and its mirror images count as one, `measure.correlation.fourier` takes a fifth
    of the time.

    Parameters
    ----------
    values : array of any number of axes
        Taken as float32.
    reach : int per axis
        Largest offset along it, below the side.

    Returns
    -------
    sums : float32 array, (2 reach + 1 along every axis)
        Offset 0 in the middle.
    """
    sides = [fast_side(side + far) for side, far in zip(values.shape, reach, strict=True)]
    axes = tuple(range(values.ndim))
    spectrum = np.fft.rfftn(values.astype(np.float32, copy=False), sides, axes)
    power = spectrum.real**2 + spectrum.imag**2
    del spectrum
    sums = np.fft.irfftn(power, sides, axes)
    near = [np.arange(-far, far + 1) % side for far, side in zip(reach, sides, strict=True)]
    return sums[np.ix_(*near)]

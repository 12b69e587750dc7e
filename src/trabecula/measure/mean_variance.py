"""Variance of spatial means over a volume, from one image: Matheron's integral range.

The mean of a stationary field over a box of V voxels with sides L has the variance (Matheron 1971;
Lantuejoul 1991, doi:10.1111/j.1365-2818.1991.tb03111.x)

    v = sum_h C(h) w(h),    w(h) = prod_i (1 - |h_i| / L_i) / V,

which is C(0) A / V for a box many times as wide as the covariance C reaches; A is the integral
range, the volume of one independent part.

C comes from the one image, by pairs of places. Its own mean was subtracted, so that every estimate
C'(h) is too low by v. Where C is 0 beyond the reach R, C(h) = C'(h) + v holds there, and

    v = sum_{|h| <= R} w(h) (C'(h) + v) = A' / (1 - W),    W = sum_{|h| <= R} w(h).

R is the first radius whose ball holds `WINDOW` times the integral of |C| / C(0) (Sokal 1997,
doi:10.1007/978-1-4899-0319-8_6, "self-consistent window", in a volume). The variance that is found
is itself as uncertain as one of 1 / W - 1 degrees of freedom: a spectral estimate at frequency 0
with a window of that width (Priestley 1981, "Spectral Analysis and Time Series", section 6.2.3).
Where that leaves more than `ENOUGH` of them, R grows: longer correlations than expected are then
seen as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from trabecula.core.checks import as_shape, as_spacing
from trabecula.core.errors import InputError
from trabecula.numerics.transforms import fast_side

WINDOW = 16.0
"""Volume of the ball of lags, in integrals of |C| / C(0): it holds 96 % of the integral of an
exponential covariance, and all of a Gaussian one.
"""

ENOUGH = 20.0
"""Degrees of freedom: more would make an interval 6 % narrower at most."""

WIDEST = 0.25
"""Largest W: with fewer than 3 degrees of freedom nothing is known about a variance."""

MOST_CELLS = 1_000_000
"""A larger image is averaged over cells of voxels first: means and long distances stay."""


def variance_of_means(
    fields: Sequence[np.ndarray] | np.ndarray,
    shape: Sequence[int],
    *,
    spacing: Sequence[float] | None = None,
) -> np.ndarray:
    """Return the covariance matrix of the means of local fields over an independent box of the same
    material.

    Parameters
    ----------
    fields : array, (C, Z, Y, X) or (C, Y, X), or a sequence of C arrays
        Jointly stationary, of one image.
    shape : sequence of int
        Sides of the box, voxels; it may be larger or smaller than the image.
    spacing : sequence of float, optional
        Edges of a voxel: distances are compared in space. Default: cubes.

    Returns
    -------
    covariance : float64 array, (C, C)
        No eigenvalue is negative.

    Raises
    ------
    InputError
        As `SpatialCovariance.of`; a shape of other axes than the fields have.

    Examples
    --------
    >>> coins = np.random.default_rng(0).integers(0, 2, (1, 300, 300))
    >>> float(variance_of_means(coins, (10, 10))[0, 0].round(4))
    0.0025
    """
    found = SpatialCovariance.of(fields, spacing=spacing)
    return found.of_means(as_shape(shape, ndim=len(found.shape)))


@dataclass(frozen=True)
class SpatialCovariance:
    """Covariances of C local fields between places of a material, as one image shows them."""

    means: np.ndarray
    """Of the image, (C,)."""
    variances: np.ndarray
    """Of a single voxel, (C,)."""
    reach: np.ndarray
    """Distance from which each field's covariance is taken as 0, in units of `spacing`, (C,)."""
    decayed: np.ndarray
    """Whether the image is long enough to show that the covariance ends, bool (C,). Where not, the
    variance of a mean is rather too small."""
    freedom: np.ndarray
    """Degrees of freedom of the variance of each mean, (C,)."""
    least_side: np.ndarray
    """Of a cube (square) long enough to show where each covariance ends, in units of `spacing`,
    (C,); of fields that have not decayed at least that."""
    shape: tuple[int, ...]
    """Of the image, voxels."""
    _cell: int
    """Edge of a cell of voxels."""
    _distance: np.ndarray
    """Of every lag, in units of `spacing`; the octant of lags from 0 up, in cells."""
    _sums: np.ndarray
    """Mean over the lag's mirror images of the sum of products, (C, C, *lags)."""
    _pairs: np.ndarray
    """Pairs of cells of every lag."""

    @classmethod
    def of(
        cls,
        fields: Sequence[np.ndarray] | np.ndarray,
        *,
        spacing: Sequence[float] | None = None,
    ) -> SpatialCovariance:
        """Estimate the covariances of fields of one image; parameters as of `variance_of_means`.

        Raises
        ------
        InputError
            Fields of different shapes, not of 2 or 3 axes, or with values that are not finite; a
            spacing of other axes.
        """
        arrays = [np.asarray(field) for field in fields]
        _check(arrays)
        shape = arrays[0].shape
        steps = as_spacing(spacing, ndim=len(shape))
        cell = _cell_edge(shape)
        means = np.array([_plane_mean(array) for array in arrays])
        scatter = np.array(
            [_plane_mean(array, mean) for array, mean in zip(arrays, means, strict=True)]
        )
        cells = [window_means(array, (cell,) * array.ndim) for array in arrays]
        distance = _lag_distances(cells[0].shape, [cell * step for step in steps])
        reach = tuple(side - 1 for side in distance.shape)
        sums = _mirrored_sums(cells, reach)
        pairs = _lag_product(
            [side - np.arange(far + 1) for side, far in zip(cells[0].shape, reach, strict=True)]
        )
        chosen = [
            _choose_reach(sums[c, c], pairs, distance, cells[0].size) for c in range(len(arrays))
        ]
        found = cls(
            means=means,
            variances=scatter,
            reach=np.array([one[0] for one in chosen]),
            decayed=np.array([one[1] for one in chosen]),
            freedom=np.array([one[2] for one in chosen]),
            least_side=cell
            * np.array([one[3] for one in chosen])
            * math.prod(steps) ** (1 / len(shape)),
            shape=shape,
            _cell=cell,
            _distance=distance,
            _sums=sums,
            _pairs=pairs,
        )
        # in place: the image's own mean was subtracted
        scatter += np.diag(found.of_means(shape))
        return found

    def of_means(self, shape: Sequence[int]) -> np.ndarray:
        """Return the covariance matrix of the means over an independent box, (C, C).

        Parameters
        ----------
        shape : sequence of int
            Sides of the box, voxels.
        """
        weights = _mirror_images(self._distance.shape) * _lag_product(
            [
                np.maximum(1 - self._cell * np.arange(lags) / side, 0) * self._cell / side
                for lags, side in zip(self._distance.shape, shape, strict=True)
            ]
        )
        count = len(self.reach)
        found = np.zeros((count, count))
        even = np.zeros(count, bool)
        for i in range(count):
            usual, least = self._summed(i, i, weights), self._least(i, i, weights)
            found[i, i], even[i] = max(usual, least), least > usual
        for i, j in combinations(range(count), 2):
            # both variances of a pair and what they have in common, by one rule where possible
            rule = self._least if even[i] or even[j] else self._summed
            limit = math.sqrt(found[i, i] * found[j, j])
            found[i, j] = found[j, i] = np.clip(rule(i, j, weights), -limit, limit)
        return _without_negative(found)

    def samples(self) -> np.ndarray:
        """Return how many independent voxels would know the means as well as the image does, (C,).

        Infinite where a mean has no variance.
        """
        own = np.diag(self.of_means(self.shape))
        return np.divide(self.variances, own, out=np.full(len(own), np.inf), where=own > 0)

    def _own(self, i: int, j: int, near: np.ndarray) -> float:
        """Return the covariance of the image's own means."""
        many = _mirror_images(near.shape)
        squared = float(self._pairs.flat[0]) ** 2
        within = float((many * self._sums[i, j])[near].sum()) / squared
        return within / (1 - float((many * self._pairs)[near].sum()) / squared)

    def _summed(self, i: int, j: int, weights: np.ndarray) -> float:
        """Return the covariance of two means: the sum over the lags within reach."""
        near = self._distance <= max(self.reach[i], self.reach[j])
        known = (self._sums[i, j] / self._pairs)[near] + self._own(i, j, near)
        return float(weights[near] @ known)

    def _least(self, i: int, j: int, weights: np.ndarray) -> float:
        """Return a covariance whose matrix has no negative eigenvalue, and too low where C falls
        slowly: lags weighted by the overlap of two balls, whose transform has no negative value.

        It counts for a material as even as a crystal, whose covariance sums to almost nothing.
        """
        apart = np.minimum(self._distance / (max(self.reach[i], self.reach[j]) or 1.0), 1.0)
        overlap = 1 - 1.5 * apart + 0.5 * apart**3
        return float((weights * overlap * self._sums[i, j]).sum()) / float(self._pairs.flat[0])


def _check(arrays: Sequence[np.ndarray]) -> None:
    shapes = sorted({array.shape for array in arrays})
    if len(shapes) != 1 or len(shapes[0]) not in (2, 3) or 0 in shapes[0]:
        raise InputError(
            f"local fields of shapes {shapes}: give fields of one image, (C, Z, Y, X) or (C, Y, X)"
        )
    if max(shapes[0]) == 1:
        raise InputError("the local fields are of one voxel, which has no neighbours")
    for n, array in enumerate(arrays):
        if not all(np.isfinite(plane).all() for plane in array):
            raise InputError(f"local field {n} holds values that are not finite: give numbers only")


def _plane_mean(array: np.ndarray, centre: float | None = None) -> float:
    """Return the mean, or the mean square around a centre, without a copy of the whole."""
    planes = (plane.astype(np.float64) for plane in array)
    if centre is None:
        return math.fsum(plane.mean() for plane in planes) / len(array)
    return math.fsum(((plane - centre) ** 2).mean() for plane in planes) / len(array)


def _cell_edge(shape: tuple[int, ...]) -> int:
    edge = 1
    while math.prod(max(side // edge, 1) for side in shape) > MOST_CELLS:
        edge += 1
    return edge if min(shape) >= edge else 1


def window_means(array: np.ndarray, window: Sequence[int]) -> np.ndarray:
    """Return the means of the windows (voxels a side) that fit beside each other."""
    if max(window) == 1:
        return array.astype(np.float64)
    counts = [side // edge for side, edge in zip(array.shape, window, strict=True)]
    inner = array[tuple(slice(count * edge) for count, edge in zip(counts, window, strict=True))]
    found = np.zeros(counts)
    for place in range(window[0]):  # a layer of windows at a time takes little memory
        rows = inner[place :: window[0]].astype(np.float32)
        for axis, count in enumerate(counts[1:], start=1):
            rows = np.add.reduceat(rows, window[axis] * np.arange(count), axis=axis)
        found += rows
    return found / math.prod(window)


def _lag_distances(sides: tuple[int, ...], steps: Sequence[float]) -> np.ndarray:
    """Return the length of every lag from 0 up, as far as a ball of `WIDEST` may reach."""
    volume = 2 * WIDEST * math.prod(side * step for side, step in zip(sides, steps, strict=True))
    ball = math.pi if len(sides) == 2 else 4 / 3 * math.pi
    far = (volume / ball) ** (1 / len(sides))
    lines = [
        step * np.arange(min(side, math.ceil(far / step) + 1))
        for side, step in zip(sides, steps, strict=True)
    ]
    return np.asarray(np.sqrt(sum(line**2 for line in np.ix_(*lines))))


def _lag_product(lines: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(math.prod(np.ix_(*lines)), dtype=np.float64)


def _mirror_images(lags: tuple[int, ...]) -> np.ndarray:
    """Return how many lags each one of the octant stands for: itself and its mirror images."""
    return _lag_product([np.where(np.arange(count) == 0, 1, 2) for count in lags])


def _mirrored_sums(cells: Sequence[np.ndarray], reach: tuple[int, ...]) -> np.ndarray:
    """Return the sum of f_i(x) f_j(x + h) over the pairs that fit, less the means, mean over the
    mirror images of h: (C, C, *lags).
    """
    sides = [fast_side(side + far) for side, far in zip(cells[0].shape, reach, strict=True)]
    axes = tuple(range(len(sides)))
    spectra = [np.fft.rfftn(cell - cell.mean(), sides, axes) for cell in cells]
    count = len(cells)
    found = np.empty((count, count, *(far + 1 for far in reach)))
    for i in range(count):
        for j in range(i, count):
            sums = np.fft.irfftn(spectra[i].conj() * spectra[j], sides, axes)
            for axis, far in enumerate(reach):
                ahead = np.arange(far + 1)
                sums = (sums.take(ahead, axis) + sums.take(-ahead, axis, mode="wrap")) / 2
            found[i, j] = found[j, i] = sums
    return found


def _choose_reach(
    sums: np.ndarray, pairs: np.ndarray, distance: np.ndarray, cells: int
) -> tuple[float, bool, float, float]:
    """Choose the radius of the lags; return it, whether the covariance ends there, the degrees of
    freedom, and the side, in cells, of an image that would show it.
    """
    step = float(np.sort(distance, axis=None)[1]) if distance.size > 1 else 1.0
    shells = np.floor(distance.ravel() / step + 0.5).astype(np.int64)
    many = _mirror_images(distance.shape).ravel()
    lags = np.bincount(shells, many)
    products = np.bincount(shells, many * sums.ravel())
    fits = np.bincount(shells, many * pairs.ravel())
    share = np.cumsum(fits) / cells**2
    last = max(int(np.searchsorted(share, WIDEST, side="right")) - 1, 0)
    own = np.cumsum(products)[: last + 1] / cells**2 / (1 - share[: last + 1])
    shell_means = products / np.maximum(fits, 1)
    if shell_means[0] <= 0:
        return 0.0, True, math.inf, 1.0
    side = 0.0
    widest = 1 / (1 + ENOUGH)
    for r in range(1, last + 1):
        known = shell_means[: r + 1] + own[r]
        integral = float(lags[: r + 1] @ np.abs(known)) / max(float(known[0]), shell_means[0])
        side = float(WINDOW * integral / WIDEST) ** (1 / distance.ndim)
        ample = r < last and share[r + 1] <= widest
        if not ample and lags[: r + 1].sum() >= WINDOW * integral:
            return (r + 0.5) * step, True, 1 / share[r] - 1, side
    return (last + 0.5) * step, False, 1 / share[last] - 1, max(side, cells ** (1 / distance.ndim))


def _without_negative(matrix: np.ndarray) -> np.ndarray:
    """Return the covariance matrix without negative eigenvalues; variances stay."""
    deviations = np.sqrt(np.diag(matrix))
    scale = np.where(deviations > 0, deviations, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values[0] >= 0:
        return matrix
    clipped = (vectors * np.maximum(values, 0)) @ vectors.T
    left = np.sqrt(np.diag(clipped))
    scale = np.divide(deviations, left, out=np.zeros_like(left), where=left > 0)
    return np.asarray(clipped * np.outer(scale, scale))

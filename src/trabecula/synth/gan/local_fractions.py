"""Fractions of the phases around every cell of the latent, which a generator is given beside the
noise.

A generator reaches some 50 voxels, a scan is denser here and sparser there over longer distances:
samples of a generator alone differ less than parts of the scan. Therefore the generator learns to
make a given fraction around each cell, from crops whose fractions are known. For an unlimited
material they are drawn as a smooth random field with the covariance and the distribution of the
exemplar's; a target porosity takes its place.

Around a cell means: the means of cells of 8^3 voxels, averaged over 5 x 5 x 5 cells with weights
1 4 6 4 1 along every axis. The white noise and the filter are whole numbers, so that their
convolution is exact in any order: a page makes the same field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.gaussian_random import ONE, normal_cells, quantiles
from trabecula.measure.mean_variance import variance_of_means
from trabecula.numerics.transforms import sums_by_offset
from trabecula.synth.shared.gaussian.filters import fading_window, filter_of, radial_mean

REACH = 2
"""Cells on each side that count as around a cell."""

WEIGHTS = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
"""Of the cells around a cell along an axis."""

CELL = 8
"""Voxels of a cell along an edge."""

_FARTHEST = 8  # cells that the covariance reaches at most
_LEAST_SPREAD = 0.25  # of that of the windows of a picture, which is greater than that in space
_LEVELS = 65  # of the distribution's table
_WHOLE = 1 << 10  # what stands for the largest weight of the filter
_CORRECTIONS = 20  # of the filter's spectrum
_HALVINGS = 40  # of an interval of a few deviations


@dataclass(frozen=True)
class LocalFractions:
    """What a generator is given: the exemplar's local fractions as a random field.

    Attributes
    ----------
    mean, deviation : (K,) float64
        Of the fractions around the exemplar's cells. K is 1 for two phases, the fraction of the
        higher label; of more phases one for each.
    levels : (K, L) float64
        Quantiles of the same at equal steps of probability, in deviations from the mean.
    mixing : (K, K) float64
        Lower triangle by which independent fields become as correlated as the phases are.
    filter : (2 R + 1, 2 R + 1, 2 R + 1) int16
        White noise convolved with it has the exemplar's covariance between cells.
    response : (2, N) float64
        Fractions given everywhere alike, and those that came out, both rising; of more than two
        phases empty.
    """

    mean: np.ndarray
    deviation: np.ndarray
    levels: np.ndarray
    mixing: np.ndarray
    filter: np.ndarray
    response: np.ndarray

    @classmethod
    def of(cls, shares: np.ndarray) -> LocalFractions:
        """Learn the field from the fractions around every cell of an exemplar, (K, Z, Y, X)."""
        shares = shares.astype(np.float64)
        standard, mean, deviation = _standardised(shares)
        flat = standard.reshape(len(shares), -1)
        filter_ = _filter_for(_covariance_of(standard))
        return cls(mean, deviation, _levels_of(flat), _mixing_of(flat), filter_, np.zeros((2, 0)))

    @classmethod
    def of_pictures(cls, pictures: Sequence[np.ndarray]) -> LocalFractions:
        """Learn what fractions around cells are in space from pictures of the phases.

        Their covariance in space is that of the pictures, by distance, averaged over the cells.
        Distribution and correlation of the phases are those of windows of the pictures.

        Parameters
        ----------
        pictures : sequence of (K, Y, X) array
            Shares of the phases, at least 40 pixels along every side.
        """
        phases, middle = range(len(pictures[0])), (_FARTHEST,) * 3
        mean = np.array([np.concatenate([one[k].ravel() for one in pictures]).mean()
                         for k in phases])  # fmt: skip
        windows = np.concatenate([_windows_of(one) for one in pictures], axis=1)
        standard, _, spread = _standardised(windows[:, None, None])
        flat = standard.reshape(len(phases), -1)
        covariances = [_covariance_in_space([one[k] - mean[k] for one in pictures]) for k in phases]
        own = [max(covariance[middle], 0.0) ** 0.5 for covariance in covariances]
        deviation = np.maximum(own, _LEAST_SPREAD * spread)
        total = np.sum(covariances, axis=0)
        filter_ = _filter_for(total if total[middle] > 0 else np.zeros_like(total))
        return cls(mean, deviation, _levels_of(flat), _mixing_of(flat), filter_, np.zeros((2, 0)))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON that `from_json` reads."""
        return {name: np.asarray(getattr(self, name)).tolist() for name in _NAMES}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> LocalFractions:
        """Return what `to_json` described.

        Raises
        ------
        ValueError, TypeError, LookupError
            Not such a description.
        """
        parts = {
            name: np.asarray(plain[name], np.int16 if name == "filter" else np.float64)
            for name in _NAMES
        }
        found, count = cls(**parts), len(parts["mean"])
        shapes = {
            "deviation": (count,),
            "levels": (count, _LEVELS),
            "mixing": (count, count),
            "filter": (len(found.filter),) * 3,
        }
        wrong = [name for name, shape in shapes.items() if getattr(found, name).shape != shape]
        numbers = (part for name, part in parts.items() if name != "filter")
        if wrong or len(found.filter) % 2 == 0 or not all(np.isfinite(n).all() for n in numbers):
            raise ValueError("its local fractions are damaged")
        return found

    def page_parts(self) -> dict[str, Any]:
        """Return what a page needs to draw the same field: plain JSON."""
        return {
            "filter": self.filter.ravel().tolist(),
            "mixing": self.mixing.tolist(),
            "normal": _normal_levels().tolist(),
            "levels": self.levels.tolist(),
        }

    def draw(
        self, key: np.uint64, corner: Sequence[int], sides: Sequence[int], periods: Sequence[int]
    ) -> np.ndarray:
        """Draw the field of cells from `corner` on, in deviations from the mean.

        Parameters
        ----------
        key : of the seed's field
        corner, sides, periods : three ints
            Cells; a period of 0 does not repeat.

        Returns
        -------
        (K, *sides) float32 array
        """
        count, reach = len(self.mean), len(self.filter) // 2
        noise = np.empty((count, *(side + 2 * reach for side in sides)), np.float32)
        first = np.asarray(corner, np.int64) - reach
        normal_cells(noise, key, first, np.asarray(periods, np.int64), quantiles())
        whole, sums = self.filter.astype(np.float64), np.empty((count, *sides))
        for channel in range(count):
            _convolve(noise[channel].astype(np.float64) * ONE, whole, sums[channel])
        independent = sums * (1 / (ONE * float(np.sqrt((whole**2).sum()))))
        found = np.empty((count, *sides), np.float32)
        for channel, row in enumerate(self.mixing):
            normal = sum(
                (row[k] * independent[k] for k in range(channel + 1)), np.zeros(tuple(sides))
            )
            found[channel] = np.interp(normal, _normal_levels(), self.levels[channel])
        return found

    def given(self, fraction: np.ndarray | float) -> np.ndarray:
        """Return what to give for fractions of the higher of two phases to come out, in deviations
        from the mean.
        """
        asked, got = self.response
        return ((np.interp(fraction, got, asked) - self.mean[0]) / self.deviation[0]).astype(
            np.float32
        )

    def around(
        self, drawn: np.ndarray, fraction: float, weights: np.ndarray | None = None
    ) -> np.ndarray:
        """Shift what was drawn so that `fraction` of the higher of two phases comes out on average.

        Places that would be given more or less than the response knows are given the last that it
        knows, so that little varies near an end of `range`.

        Parameters
        ----------
        drawn : (Z, Y, X) array
            Deviations from the mean.
        fraction : float
        weights : (Z, Y, X) array, optional
            How much each place counts. Default: all alike.

        Returns
        -------
        (Z, Y, X) float32 array
            In deviations from the mean.
        """
        asked, got = self.response
        known = (asked - self.mean[0]) / self.deviation[0]
        low, high = known[0] - drawn.max(), known[-1] - drawn.min()
        for _ in range(_HALVINGS):
            shift = (low + high) / 2
            made = np.average(np.interp(drawn + shift, known, got), weights=weights)
            low, high = (low, shift) if made > fraction else (shift, high)
        return np.clip(drawn + (low + high) / 2, known[0], known[-1]).astype(np.float32)

    @property
    def range(self) -> tuple[float, float]:
        """Return the least and greatest fraction of the higher of two phases that comes out."""
        return float(self.response[1, 0]), float(self.response[1, -1])


_NAMES = ("mean", "deviation", "levels", "mixing", "filter", "response")


@cache
def _normal_levels() -> np.ndarray:
    """Return the standard normal numbers that stand for the levels."""
    return np.array([NormalDist().inv_cdf((i + 0.5) / _LEVELS) for i in range(_LEVELS)])


def _standardised(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return fractions (K, Z, Y, X) in deviations from their means, means and deviations."""
    flat = shares.reshape(len(shares), -1)
    mean, deviation = flat.mean(1), np.maximum(flat.std(1), 1e-6)
    standard = (shares - mean[:, None, None, None]) / deviation[:, None, None, None]
    return standard, mean, deviation


def _levels_of(standard: np.ndarray) -> np.ndarray:
    """Return the levels of fractions (K, N), in deviations."""
    return np.asarray(np.quantile(standard, (np.arange(_LEVELS) + 0.5) / _LEVELS, axis=1).T)


def _mixing_of(standard: np.ndarray) -> np.ndarray:
    """Return what mixes independent fields as fractions (K, N), in deviations, are correlated."""
    correlation = standard @ standard.T / standard.shape[1]
    # They add up to 1, so that the last one follows from the others.
    np.fill_diagonal(correlation, 1 + 1e-6)
    return np.asarray(np.linalg.cholesky(correlation))


def _windows_of(picture: np.ndarray) -> np.ndarray:
    """Return the fractions around the cells of a picture (K, Y, X), (K, N)."""
    phases, *sides = picture.shape
    rows, columns = (side // CELL for side in sides)
    cut = picture[:, None, : CELL * rows, : CELL * columns]
    cells = np.concatenate([cell_means(share, CELL) for share in cut])
    for axis in (1, 2):
        inner = cells.shape[axis] - 2 * REACH
        places = [range(i, i + inner) for i in range(2 * REACH + 1)]
        parts = [w * cells.take(near, axis) for w, near in zip(WEIGHTS, places, strict=True)]
        cells = np.asarray(sum(parts))
    return cells.reshape(phases, -1)


def _covariance_in_space(deviations: Sequence[np.ndarray]) -> np.ndarray:
    """Return the covariance of fractions around cells by their offset, of an isotropic material
    that pictures (Y, X), whose mean was subtracted, show.
    """
    longest = _FARTHEST * CELL
    reach = (0, *(min(longest, *(min(one.shape) // 2 for one in deviations)),) * 2)
    sums = sum(sums_by_offset(one[None], reach) for one in deviations)
    pairs = sum(sums_by_offset(np.ones((1, *one.shape)), reach) for one in deviations)
    shape = (2 * longest + 1,) * 3
    voxels = radial_mean(np.asarray(sums), np.asarray(pairs), (longest,) * 3) * fading_window(shape)
    weights = np.repeat(WEIGHTS, CELL) / CELL
    both = np.correlate(weights, weights, "full")
    shares = np.zeros((2 * _FARTHEST + 1, 2 * longest + len(both)))
    for row, first in enumerate(range(0, CELL * len(shares), CELL)):
        shares[row, first : first + len(both)] = both
    inner = shares[:, len(both) // 2 : -(len(both) // 2)]
    found = np.einsum("az,by,cx,zyx->abc", inner, inner, inner, voxels, optimize=True)
    return np.asarray(found)


def _covariance_of(standard: np.ndarray) -> np.ndarray:
    """Return the mean covariance of fields (K, Z, Y, X), by offset.

    The fields' own means were subtracted, so that the covariance is too low by their variance.
    """
    sides = standard.shape[1:]
    reach = tuple(min(_FARTHEST, side // 2) for side in sides)
    own = float(np.mean(np.diag(variance_of_means(standard, sides))))
    pairs = sums_by_offset(np.ones(sides), reach)
    sums = np.mean([sums_by_offset(field, reach) for field in standard], axis=0)
    covariance = np.zeros((2 * _FARTHEST + 1,) * 3)
    inner = tuple(slice(_FARTHEST - far, _FARTHEST + far + 1) for far in reach)
    covariance[inner] = (sums / np.maximum(pairs, 1) + own) * fading_window(sums.shape)
    return covariance


def _filter_for(covariance: np.ndarray) -> np.ndarray:
    """Return the filter that gives white noise a covariance, in whole numbers."""
    if not covariance.max() > 0:  # the same everywhere
        covariance[(_FARTHEST,) * 3] = 1.0
    values = filter_of(covariance / covariance.max(), corrections=_CORRECTIONS).values
    return np.rint(values * (_WHOLE / abs(values).max())).astype(np.int16)


@kernel
def _convolve(noise, weights, sums):
    """Sum weights times the noise around every place of `sums`: whole numbers, so exact."""
    depth, height, width = sums.shape
    side = weights.shape[0]
    for z in range(depth):
        for y in range(height):
            sums[z, y, :] = 0.0
            for a in range(side):
                for b in range(side):
                    for c in range(side):
                        weight = weights[a, b, c]
                        for x in range(width):
                            sums[z, y, x] += weight * noise[z + a, y + b, x + c]


def cell_means(field: np.ndarray, cell: int, *, inside: np.ndarray | None = None) -> np.ndarray:
    """Return the means of a field (Z, Y, X) over cells, the last of which may be cut; cells
    outside `inside` take the nearest mean.

    Parameters
    ----------
    field : (Z, Y, X) array
    cell : int
        Edge, voxels.
    inside : (Z, Y, X) bool array, optional
        Where the field counts.
    """
    totals, counts = [], []
    for first in range(0, len(field), cell):  # a layer of cells at a time takes little memory
        part = field[first : first + cell].astype(np.float64)
        there = np.ones(part.shape, bool) if inside is None else inside[first : first + cell]
        totals.append(_cell_sums(np.where(there, part, 0.0), cell))
        counts.append(_cell_sums(there.astype(np.float64), cell))
    total, known = np.concatenate(totals), np.concatenate(counts)
    while not (known > 0).all():
        near, count = _spread(total / np.maximum(known, 1)), _spread((known > 0) * 1.0)
        empty = (known == 0) & (count > 0)
        total[empty], known[empty] = (near / np.maximum(count, 1))[empty], 1.0
    return np.asarray(total / known)


def _cell_sums(values: np.ndarray, cell: int) -> np.ndarray:
    for axis, side in enumerate(values.shape):
        values = np.add.reduceat(values, np.arange(0, side, cell), axis=axis)
    return values


def _spread(cells: np.ndarray) -> np.ndarray:
    """Return the sum over each cell and its neighbours."""
    padded = np.pad(cells, 1)
    for axis, side in enumerate(cells.shape):
        parts = [padded.take(range(i, i + side), axis) for i in range(3)]
        padded = np.add.reduce(parts)
    return padded

"""The target of sliced rounds, neighbourhoods of exemplars on their principal components, and
monotone transport to it along every axis.

A value goes to the place of its rank among the target's values, through histograms. Values that
share a bin of the common histogram go together, to the mean of the others over the ranks that they
cover. All of them are whole numbers, so that the result depends neither on the division into parts
nor on the order of these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.matching.neighbourhoods import SCALE, Basis, Triple, project
from trabecula.synth.shared.matching.principal_components import principal_basis

FINE = 4096  # what an orthonormal basis is multiplied by on the way back
_MOST = 1 << 16  # neighbourhoods of the exemplars that stand for all of them, about

BINS = 1024
"""Of a histogram along an axis."""

AT_ONCE = 1024
"""Values an axis that are worked on together: so many rows of 64 lie in the cache."""

Parts = Callable[[int, int], Iterable[np.ndarray]]
"""Rows (n, P) float32 of whole numbers that slab start..stop holds, a few at a time."""


@dataclass(frozen=True)
class SliceTarget:
    """Target of sliced rounds: neighbourhoods of exemplars on their principal components.

    `features` (N, P) float32 and `back` (P, C * voxels) float64 hold whole numbers, P is a power of
    two; `rest` (C,) int64 is what the components leave out of the mean, in 1 / UNIT of an int8
    step.
    """

    basis: Basis
    features: np.ndarray
    back: np.ndarray
    rest: np.ndarray


def slice_target(
    fields: Sequence[np.ndarray],
    *,
    width: int = 4,
    variance: float = 0.95,
    most: int = 64,
    flat: bool = False,
    weights: Sequence[np.ndarray] | None = None,
) -> SliceTarget:
    """Describe the neighbourhoods of fields (C, Z, Y, X) int8 of one number of channels, about 65
    thousand of them at most.

    Parameters
    ----------
    fields : sequence of arrays
        The exemplars at one resolution. The components are those of the first.
    width : int
        Voxels a side of a neighbourhood.
    variance : float
        Share that the components keep, 0..1.
    most : int
        Components at most.
    flat : bool
        Whether neighbourhoods are squares of one plane z, as of a picture (C, 1, Y, X), rather than
        cubes.
    weights : sequence of arrays (Z, Y, X), optional
        None below 0: how often neighbourhoods in the middle of each voxel count, over their mean.
    """
    basis = principal_basis(fields[0], width=width, variance=variance, most=most, flat=flat)
    count = basis.vectors.shape[1]
    size = 1 << max(2, (count - 1).bit_length())
    sides = [
        [side - w + 1 for side, w in zip(field.shape[1:], basis.box, strict=True)]
        for field in fields
    ]
    stride = max(1, round((sum(map(math.prod, sides)) / _MOST) ** (1 / 2 if flat else 1 / 3)))
    rows = np.concatenate(
        [project(field, basis, step=stride).reshape(-1, count) for field in fields]
    )
    if weights is not None:
        rows = rows[_chosen_rows(weights, basis.box, stride)]
    features = np.zeros((len(rows), size), np.float32)
    features[:, :count] = rows
    back = np.zeros((size, len(basis.vectors)))
    back[:count] = np.rint(basis.vectors.T.astype(np.float64) * (FINE / basis.scale))
    middle = (rows.sum(axis=0, dtype=np.float64) / len(rows)) @ back[:count] / (SCALE * FINE)
    rest = _mean_of_neighbourhoods(fields, basis.box) - middle.reshape(len(fields[0]), -1).mean(
        axis=1
    )
    rest = np.rint(UNIT * rest).astype(np.int64)
    return SliceTarget(basis, features, back, rest)


def _chosen_rows(weights: Sequence[np.ndarray], box: Triple, stride: int) -> np.ndarray:
    """Choose as many of the neighbourhoods as there are, each as often as it weighs (systematic
    sampling).
    """
    middles = [
        each[
            tuple(
                slice(w // 2, side - w + 1 + w // 2, stride)
                for side, w in zip(each.shape, box, strict=True)
            )
        ]
        for each in weights
    ]
    up_to = np.cumsum(np.concatenate([each.ravel() for each in middles]), dtype=np.float64)
    places = (np.arange(len(up_to)) + 0.5) * (up_to[-1] / len(up_to))
    return np.minimum(np.searchsorted(up_to, places), len(up_to) - 1)


def _mean_of_neighbourhoods(fields: Sequence[np.ndarray], box: Triple) -> np.ndarray:
    """Return the mean (C,) of all values in all neighbourhoods: a voxel near a face is in fewer of
    them.
    """
    sums, count = np.zeros(len(fields[0])), 0
    for field in fields:
        covers = [
            np.convolve(np.ones(side - w + 1, np.int64), np.ones(w, np.int64))
            for side, w in zip(field.shape[1:], box, strict=True)
        ]
        for axis, cover in enumerate(covers):  # sums of whole numbers: exact
            shape = [1, 1, 1]
            shape[axis] = -1
            covers[axis] = cover.reshape(shape)
        weights = covers[0] * covers[1] * covers[2]
        sums += [float(np.sum(channel * weights)) for channel in field]
        count += int(weights.sum())
    return np.asarray(sums / count)


@dataclass(frozen=True)
class Transport:
    """Along every axis of (n, P): bins of `size` (P,) from `low` (P,), and where the values of each
    go, `table` (P, BINS).
    """

    low: np.ndarray
    size: np.ndarray
    table: np.ndarray

    @classmethod
    def between(
        cls, ours: Parts, length: int, theirs: np.ndarray, counted: Parts | None = None
    ) -> Transport:
        """Find the transport from all parts of slabs that cover 0..length, a row at least, to
        `theirs` (m, P) float32.

        Where only the parts `counted` are to have the distribution of theirs, a value goes where
        the nearest below it goes that counts.
        """
        others = partial(_few, theirs)
        low, high = theirs.min(axis=0).astype(np.int64), theirs.max(axis=0).astype(np.int64)
        low, high = _ends(ours, length, low, high)
        size = (high - low) // BINS + 1

        def tally_ours(start: int, stop: int) -> np.ndarray:
            counts = np.zeros((len(low), BINS), np.int64)
            for rows in (counted or ours)(start, stop):
                tally(rows, low, size, counts)
            return counts

        def tally_theirs(start: int, stop: int) -> np.ndarray:
            counts = np.zeros((2, len(low), BINS), np.int64)
            for rows in others(start, stop):
                tally_sums(rows, low, size, counts)
            return counts

        mine = sum_slabs(tally_ours, length, least=2)
        table = np.zeros((len(low), BINS))
        destinations(mine, sum_slabs(tally_theirs, len(theirs), least=4 * AT_ONCE), table)
        if counted is not None:
            fill_gaps(mine, table)
        return cls(low, size, table)

    def moves(self, rows: np.ndarray) -> np.ndarray:
        """Return the way of each value of (n, P) float32, float64."""
        found = np.empty(rows.shape)
        moves(rows, self.low, self.size, self.table, found)
        return found


def _ends(
    ours: Parts, length: int, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest value along every axis, where others are within `low` ..
    `high`.
    """
    least, most = np.tile(low, (length, 1)), np.tile(high, (length, 1))

    def work(start: int, stop: int) -> None:
        for rows in ours(start, stop):
            extremes(rows, least[start], most[start])

    for_slabs(work, length, least=2)
    return least.min(axis=0), most.max(axis=0)


def _few(rows: np.ndarray, start: int, stop: int) -> Iterator[np.ndarray]:
    for first in range(start, stop, AT_ONCE):
        yield rows[first : min(first + AT_ONCE, stop)]


@kernel
def extremes(values, low, high):
    """Lower and raise low, high (P,) int64 to what the columns of values (n, P) hold."""
    for k in range(values.shape[1]):
        least, most = low[k], high[k]
        for i in range(len(values)):
            value = np.int64(values[i, k])
            least, most = min(least, value), max(most, value)
        low[k], high[k] = least, most


@kernel
def tally(values, low, size, counts):
    """Count the values (n, P) of every column in bins of size (P,) from low (P,): into counts (P,
    bins).
    """
    for k in range(values.shape[1]):
        for i in range(len(values)):
            counts[k, (np.int64(values[i, k]) - low[k]) // size[k]] += 1


@kernel
def tally_sums(values, low, size, counts):
    """Count as `tally` does into counts[0], and sum the values into counts[1]."""
    for k in range(values.shape[1]):
        for i in range(len(values)):
            value = np.int64(values[i, k])
            q = (value - low[k]) // size[k]
            counts[0, k, q] += 1
            counts[1, k, q] += value


@kernel
def destinations(mine, theirs, table):
    """Find the place of the ranks of each of mine (P, bins) among theirs (2, P, bins), counts and
    sums: table (P, bins).
    """
    for k in range(len(mine)):
        n, m = mine[k].sum(), theirs[0, k].sum()
        other, sums = theirs[0, k], theirs[1, k]
        at = 0
        left = other[0] * n  # of their bin `at`, in units of 1 / (n m)
        for q in range(mine.shape[1]):
            need = mine[k, q] * m
            reached = 0.0
            while need > 0:
                while left == 0:
                    at += 1
                    left = other[at] * n
                taken = min(need, left)
                reached += np.float64(taken) * (np.float64(sums[at]) / np.float64(other[at]))
                need -= taken
                left -= taken
            if mine[k, q] > 0:
                table[k, q] = np.rint(reached / (np.float64(mine[k, q]) * m))


@kernel
def fill_gaps(mine, table):
    """Give the bins of table (P, bins) of which mine holds nothing the place of the one below; the
    first ones that of the first that holds something.
    """
    for k in range(len(mine)):
        first = 0
        while mine[k, first] == 0:
            first += 1
        for q in range(len(table[k])):
            if q < first:
                table[k, q] = table[k, first]
            elif mine[k, q] == 0:
                table[k, q] = table[k, q - 1]


@kernel
def moves(values, low, size, table, found):
    """Look up the way of each value (n, P): found (n, P)."""
    for k in range(values.shape[1]):
        for i in range(len(values)):
            value = np.int64(values[i, k])
            found[i, k] = table[k, (value - low[k]) // size[k]] - value

"""A picture at one scale: its neighbourhoods ready for distances, its bandwidth and its statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.density import LANES, blur_of, optimal_bandwidth
from trabecula.synth.mrf.feedback import Joint, joint_of
from trabecula.synth.mrf.planes import pixels_along
from trabecula.synth.mrf.tables import kernel_table, shift_for

_MANY = 65536  # neighbourhoods that are looked at for the statistics, at most


@dataclass(frozen=True)
class Patches:
    """Neighbourhoods of a picture: `around` (n, K) uint8 levels without the centre, `centres` (n,)
    uint8.
    """

    around: np.ndarray
    centres: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> Patches:
        return Patches(self.around[chosen], self.centres[chosen])

    def spread(self, most: int) -> Patches:
        """At most so many, evenly spread over the picture."""
        count = len(self.centres)
        return self if count <= most else self[(2 * np.arange(most) + 1) * count // (2 * most)]


@dataclass(frozen=True)
class Source:
    """What the density of one view needs at one scale.

    Attributes
    ----------
    centres : (n,) uint8
        The centres of the candidates; 255 fills up to a multiple of `LANES`.
    times : (n,) int64
        How often each occurs: equal neighbourhoods of labels are one candidate.
    bits : (W, n) uint64, or None
        The candidates' neighbours as bits: labels whose neighbours all count in full.
    plain, weighted : (C K + 1, n), ((C + 1) K, n) float32, or None
        As columns of a matrix product: features and squares.
    table, shift : (T,) int32, int
        The Gaussian of a distance, in steps of 2^shift.
    weighted_table, weighted_shift
        The same for distances whose weights are in `steps`.
    blur : (L, L) float64
        The Gaussian of the centre.
    bandwidth : float
        h, in features.
    marginal : (L,) int64
        How often each level occurs.
    joint : Joint
        How levels go with the local sums around them.
    """

    centres: np.ndarray
    times: np.ndarray
    bits: np.ndarray | None
    plain: np.ndarray | None
    weighted: np.ndarray | None
    table: np.ndarray
    shift: int
    weighted_table: np.ndarray
    weighted_shift: int
    blur: np.ndarray
    bandwidth: float
    marginal: np.ndarray
    joint: Joint


def patches_of(
    picture: np.ndarray,
    *,
    scale: int,
    width: int,
    every: bool,
    stretched: tuple[bool, bool] = (False, False),
) -> Patches:
    """The neighbourhoods of a picture (R, C) of levels, decimated `scale` times by two.

    With `every` the 4^scale pictures that begin at another pixel teach as well; the paper decimates
    once. Along an axis (rows', columns') that is `stretched` neighbours lie sqrt(2) pixels apart,
    rounded.
    """
    stride = 2**scale
    rows, columns = (pixels_along(width, wide) for wide in stretched)
    found = []
    for corner in np.ndindex((stride, stride) if every else (1, 1)):
        part = picture[corner[0] :: stride, corner[1] :: stride]
        room = (2 * rows[-1] + 1, 2 * columns[-1] + 1)
        if part.shape[0] >= room[0] and part.shape[1] >= room[1]:
            windows = np.lib.stride_tricks.sliding_window_view(part, room)
            found.append(
                windows[..., rows + rows[-1], :][..., columns + columns[-1]].reshape(-1, width**2)
            )
    middle = width**2 // 2
    around = np.concatenate([np.delete(part, middle, axis=1) for part in found])
    return Patches(around, np.concatenate([part[:, middle] for part in found]))


def source_of(
    patches: Patches,
    content: Content,
    *,
    most: int,
    bandwidth: float,
    steps: int,
    products: bool,
    bins: int,
) -> Source:
    """Prepare neighbourhoods.

    Parameters
    ----------
    most : int
        Candidates at most.
    bandwidth : float
        Times h_opt.
    steps : int
        Steps of the weights of single neighbours (1: there or not).
    products : bool
        Whether distances come from products also where bits would do.
    bins : int
        Cells of a local sum, for the feedback.
    """
    features = content.features
    marginal = np.bincount(patches.centres, minlength=len(features))
    chosen = patches.spread(most)
    count, around = chosen.around.shape
    width = content.dimensions * (around + 1)
    h = bandwidth * optimal_bandwidth(
        _variance(features, marginal) / content.dimensions, count, width
    )
    twice = max(2 * h * h, 1e-6)
    bits, times = None, np.ones(count, np.int64)
    if content.kind == "labels" and not products:
        chosen, times = _distinct(chosen)
        bits = _bits(chosen, len(features))
    filled = -(-len(times) // LANES) * LANES
    centres, repeated = np.full(filled, 255, np.uint8), np.zeros(filled, np.int64)
    centres[: len(times)], repeated[: len(times)] = chosen.centres, times
    shift, weighted_shift = shift_for(twice), shift_for(twice * steps)
    return Source(
        centres,
        repeated,
        bits,
        _columns(chosen, features, each=False) if bits is None else None,
        _columns(chosen, features, each=True) if bits is None else None,
        kernel_table(twice, shift=shift),
        shift,
        kernel_table(twice * steps, shift=weighted_shift),
        weighted_shift,
        blur_of(features, twice),
        h,
        marginal,
        joint_of(patches.spread(_MANY), content, bins),
    )


def _variance(features: np.ndarray, marginal: np.ndarray) -> float:
    """Of the levels, summed over their channels."""
    share = marginal / marginal.sum()
    mean = share @ features
    return max(float(share @ ((features - mean) ** 2).sum(1)), 1e-3)


def _distinct(patches: Patches) -> tuple[Patches, np.ndarray]:
    """Each neighbourhood with its centre once, and how often it occurs."""
    rows, times = np.unique(
        np.column_stack([patches.centres, patches.around]), axis=0, return_counts=True
    )
    return Patches(rows[:, 1:], np.ascontiguousarray(rows[:, 0])), times


def codes_of(count: int) -> tuple[np.ndarray, int]:
    """Bits for labels that differ in as many places, whichever two are compared, and how many bits
    one has: two labels differ in one bit, more in two."""
    if count == 2:
        return np.array([0, 1], np.uint64), 1
    if count <= 4:
        return np.array([0b000, 0b011, 0b101, 0b110], np.uint64)[:count], 3
    return np.uint64(1) << np.arange(count, dtype=np.uint64), count


def _bits(patches: Patches, count: int) -> np.ndarray:
    codes, each = codes_of(count)
    per = 64 // each
    filled = -(-len(patches.centres) // LANES) * LANES
    packed = np.zeros((-(-patches.around.shape[1] // per), filled), np.uint64)
    for k, column in enumerate(patches.around.T):
        packed[k // per, : len(column)] |= codes[column] << np.uint64(k % per * each)
    return packed


def _columns(patches: Patches, features: np.ndarray, *, each: bool) -> np.ndarray:
    """Features by channel and neighbour, then the squares: of `each` neighbour, or all together."""
    count, around = patches.around.shape
    channels = features.shape[1]
    columns = np.zeros(
        (channels * around + (around if each else 1), -(-count // LANES) * LANES), np.float32
    )
    squares = (features.astype(np.int32) ** 2).sum(1).astype(np.float32)
    for c in range(channels):
        columns[c * around : (c + 1) * around, :count] = (
            features[:, c].astype(np.float32)[patches.around].T
        )
    if each:
        columns[channels * around :, :count] = squares[patches.around].T
    else:
        columns[-1, :count] = squares[patches.around].sum(1)
    columns[:, count:] = columns[:, :1]  # what fills up must never be the nearest alone
    return columns


def bytes_of(sources: Sequence[Source]) -> int:
    """Memory that sources hold."""
    arrays = [
        part
        for source in sources
        for part in (source.bits, source.plain, source.weighted, source.table)
    ]
    return sum(part.nbytes for part in arrays if part is not None)

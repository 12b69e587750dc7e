"""Neighbourhoods of a picture at one scale, as candidates of the Parzen estimate: extracted,
prepared for distances, and weighed for the neighbours of sites.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.density import (
    LANES,
    bit_rows,
    centre_gaussian,
    gaussian_table,
    optimal_bandwidth,
    plain_rows,
    rows_with_weights,
    table_shift,
    weights_from_bits,
    weights_from_products,
)
from trabecula.synth.mrf.picture_levels import PictureLevels
from trabecula.synth.mrf.statistics_feedback import JointHistogram, joint_histogram
from trabecula.synth.shared.pictures import ROOM

_MANY = 65536  # neighbourhoods measured for the statistics, at most


@dataclass(frozen=True)
class SliceNeighbourhoods:
    """Neighbourhoods of a picture: `around` (n, K) uint8 levels without the centre, `centres` (n,)
    uint8.
    """

    around: np.ndarray
    centres: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> SliceNeighbourhoods:
        """Select some of them by an index array."""
        return SliceNeighbourhoods(self.around[chosen], self.centres[chosen])

    def subsample(self, most: int) -> SliceNeighbourhoods:
        """Return at most `most` of them, evenly spread over the picture."""
        count = len(self.centres)
        return self if count <= most else self[(2 * np.arange(most) + 1) * count // (2 * most)]


@dataclass(frozen=True)
class ParzenCandidates:
    """Candidates of one view at one scale, with the tables of their density.

    Attributes
    ----------
    centres : (n,) uint8
        Centres of the candidates; 255 pads to a multiple of `LANES`.
    times : (n,) int64
        Occurrences of each: equal neighbourhoods of labels are one candidate.
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
        Occurrences of each level.
    joint : JointHistogram
        Joint statistic of levels and the local sums around them.
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
    joint: JointHistogram


def extract_neighbourhoods(
    picture: np.ndarray,
    *,
    scale: int,
    width: int,
    every: bool,
    diagonal: tuple[bool, bool] = (False, False),
) -> SliceNeighbourhoods:
    """Extract the neighbourhoods of a picture (R, C) of levels, decimated `scale` times by two.

    With `every`, all of the 4^scale decimated pictures that begin at another pixel are used; the
    paper uses one. Along an axis (of rows, of columns) that is `diagonal`, neighbours lie sqrt(2)
    pixels apart, rounded.
    """
    stride = 2**scale
    rows, columns = (pixels_along(width, wide) for wide in diagonal)
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
    return SliceNeighbourhoods(around, np.concatenate([part[:, middle] for part in found]))


def prepare_candidates(
    neighbourhoods: SliceNeighbourhoods,
    content: PictureLevels,
    *,
    most: int,
    bandwidth: float,
    steps: int,
    products: bool,
    bins: int,
) -> ParzenCandidates:
    """Prepare neighbourhoods as candidates.

    Parameters
    ----------
    most : int
        Candidates at most.
    bandwidth : float
        Times h_opt.
    steps : int
        Steps of the weights of single neighbours (1: present or not).
    products : bool
        Whether distances come from products also where bits would suffice.
    bins : int
        Cells of a local sum, for the feedback.
    """
    features = content.features
    marginal = np.bincount(neighbourhoods.centres, minlength=len(features))
    chosen = neighbourhoods.subsample(most)
    count, around = chosen.around.shape
    width = content.dimensions * (around + 1)
    h = bandwidth * optimal_bandwidth(
        _variance(features, marginal) / content.dimensions, count, width
    )
    twice = max(2 * h * h, 1e-6)
    bits, times = None, np.ones(count, np.int64)
    if content.kind == "labels" and not products:
        chosen, times = _merge_equal(chosen)
        bits = _pack_bits(chosen, len(features))
    filled = -(-len(times) // LANES) * LANES
    centres, repeated = np.full(filled, 255, np.uint8), np.zeros(filled, np.int64)
    centres[: len(times)], repeated[: len(times)] = chosen.centres, times
    shift, weighted_shift = table_shift(twice), table_shift(twice * steps)
    return ParzenCandidates(
        centres,
        repeated,
        bits,
        _product_columns(chosen, features, each=False) if bits is None else None,
        _product_columns(chosen, features, each=True) if bits is None else None,
        gaussian_table(twice, shift=shift),
        shift,
        gaussian_table(twice * steps, shift=weighted_shift),
        weighted_shift,
        centre_gaussian(features, twice),
        h,
        marginal,
        joint_histogram(neighbourhoods.subsample(_MANY), content, bins),
    )


def _variance(features: np.ndarray, marginal: np.ndarray) -> float:
    """Return the variance of the levels' features, summed over their channels."""
    share = marginal / marginal.sum()
    mean = share @ features
    return max(float(share @ ((features - mean) ** 2).sum(1)), 1e-3)


def _merge_equal(neighbourhoods: SliceNeighbourhoods) -> tuple[SliceNeighbourhoods, np.ndarray]:
    """Merge equal neighbourhoods with equal centres, and count how often each occurs."""
    rows, times = np.unique(
        np.column_stack([neighbourhoods.centres, neighbourhoods.around]), axis=0, return_counts=True
    )
    return SliceNeighbourhoods(rows[:, 1:], np.ascontiguousarray(rows[:, 0])), times


def label_codes(count: int) -> tuple[np.ndarray, int]:
    """Return bit codes (uint64) of labels, any two of which differ in the same number of bits, and
    the bits of a code: two labels differ in one bit, more in two.
    """
    if count == 2:
        return np.array([0, 1], np.uint64), 1
    if count <= 4:
        return np.array([0b000, 0b011, 0b101, 0b110], np.uint64)[:count], 3
    return np.uint64(1) << np.arange(count, dtype=np.uint64), count


def _pack_bits(neighbourhoods: SliceNeighbourhoods, count: int) -> np.ndarray:
    """Pack the labels of the neighbours into words, (W, n) uint64."""
    codes, each = label_codes(count)
    per = 64 // each
    filled = -(-len(neighbourhoods.centres) // LANES) * LANES
    packed = np.zeros((-(-neighbourhoods.around.shape[1] // per), filled), np.uint64)
    for k, column in enumerate(neighbourhoods.around.T):
        packed[k // per, : len(column)] |= codes[column] << np.uint64(k % per * each)
    return packed


def _product_columns(
    neighbourhoods: SliceNeighbourhoods, features: np.ndarray, *, each: bool
) -> np.ndarray:
    """Return columns of a matrix product: features by channel and neighbour, then the squares, of
    `each` neighbour or summed.
    """
    count, around = neighbourhoods.around.shape
    channels = features.shape[1]
    columns = np.zeros(
        (channels * around + (around if each else 1), -(-count // LANES) * LANES), np.float32
    )
    squares = (features.astype(np.int32) ** 2).sum(1).astype(np.float32)
    for c in range(channels):
        columns[c * around : (c + 1) * around, :count] = (
            features[:, c].astype(np.float32)[neighbourhoods.around].T
        )
    if each:
        columns[channels * around :, :count] = squares[neighbourhoods.around].T
    else:
        columns[-1, :count] = squares[neighbourhoods.around].sum(1)
    columns[:, count:] = columns[:, :1]  # padding must never be the nearest alone
    return columns


def candidate_bytes(candidate_sets: Sequence[ParzenCandidates]) -> int:
    """Return the memory of candidates, bytes."""
    arrays = [
        part
        for candidates in candidate_sets
        for part in (candidates.bits, candidates.plain, candidates.weighted, candidates.table)
    ]
    return sum(part.nbytes for part in arrays if part is not None)


def pixels_along(width: int, diagonal: bool) -> np.ndarray:
    """Return where neighbours lie along an axis of the picture, pixels from the centre."""
    steps = np.arange(width) - width // 2
    return np.rint(steps * np.sqrt(2)).astype(np.int64) if diagonal else steps


def count_scales(images: Sequence[Image], config: MrfConfig) -> int:
    """Count the scales at which every picture has room for a neighbourhood."""
    smallest, count = min(min(image.shape) for image in images), 1
    while count < config.scales and smallest // 2**count >= config.neighbourhood + ROOM:
        count += 1
    return count


_SLOPES = np.linspace(-40, 40, 161)

_WHOLE = 1 << 20


def reweight_by_porosity(
    neighbourhoods: SliceNeighbourhoods, void: int, porosity: float
) -> SliceNeighbourhoods:
    """Draw as many neighbourhoods anew for another porosity than the picture's.

    They are drawn evenly with weights exp(theta u), where u is the share of void in a
    neighbourhood. theta, -40 .. 40, brings the porosity of their centres as near to `porosity` as
    possible: more porous places of the picture are used more often.
    """
    centre = neighbourhoods.centres == void
    share = ((neighbourhoods.around == void).sum(1, dtype=np.int32) + centre) / (
        neighbourhoods.around.shape[1] + 1
    )
    # Not by halving an interval: where few neighbourhoods are left, the porosity of their centres
    # is no rising function.
    misses = [
        abs(_mean_porosity(_tilt_weights(share, theta), centre) - porosity) for theta in _SLOPES
    ]
    ends = np.cumsum(_tilt_weights(share, _SLOPES[int(np.argmin(misses))]))
    count = len(share)
    places = (2 * np.arange(count) + 1) * int(ends[-1]) // (2 * count)
    return neighbourhoods[np.searchsorted(ends, places, side="right")]


def _tilt_weights(share: np.ndarray, theta: float) -> np.ndarray:
    """Return the weights as whole numbers, so that all machines agree."""
    power = theta * share
    return np.rint(_WHOLE * np.exp(power - power.max())).astype(np.int64)


def _mean_porosity(weights: np.ndarray, centre: np.ndarray) -> float:
    """Return the weighted porosity of the centres, 0 .. 1."""
    return float(weights[centre].sum() / weights.sum())


def weigh_candidates(
    found: np.ndarray,
    weight: np.ndarray,
    steps: int,
    candidates: ParzenCandidates,
    features: np.ndarray,
    view: int,
    bins: np.ndarray,
    scratch: np.ndarray,
) -> None:
    """Sum the weights of one view's candidates by centre into `bins` (S, V, L) int64, [:, view].

    `found` and `weight` (S, K) uint8 are the levels and weights of the neighbours, in `steps`;
    `scratch` holds the products of S sites. Distances come from bits where labels allow it,
    otherwise from a matrix product.
    """
    if candidates.bits is not None:
        words = np.empty((len(found), len(candidates.bits)), np.uint64)
        masks = np.empty_like(words)
        bit_rows(found, weight, *label_codes(len(features)), words, masks)
        weights_from_bits(
            words,
            masks,
            candidates.bits,
            candidates.centres,
            candidates.times,
            candidates.table,
            view,
            bins,
        )
        return
    complete = weight.all(axis=1) if steps == 1 else np.zeros(len(weight), bool)
    for rows, plain in ((np.flatnonzero(complete), True), (np.flatnonzero(~complete), False)):
        if len(rows) == len(found):
            _weigh_by_products(
                found, weight, steps, candidates, features, view, bins, scratch, plain=plain
            )
        elif len(rows):
            part = np.empty((len(rows), 1, bins.shape[2]), np.int64)
            _weigh_by_products(
                found[rows],
                weight[rows],
                steps,
                candidates,
                features,
                0,
                part,
                scratch,
                plain=plain,
            )
            bins[rows, view] = part[:, 0]


def _weigh_by_products(
    found: np.ndarray,
    weight: np.ndarray,
    steps: int,
    candidates: ParzenCandidates,
    features: np.ndarray,
    view: int,
    bins: np.ndarray,
    scratch: np.ndarray,
    *,
    plain: bool,
) -> None:
    """Sum the weights by a matrix product; with `plain` all neighbours have full weight, which
    takes fewer columns.
    """
    assert candidates.plain is not None and candidates.weighted is not None
    columns = candidates.plain if plain else candidates.weighted
    rows = np.empty((len(found), len(columns)), np.float32)
    if plain:
        plain_rows(found, features, rows)
    else:
        rows_with_weights(found, weight, features, rows)
    products = scratch[: len(rows), : columns.shape[1]]
    np.matmul(rows, columns, out=products)
    table = candidates.table if steps == 1 else candidates.weighted_table
    shift = candidates.shift if steps == 1 else candidates.weighted_shift
    weights_from_products(products, candidates.centres, table, shift, view, bins)


_ROWS = 4096  # neighbourhoods that are summed at once
_TABLES = 80_000  # bytes of the two tables of the candidates of a view

_SMALL = 100_000  # bytes of what does not depend on the picture

_OF_A_PIXEL = {"labels": 10, "grey": 20, "colour": 132}  # bytes that numbering the levels takes


def learning_bytes(
    images: Sequence[Image], scales: int, config: MrfConfig, *, oblique: bool
) -> tuple[int, int]:
    """Forecast the bytes of the candidates of all scales, and the peak while they are prepared."""
    area, held = config.neighbourhood**2, sum(int(np.prod(image.shape)) for image in images)
    peak = held * _OF_A_PIXEL[images[0].kind]
    for scale in range(scales):
        before = 0
        for image in [*images, *([images[0]] * 2 if oblique else [])]:
            count = _count_neighbourhoods(image.shape, scale, config)
            kept = _bytes_of_candidates(image, count, config)
            sums = (
                5.3 * area * min(count, _ROWS)
                + 12 * min(count, _MANY)
                + area * _MANY * (count > _MANY)
            )
            preparing = kept + _SMALL + max(6.3 * area * min(count, config.candidates), sums)
            peak = max(peak, held + area * count + round(max(before + 2 * area * count, preparing)))
            held += kept
            # the neighbourhoods of the last picture are freed once the next ones exist
            before = area * count
    return held, peak


def _count_neighbourhoods(shape: Sequence[int], scale: int, config: MrfConfig) -> int:
    """Count the neighbourhoods of a picture at a scale."""
    stride, edge = 2**scale, config.neighbourhood - 1
    corners = np.ndindex(stride, stride) if config.every else [(0, 0)]
    return sum(
        math.prod(
            max(0, -(-(side - first) // stride) - edge)
            for side, first in zip(shape, corner, strict=True)
        )
        for corner in corners
    )


def _bytes_of_candidates(image: Image, count: int, config: MrfConfig) -> int:
    """Return the bytes of `count` neighbourhoods as candidates, if all differ."""
    chosen, around = min(count, config.candidates), config.neighbourhood**2 - 1
    phases = len(np.unique(image.values)) if image.kind == "labels" else 0
    if phases and config.relaxation != "icm":
        words = -(-around // (64 // label_codes(phases)[1]))
        return chosen * (8 * words + 10)
    channels = 3 if image.kind == "colour" else phases if phases > 2 else 1
    levels = {"labels": phases, "grey": config.levels, "colour": config.colours}[image.kind]
    return chosen * (4 * around * (2 * channels + 1) + 13) + 8 * levels**2 + _TABLES

"""The local conditional density of all levels at once (Urs 2014, equations 3 to 7).

For the neighbourhood r of a site and a level l, f(l) = sum over p of exp(-(D_p + (l - y_p)^2) / 2
h^2), where D_p is the squared distance of r to the exemplar's neighbourhood p, and y_p its centre.
D_p is the same for all levels: first exp(-D_p / 2 h^2) is summed over the p of equal centre, then a
small matrix applies the Gaussian of the centre. Distances are whole numbers and weights are entries
of a table of whole numbers, so every sum is exact and the same on every machine. Logarithms and
exponentials come from tables for the same reason: a logarithm is in units of 2^-16 to the base 2,
read off the bits of a float64, and a weight 2^(-s) is a whole number of at most 2^31.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.numerics.bits import count_bits

UNIT = 1 << 16
"""A factor of two in a density."""

_FINE = 4096

LOGS = np.rint(UNIT * np.log2(1 + (np.arange(_FINE) + 0.5) / _FINE)).astype(np.int64)

POWERS = np.rint(2.0**31 * 2.0 ** (-np.arange(_FINE) / _FINE)).astype(np.int64)

NEAREST_WEIGHT = 1 << 22
"""The weight of the exemplar's nearest neighbourhood; others weigh less, those below 1 nothing."""


def gaussian_table(twice_variance: float, *, shift: int = 0) -> np.ndarray:
    """Compute a table of exp(-i 2^shift / (2 h^2)) times `NEAREST_WEIGHT`, rounded (int32), for i =
    0, 1, ... while it is at least 1, with a 0 at the end.

    Where a step is wider than 1 its middle counts.
    """
    step = 1 << shift
    count = int(np.log(NEAREST_WEIGHT * 2.0) * twice_variance / step) + 2
    differences = np.arange(count) * float(step) + (step - 1) / 2
    table = np.rint(NEAREST_WEIGHT * np.exp(-differences / twice_variance)).astype(np.int32)
    return np.ascontiguousarray(
        np.append(table[: max(1, int(np.count_nonzero(table)))], np.int32(0))
    )


def table_shift(twice_variance: float) -> int:
    """Return the width of a step as a power of two, so that the table has at most about 8000
    entries and stays in the cache.
    """
    shift = 0
    while np.log(NEAREST_WEIGHT * 2.0) * twice_variance > 8000 << shift:
        shift += 1
    return shift


def log_units(values: np.ndarray) -> np.ndarray:
    """Return log2 of positive values in units of 2^-16, rounded (int64)."""
    return np.rint(np.log2(values) * UNIT).astype(np.int64)


@inline
def log_of(bits, logs):
    """Return log2 in units of 2^-16 of a positive normal float64, given its bits."""
    return ((bits >> 52) - 1023) * UNIT + logs[(bits >> 40) & (_FINE - 1)]


@inline
def power_of(units, powers):
    """Return 2^(units / 2^16) times 2^31 as a whole number, units <= 0."""
    fall = -units
    whole = fall >> 16
    return powers[(fall >> 4) & (_FINE - 1)] >> whole if whole < 32 else 0


STEPS = 16
"""Steps of (1 - t)^2, the weight of a neighbour of temperature t."""

LANES = 16
"""The number of candidates is filled up to a multiple of this."""

_FLOOR = 2.0**-40
"""Least density: a level without candidates stays possible where another view supports it."""


# Loops of their own, over one row: LLVM turns only these into wide instructions.
@inline
def _set_distances(word, mask, row, distance):
    """Set the distances to the bits that differ in one word."""
    for p in range(len(row)):
        distance[p] = count_bits((row[p] ^ word) & mask)


@inline
def _add_distances(word, mask, row, distance):
    """Add the bits that differ in a further word."""
    for p in range(len(row)):
        distance[p] += np.uint8(count_bits((row[p] ^ word) & mask))


@inline
def _mark_near(distance, reach, passed):
    """Mark the distances at most `reach` beyond the least, and return the least."""
    least = np.uint8(255)
    for p in range(len(distance)):
        least = min(least, distance[p])
    most = np.uint8(min(254, np.int64(least) + reach))
    for p in range(len(distance)):
        passed[p] = distance[p] <= most
    return least


@kernel
def weights_from_bits(words, masks, candidates, centres, times, table, view, bins):
    """Sum weights by centre from bits: `candidates` (W, n) uint64, distance = bits that differ
    where the mask is set.

    `bins` (S, V, L) int64: [:, view] is written. `centres` (n,) uint8, rising; 255 pads to a
    multiple of `LANES`. `times` (n,) int64: how often a candidate occurs.
    """
    n = count = len(centres)
    while centres[count - 1] == 255:
        count -= 1
    distance, passed = np.empty(n, np.uint8), np.empty(n, np.bool_)
    eights, beyond = passed.view(np.uint64), len(table) - 1
    for s in range(len(words)):
        _set_distances(words[s, 0], masks[s, 0], candidates[0], distance)
        for w in range(1, len(candidates)):
            _add_distances(words[s, w], masks[s, w], candidates[w], distance)
        distance[count:] = 255
        least = _mark_near(distance, beyond - 1, passed)
        bins[s, view] = 0
        total, centre = np.int64(0), centres[0]
        for e in range(len(eights)):
            if eights[e]:
                for p in range(8 * e, 8 * e + 8):
                    if centres[p] != centre:
                        bins[s, view, centre] += total
                        total, centre = np.int64(0), centres[p]
                    total += times[p] * table[min(np.int64(distance[p]) - least, beyond)]
        if centre != 255:
            bins[s, view, centre] += total


@kernel
def weights_from_products(products, centres, table, shift, view, bins):
    """Sum weights by centre from `products` (S, n) float32: whole numbers, the distances less a
    constant of the site.

    `bins` (S, V, L) int64: [:, view] is written. `centres` (n,) uint8; 255 pads to a multiple of
    `LANES`, with the products of another candidate.
    """
    n = len(centres)
    low, passed, near = (
        np.empty(LANES, np.float32),
        np.empty(n, np.bool_),
        np.empty(n + 1, np.int32),
    )
    eights = passed.view(np.uint64)
    cut = np.float32((len(table) - 1) << shift)
    for s in range(len(products)):
        row = products[s]
        least = _minimum(row, low)
        _mark_below(row, least + cut, passed)
        found = 0
        for e in range(len(eights)):
            if eights[e]:
                for p in range(8 * e, 8 * e + 8):  # no branch that a processor would guess wrong
                    near[found] = p
                    found += passed[p]
        bins[s, view] = 0
        for i in range(found):
            centre = centres[near[i]]
            if centre != 255:
                bins[s, view, centre] += table[np.int32(row[near[i]] - least) >> shift]


@inline
def _minimum(row, low):
    """Return the least entry, by lanes: LLVM does not reorder a sum or minimum of floats by
    itself.
    """
    lanes = len(low)
    copy_row(low, row)
    for first in range(lanes, len(row), lanes):
        for j in range(lanes):
            value = row[first + j]
            low[j] = value if value < low[j] else low[j]
    return low.min()


@inline
def _mark_below(row, bound, passed):
    """Mark the entries below a bound."""
    for p in range(len(row)):
        passed[p] = row[p] < bound


@kernel
def parzen_densities(bins, blur, logs, share, log):
    """Compute equation 7 from the weights: `share` (S, V, L) float64, which sums to 1 over the
    levels, and its `log` in units (int64).

    `blur` (V, L, L) float64: exp(-(l - y)^2 / 2 h^2), [v, y, l].
    """
    L = bins.shape[2]
    bits = share.view(np.int64)
    for s in range(len(bins)):
        for v in range(bins.shape[1]):
            row = share[s, v]
            row[:] = 0
            for y in range(L):
                if bins[s, v, y]:
                    weight = np.float64(bins[s, v, y])
                    for level in range(L):
                        row[level] += weight * blur[v, y, level]
            total = 0.0
            for level in range(L):
                total += row[level]
            total = max(total, 1e-300)
            for level in range(L):
                row[level] = row[level] / total + _FLOOR
                log[s, v, level] = log_of(bits[s, v, level], logs)


def centre_gaussian(features: np.ndarray, twice_variance: float) -> np.ndarray:
    """Return exp(-(l - y)^2 / 2 h^2) of every pair of levels, (L, L) float64, in steps of 2^-40 so
    that machines agree.
    """
    apart = features[:, None].astype(np.int64) - features[None].astype(np.int64)
    return np.rint(np.exp(-(apart**2).sum(2) / twice_variance) * 2.0**40) / 2.0**40


def optimal_bandwidth(variance: float, count: int, dimensions: int) -> float:
    """Return h_opt of equation 6: sigma (4 / (n (d + 2)))^(1 / (d + 4)).

    Parameters
    ----------
    variance : float
        sigma^2, the marginal variance of the picture (of one dimension of its levels).
    count : int
        n, the exemplar's neighbourhoods.
    dimensions : int
        d, of a neighbourhood with its centre.
    """
    return float(np.sqrt(variance) * (4 / (count * (dimensions + 2))) ** (1 / (dimensions + 4)))


@kernel
def plain_rows(found, features, rows):
    """Fill rows (S, C K + 1) float32: -2 times the features, channel by channel, and a 1 for the
    squares.
    """
    K, C = found.shape[1], features.shape[1]
    for s in range(len(found)):
        for c in range(C):
            for k in range(K):
                rows[s, c * K + k] = -2 * features[found[s, k], c]
        rows[s, C * K] = 1


@kernel
def rows_with_weights(found, weight, features, rows):
    """Fill rows (S, (C + 1) K) float32: -2 times weight times the features, channel by channel,
    then the weights.
    """
    K, C = found.shape[1], features.shape[1]
    for s in range(len(found)):
        for c in range(C):
            for k in range(K):
                rows[s, c * K + k] = -2 * np.int32(weight[s, k]) * features[found[s, k], c]
        for k in range(K):
            rows[s, C * K + k] = weight[s, k]


@kernel
def bit_rows(found, weight, codes, each, words, masks):
    """Pack neighbours as bits: `codes` (L,) uint64 of `each` bits, from the low end into (S, W)
    uint64; `masks` has ones where a neighbour exists.
    """
    ones = (np.uint64(1) << np.uint64(each)) - np.uint64(1)
    per = 64 // each
    for s in range(len(found)):
        words[s] = 0
        masks[s] = 0
        for k in range(found.shape[1]):
            shift = np.uint64(k % per * each)
            if weight[s, k]:
                words[s, k // per] |= codes[found[s, k]] << shift
                masks[s, k // per] |= ones << shift

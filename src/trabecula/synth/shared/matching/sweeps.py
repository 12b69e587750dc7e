"""Search: new matches of neighbourhoods, by plain functions on arrays.

Glossary: S the neighbourhoods of the output on a grid, E those of the exemplar as a flat list;
`match` the index into E per site of S. `ratios` are the grid's steps over those of E along each
axis, so that a neighbour's match moves by as many cells of E; of squares in adjacent planes (box[0]
= 1) it does not move. Sites that are not `active` are not searched.
Kernels read old matches and write new ones over a slab (Jacobi), so tiles and threads do not
matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.prefetch import fetch_row
from trabecula.engine.random import below, philox
from trabecula.engine.rows import copy_row
from trabecula.measure.neighbours import place_along
from trabecula.synth.shared.matching.halving_tree import find_leaf

AHEAD = 8
"""Sites whose candidates are asked for before they are compared."""


class Sweep(NamedTuple):
    """Geometry and random numbers of one sweep: the extent of E, `ratios`, the output's axes that
    wrap, the key, the number of the sweep, and pairs of random candidates.
    """

    shape: tuple[int, ...]
    ratios: tuple[int, ...]
    wraps: tuple[bool, ...]
    key: np.uint64
    number: int
    tries: int


@kernel
def start_matches(match, numbers, key, start, stop):
    """Draw one of the candidates' numbers for every site of planes start..stop, each with the same
    chance.
    """
    for z in range(start, stop):
        for y in range(match.shape[1]):
            for x in range(match.shape[2]):
                word = philox(key, z, y, x, 0)[0]
                match[z, y, x] = numbers[below(word, len(numbers))]


@kernel
def count_matches(match, active, counts, start, stop):
    """Add to `counts` the number of active sites of planes start..stop that are matched with each
    candidate.
    """
    for z in range(start, stop):
        for y in range(match.shape[1]):
            for x in range(match.shape[2]):
                if active[z, y, x]:
                    counts[match[z, y, x]] += 1


@inline
def _begin(features, place, exemplar, candidate):
    """Return the squared distance of the site at (z, y, x) of the features in the first eight
    components: most candidates fail there.
    """
    z, y, x = place
    total = np.int32(0)
    if exemplar.shape[1] < 8:
        for i in range(exemplar.shape[1]):
            difference = np.int32(features[z, y, x, i]) - np.int32(exemplar[candidate, i])
            total += difference * difference
        return total
    for i in range(8):  # as many as the compiler takes at once, since it knows how many
        difference = np.int32(features[z, y, x, i]) - np.int32(exemplar[candidate, i])
        total += difference * difference
    return total


@inline
def _distance(features, place, exemplar, candidate, total, most):
    """Return the squared distance of the site at (z, y, x) of the features, of which `total` is the
    beginning, or something above `most` as soon as that is sure.
    """
    z, y, x = place
    if total > most:
        return total
    for i in range(8, exemplar.shape[1]):
        difference = np.int32(features[z, y, x, i]) - np.int32(exemplar[candidate, i])
        total += difference * difference
    return total


@inline
def _inverses(shape):
    """Return one over the cells of a plane and of a row of E, for `_quotient`."""
    return 1.0 / (shape[1] * shape[2]), 1.0 / shape[2]


@inline
def _quotient(number, inverse):
    """Return number // n, of a number from 0 to 2^31, by one over n: divisions are slow."""
    return np.int64((number + 0.5) * inverse)


@inline
def _neighbour_cell(match, shape, inverses, axis, step):
    """Return the index `step` cells further along an axis of E, or -1 outside."""
    span, move, place = shape[0] * shape[1] * shape[2], step * shape[1] * shape[2], match
    if axis == 1:
        span, move = shape[1] * shape[2], step * shape[2]
        place = match - _quotient(match, inverses[0]) * span
    elif axis == 2:
        span, move = shape[2], step
        place = match - _quotient(match, inverses[1]) * span
    return match + move if 0 <= place + move < span else np.int64(-1)


@inline
def _around(words, match, shape, inverses, number):
    """Draw a random cell around `match`, clamped to E: of each number nearer than of the last."""
    radius = max(1, max(shape[0], shape[1], shape[2]) >> (number + 2))
    plane, row = _quotient(match, inverses[0]), _quotient(match, inverses[1])
    x = match - row * shape[2] + below(words[3], 2 * radius + 1) - radius
    y = row - plane * shape[1] + below(words[2], 2 * radius + 1) - radius
    z = plane + below(words[1], 2 * radius + 1) - radius
    x = min(max(x, 0), shape[2] - 1)
    y = min(max(y, 0), shape[1] - 1)
    z = min(max(z, 0), shape[0] - 1)
    return np.int64((z * shape[1] + y) * shape[2] + x)


@inline
def _better(features, place, exemplar, penalty, candidate, total, best):
    """Return the better of `candidate`, whose distance begins with `total`, and `best`: a
    candidate, its distance, and that times its penalty.
    """
    least = best[2]
    if total > least:  # no factor is below 1
        return best
    factor = penalty[candidate]
    d = _distance(features, place, exemplar, candidate, total, least / factor)
    value = np.float32(d) * factor
    return (candidate, d, value) if value < least else best


@inline
def _own(features, place, exemplar, penalty, candidate, total):
    """Return a candidate, whose distance begins with `total`, as `_better` does."""
    d = _distance(features, place, exemplar, candidate, total, np.inf)
    return candidate, d, np.float32(d) * penalty[candidate]


@kernel
def search_leaves(features, first, exemplar, penalty, tree, active, old, match, start, stop):
    """Search the best of the own match and of the leaf of a `HalvingTree` of E where each of the
    sites start..stop would be; arrays as of `search`.
    """
    axes, cuts, starts, order = tree
    for z in range(start, stop):
        for y in range(old.shape[1]):
            for x in range(old.shape[2]):
                own = np.int64(old[z, y, x])
                match[z, y, x] = own
                if not active[z, y, x]:
                    continue
                site = (z - first, y, x)
                total = _begin(features, site, exemplar, own)
                best = _own(features, site, exemplar, penalty, own, total)
                leaf = find_leaf(features, site, axes, cuts)
                for n in range(starts[leaf], starts[leaf + 1]):
                    candidate = np.int64(order[n])
                    total = _begin(features, site, exemplar, candidate)
                    best = _better(features, site, exemplar, penalty, candidate, total, best)
                match[z, y, x] = best[0]


class Ahead(NamedTuple):
    """What is known beforehand of the next `AHEAD` sites of a row: candidates (sites, n), how many
    of them are the own match and those of the neighbours, and random numbers (sites, tries, 4).
    """

    cells: np.ndarray
    known: np.ndarray
    drawn: np.ndarray


@kernel
def search(features, first, exemplar, penalty, active, old, match, distance, sweep, start, stop):
    """Search the best of the own match, the six neighbours' moved along, and random ones, for sites
    start..stop: one sweep.

    features (n, Y, X, D) int16, of the sites' planes from `first` on; exemplar (N, D) int16;
    penalty (N,) float32 factors, 1 or more, infinite where E has a gap; active (Z, Y, X) bool; old,
    match (Z, Y, X) int32; distance (Z, Y, X) int32, unpenalised. Of the `tries` pairs of
    random candidates one is anywhere and one around the best, in a shrinking radius.
    """
    shape, tries, width = sweep.shape, sweep.tries, old.shape[2]
    inverses = _inverses(shape)
    ahead = Ahead(
        np.empty((AHEAD, 7 + tries), np.int64),
        np.empty(AHEAD, np.int64),
        np.empty((AHEAD, tries, 4), np.uint64),
    )
    begun = np.empty(7 + tries, np.int64)
    for z in range(start, stop):
        for y in range(old.shape[1]):
            for x in range(-AHEAD, width):
                if x >= 0 and active[z, y, x]:
                    site, n = (z - first, y, x), x % AHEAD
                    candidates = ahead.cells[n], ahead.known[n], ahead.drawn[n]
                    best, kept = _best_of(
                        features, site, exemplar, penalty, candidates, begun, shape, inverses
                    )
                    match[z, y, x], distance[z, y, x] = best, kept
                elif x >= 0:
                    match[z, y, x], distance[z, y, x] = old[z, y, x], 0
                if x + AHEAD < width and active[z, y, x + AHEAD]:
                    _look_ahead(exemplar, old, sweep, inverses, (z, y, x + AHEAD), ahead)


@inline
def _best_of(features, site, exemplar, penalty, candidates, begun, shape, inverses):
    """Return the best of the candidates of a site, and of those around it, and its distance."""
    cells, known, drawn = candidates
    tries = len(drawn)
    for k in range(known + tries):
        begun[k] = _begin(features, site, exemplar, cells[k])
    best = _own(features, site, exemplar, penalty, cells[0], begun[0])
    for k in range(1, known):
        if cells[k] != best[0]:
            best = _better(features, site, exemplar, penalty, cells[k], begun[k], best)
    for k in range(tries):
        far = known + k
        best = _better(features, site, exemplar, penalty, cells[far], begun[far], best)
        near = _around(drawn[k], best[0], shape, inverses, k)
        total = _begin(features, site, exemplar, near)
        best = _better(features, site, exemplar, penalty, near, total, best)
    return best[0], best[1]


@inline
def _look_ahead(exemplar, old, sweep, inverses, site, ahead):
    """Find the candidates of a site that are known beforehand, and ask for their rows, and for
    those around its match, which it often keeps.
    """
    shape, ratios, wraps, key, number, tries = sweep
    n = site[2] % AHEAD
    cells, drawn, known = ahead.cells[n], ahead.drawn[n], 1
    cells[0] = old[site]
    for axis in range(3):
        for side in range(-1, 2, 2):
            there = _moved(site, axis, side, old.shape, wraps)
            if there[axis] < 0:
                continue
            step = -side * ratios[axis]
            candidate = _neighbour_cell(np.int64(old[there]), shape, inverses, axis, step)
            if candidate >= 0:
                cells[known] = candidate
                known += 1
    ahead.known[n] = known
    for k in range(known):
        fetch_row(exemplar, cells[k])
    for k in range(tries):
        copy_row(drawn[k], philox(key, site[0], site[1], site[2], (number << 8) + k))
        cells[known + k] = below(drawn[k, 0], shape[0] * shape[1] * shape[2])
        fetch_row(exemplar, cells[known + k])
        fetch_row(exemplar, _around(drawn[k], cells[0], shape, inverses, k))


@inline
def _moved(site, axis, side, shape, wraps):
    """Return the next site along an axis; -1 along it where there is none."""
    z, y, x = site
    if axis == 0:
        return place_along(z + side, shape[0], wraps[0]), y, x
    if axis == 1:
        return z, place_along(y + side, shape[1], wraps[1]), x
    return z, y, place_along(x + side, shape[2], wraps[2])

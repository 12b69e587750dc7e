"""Search and vote: plain functions on arrays.

Glossary: S the neighbourhoods of the output on a grid, E those of the exemplar as a flat list;
`match` the index into E per site of S. `ratios` are the grid's steps over those of E along each
axis, so that a neighbour's match moves by as many cells of E; of squares in adjacent planes (box[0]
= 1) it does not move. Sites that are not `active` are neither searched nor do they vote.
Both kernels read old arrays and write new ones over a slab (Jacobi), so tiles and threads do not
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


class CubeLayout(NamedTuple):
    """Geometry of a vote, (3,) each: the extent and strides of E, the steps of S, the sides and the
    rims of neighbourhoods, in voxels, and the output's axes that wrap.
    """

    shape: tuple[int, ...]
    strides: tuple[int, ...]
    steps: tuple[int, ...]
    box: tuple[int, ...]
    trims: tuple[int, ...]
    wraps: tuple[bool, ...]


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
def _better(features, place, exemplar, penalty, candidate, total, best, least, kept):
    """Return the better of `candidate`, whose distance begins with `total`, and `best`, its
    penalised distance, of `best` `least`, and its distance, of `best` `kept`.
    """
    if total > least:  # no factor is below 1
        return best, least, kept
    factor = penalty[candidate]
    d = _distance(features, place, exemplar, candidate, total, least / factor)
    value = np.float32(d) * factor
    if value < least:
        return candidate, value, d
    return best, least, kept


@kernel
def search_leaves(features, first, exemplar, penalty, tree, active, old, match, start, stop):
    """Search the best of the own match and of the leaf of a `HalvingTree` of E where each of the
    sites start..stop would be; arrays as of `search`.
    """
    axes, cuts, starts, order = tree
    for z in range(start, stop):
        for y in range(old.shape[1]):
            for x in range(old.shape[2]):
                best = np.int64(old[z, y, x])
                match[z, y, x] = best
                if not active[z, y, x]:
                    continue
                site = (z - first, y, x)
                total = _begin(features, site, exemplar, best)
                kept = _distance(features, site, exemplar, best, total, np.inf)
                least = np.float32(kept) * penalty[best]
                leaf = find_leaf(features, site, axes, cuts)
                for n in range(starts[leaf], starts[leaf + 1]):
                    candidate = np.int64(order[n])
                    total = _begin(features, site, exemplar, candidate)
                    best, least, kept = _better(
                        features, site, exemplar, penalty, candidate, total, best, least, kept
                    )
                match[z, y, x] = best


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
    best = cells[0]
    kept = _distance(features, site, exemplar, best, begun[0], np.inf)
    least = np.float32(kept) * penalty[best]
    for k in range(1, known):
        if cells[k] != best:
            best, least, kept = _better(
                features, site, exemplar, penalty, cells[k], begun[k], best, least, kept
            )
    for k in range(tries):
        far = known + k
        best, least, kept = _better(
            features, site, exemplar, penalty, cells[far], begun[far], best, least, kept
        )
        near = _around(drawn[k], best, shape, inverses, k)
        total = _begin(features, site, exemplar, near)
        best, least, kept = _better(
            features, site, exemplar, penalty, near, total, best, least, kept
        )
    return best, kept


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


@kernel
def weigh(distance, active, floor, mean, table, weight, start, stop):
    """Look up 256 times the ratio of each site's distance to the mean in the table; 0 where a site
    is not active.
    """
    for z in range(start, stop):
        for y in range(distance.shape[1]):
            for x in range(distance.shape[2]):
                ratio = (np.int64(distance[z, y, x]) + floor) * 256 // mean
                weight[z, y, x] = table[min(max(ratio, 1), 4095)] if active[z, y, x] else 0


@kernel
def vote(field, match, weight, layout, plane, result, start, stop):
    """Average the matched neighbourhoods with their weights over voxel planes start..stop, times
    256, in int16; 0 where none is.

    field (C, z, y, x) int8, the exemplar; match, weight (Z, Y, X) int32, where a site of weight 0
    does not vote; strides of E, steps of S, box and trims (3,) int in voxels; wraps (3,) bool;
    plane (C + 1, y, x) int32 scratch, as wide as the grid covers; result (C, ...) int16. The rim of
    `trims` voxels of a neighbourhood does not vote, except at a border that does not wrap.
    """
    C, Z, Y, X = result.shape
    wraps = layout.wraps
    summed = np.empty(match.shape[1:], np.int32)
    for z in range(start, stop):
        plane[:] = 0
        summed[:] = 0
        for turn in range(2 if wraps[0] else 1):
            _vote_plane(field, match, weight, layout, plane, summed, z + turn * Z)
        _spread(summed, plane[C], layout)
        fold(plane, Y, X, wraps)
        for c in range(C):
            for y in range(Y):
                for x in range(X):
                    weights = plane[C, y, x]
                    result[c, z, y, x] = (
                        np.int64(plane[c, y, x]) * 256 // weights if weights > 0 else 0
                    )


@inline
def fold(plane, Y, X, wraps):
    """Add the part beyond an axis that wraps to its beginning."""
    # Loops and no sums of arrays, here and below: those take Numba seconds to compile.
    for c in range(plane.shape[0]):
        for y in range(Y, plane.shape[1] if wraps[1] else 0):
            for x in range(plane.shape[2]):
                plane[c, y - Y, x] += plane[c, y, x]
        for y in range(plane.shape[1]):
            for x in range(X, plane.shape[2] if wraps[2] else 0):
                plane[c, y, x - X] += plane[c, y, x]


@inline
def reach(site, count, width, trim, wrap):
    """Return the voxels first .. last of a neighbourhood that vote along an axis."""
    first = 0 if site == 0 and not wrap else trim
    last = width if site == count - 1 and not wrap else width - trim
    return first, last


@inline
def _vote_plane(field, match, weight, layout, plane, summed, z):
    """Add the sites' weighted votes for voxel plane z to `plane`, and their weights to `summed`."""
    shape, strides, steps, box, trims, wraps = layout
    SZ, SY, SX = match.shape
    C, width, step = field.shape[0], box[2], steps[2]
    weights = np.empty(width, np.int32)
    for sz in range(max(0, (z - box[0] + steps[0]) // steps[0]), min(SZ, z // steps[0] + 1)):
        dz = z - sz * steps[0]
        z0, z1 = reach(sz, SZ, box[0], trims[0], wraps[0])
        if dz < z0 or dz >= z1:
            continue
        for sy in range(SY):
            y0, y1 = reach(sy, SY, box[1], trims[1], wraps[1])
            for sx in range(SX):
                w = weight[sz, sy, sx]
                if w == 0:
                    continue
                summed[sy, sx] += w
                # Whole rows, with weight 0 at the rim: the compiler makes eight voxels one
                # addition.
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                weights[:] = w
                weights[:x0] = 0
                weights[x1:] = 0
                m = match[sz, sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0] + dz
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for c in range(C):
                    for dy in range(y0, y1):
                        to = plane[c, sy * steps[1] + dy, sx * step : sx * step + width]
                        row = field[c, ez, ey + dy, ex : ex + width]
                        for x in range(width):
                            to[x] += weights[x] * np.int32(row[x])


@inline
def _spread(summed, weights, layout):
    """Sum the weights of a plane's sites over its voxels."""
    _, _, steps, box, trims, wraps = layout
    SY, SX = summed.shape
    row = np.empty(SX, np.int32)
    for y in range(weights.shape[0]):
        row[:] = 0
        for sy in range(max(0, (y - box[1] + steps[1]) // steps[1]), min(SY, y // steps[1] + 1)):
            y0, y1 = reach(sy, SY, box[1], trims[1], wraps[1])
            if y0 <= y - sy * steps[1] < y1:
                for sx in range(SX):
                    row[sx] += summed[sy, sx]
        for sx in range(SX):
            x0, x1 = reach(sx, SX, box[2], trims[2], wraps[2])
            for x in range(sx * steps[2] + x0, sx * steps[2] + x1):
                weights[y, x] += row[sx]

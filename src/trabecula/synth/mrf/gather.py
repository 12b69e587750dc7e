"""The neighbours of sites, as numbers: rows of a matrix product, or bits of a word.

A neighbour that is not there, since it lies outside a form, has weight 0: it is left out of the
distance.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel


@kernel
def gather_places(sites, offsets, shape, there, places):
    """Flat places of the neighbours (S, K) int64 on a torus, -1 for those that are not `there`;
    without entries all are.
    """
    marks = there.ravel()
    every = len(marks) == 0
    Z, Y, X = shape
    reach = offsets.max()
    for s in range(len(sites)):
        z, y, x = sites[s] // (Y * X), sites[s] // X % Y, sites[s] % X
        near = min(z, y, x) < reach or z >= Z - reach or y >= Y - reach or x >= X - reach
        for k in range(len(offsets)):
            dz, dy, dx = offsets[k]
            place = sites[s] + (dz * Y + dy) * X + dx
            if near:
                place = ((z + dz) % Z * Y + (y + dy) % Y) * X + (x + dx) % X
            places[s, k] = place if every or marks[place] else -1


@kernel
def gather_levels(places, levels, found, weight):
    """The levels of the neighbours (S, K) uint8, and 1 or 0 in `weight` (S, K) uint8 as they are
    there or not.
    """
    flat = levels.ravel()
    for s in range(len(places)):
        for k in range(places.shape[1]):
            place = places[s, k]
            found[s, k] = flat[place] if place >= 0 else 0
            weight[s, k] = place >= 0


@kernel
def gather_confidence(places, temperature, full, weight):
    """Weights (1 - t)^2 of the neighbours (equation 9), in `full` steps, rounded; 0 for those that
    are not there.
    """
    flat = temperature.ravel()
    for s in range(len(places)):
        for k in range(places.shape[1]):
            if places[s, k] >= 0:
                confidence = 1 - np.float64(flat[places[s, k]])
                weight[s, k] = np.uint8(np.floor(full * confidence * confidence + 0.5))


@kernel
def local_sums(found, weight, features, sums):
    """The features summed over the neighbours, (S, C) int32, scaled up where some are missing
    (weight 0).
    """
    K = found.shape[1]
    for s in range(len(found)):
        count = 0
        sums[s] = 0
        for k in range(K):
            if weight[s, k]:
                count += 1
                for c in range(features.shape[1]):
                    sums[s, c] += features[found[s, k], c]
        if 0 < count < K:
            for c in range(features.shape[1]):
                sums[s, c] = sums[s, c] * K // count


@kernel
def plain_rows(found, features, rows):
    """Rows (S, C K + 1) float32: -2 times the features, channel by channel, and a 1 for the
    squares.
    """
    K, C = found.shape[1], features.shape[1]
    for s in range(len(found)):
        for c in range(C):
            for k in range(K):
                rows[s, c * K + k] = -2 * features[found[s, k], c]
        rows[s, C * K] = 1


@kernel
def weighted_rows(found, weight, features, rows):
    """Rows (S, (C + 1) K) float32: -2 times weight times the features, channel by channel, then the
    weights.
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
    """Neighbours as bits: `codes` (L,) uint64 of so many bits `each`, packed from the low end into
    (S, W) uint64; `masks` alike, with ones where a neighbour is there."""
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

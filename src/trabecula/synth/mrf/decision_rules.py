"""From the densities of the views to a site's new level: heuristics (equations 12 to 15), and draw,
arg max or proposal.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox
from trabecula.synth.mrf.tables import UNIT, power_of

COLD = 4096
"""The coldness of temperature 1."""

COLDEST = 64 * COLD
"""The coldness that stands for the mode; colder, differences of scores times it would not fit into
64 bits.
"""


def coldness(heat: float) -> int:
    """1 / heat in whole 4096ths, `COLDEST` at most."""
    return max(1, round(min(COLDEST, COLD / heat)))


@kernel
def combined(log, prior, bias, score):
    """H2b with its corrections: the sum of the views' logarithms, less `prior` (L,), plus `bias`
    (S, L); all in units.
    """
    for s in range(len(log)):
        for level in range(log.shape[2]):
            total = bias[s, level] - prior[level]
            for v in range(log.shape[1]):
                total += log[s, v, level]
            score[s, level] = total


@kernel
def least_of(log, bias, score):
    """H2a: the least of the views' logarithms, plus `bias`."""
    for s in range(len(log)):
        for level in range(log.shape[2]):
            least = log[s, 0, level]
            for v in range(1, log.shape[1]):
                least = min(least, log[s, v, level])
            score[s, level] = least + bias[s, level]


@inline
def _best(row):
    best = 0
    for level in range(1, len(row)):
        if row[level] > row[best]:
            best = level
    return best


@kernel
def of_views(log, features, mean, chosen):
    """H1a, or H1b where `mean`: from the most probable level of each view. `chosen` (S,) uint8."""
    V, L, C = log.shape[1], log.shape[2], features.shape[1]
    total = np.empty(C, np.int64)
    for s in range(len(log)):
        lowest = 0
        total[:] = 0
        for v in range(V):
            best = _best(log[s, v])
            if v == 0 or log[s, v, best] < log[s, lowest, _best(log[s, lowest])]:
                lowest = v
            for c in range(C):
                total[c] += features[best, c]
        if not mean:
            chosen[s] = _best(log[s, lowest])
            continue
        nearest, at = np.int64(2**62), 0
        for level in range(L):
            apart = np.int64(0)
            for c in range(C):
                apart += (V * np.int64(features[level, c]) - total[c]) ** 2
            if apart < nearest:
                nearest, at = apart, level
        chosen[s] = at


@kernel
def greatest(score, chosen):
    """The level of the greatest score; of equals the first."""
    for s in range(len(score)):
        chosen[s] = _best(score[s])


@kernel
def drawn(score, coldness, powers, sites, key, sweep, chosen):
    """A level drawn with probability proportional to 2^(score coldness / 2^16 / 2^12); coldness
    4096 is temperature 1.
    """
    weight = np.empty(score.shape[1], np.int64)
    for s in range(len(score)):
        top = score[s, _best(score[s])]
        total = np.int64(0)
        for level in range(len(weight)):
            weight[level] = power_of(((score[s, level] - top) * coldness) >> 12, powers)
            total += weight[level]
        word = philox(key, sites[s], sites[s] >> 32, sweep, 0)[0]
        at = np.int64(np.float64(word) * 2.0**-32 * np.float64(total))
        level = 0
        while level + 1 < len(weight) and at >= weight[level]:
            at -= weight[level]
            level += 1
        chosen[s] = level


@kernel
def proposed(score, temperature, powers, present, tries, sites, key, sweep, chosen):
    """The paper's figure 1: a level at random takes the place of the present one where p > 1 or p t
    > q, p the ratio of scores.

    `temperature` in 0 .. 2^16; `tries` proposals one after another, each with a q of its own.
    """
    for s in range(len(score)):
        level = np.int64(present[s])
        for trial in range(tries):
            first, second, _, _ = philox(key, sites[s], sites[s] >> 32, sweep, trial)
            other = below(first, score.shape[1])
            ratio = score[s, other] - score[s, level]
            if ratio > 0:
                level = other
            else:
                weight = power_of(max(ratio, -31 * UNIT), powers)  # p times 2^31
                if (np.float64(weight) * np.float64(temperature) * 2.0**-47) > np.float64(
                    second
                ) * 2.0**-32:
                    level = other
        chosen[s] = level

"""Checks of the real parts: how often they would be rejected, and whether exemplars agree."""

from __future__ import annotations

import math

import numpy as np

from trabecula.numerics.quantiles import variance_ratio_tail
from trabecula.report.band import LEAST_COUNT
from trabecula.report.dependence import CorrelatedSample
from trabecula.report.ensemble_tests import ALPHA, band, compare
from trabecula.report.real_parts import RealParts, expect
from trabecula.report.two_samples import adjust


def leave_one_out(parts: RealParts, name: str) -> float | None:
    """Return the share of real parts inside the band of those parts that share no voxel with them;
    None where these are too few.
    """
    inside, known = [], parts.known(name)
    sample, overlap = parts.sample(name), parts.overlap[np.ix_(known, known)]
    for value, shared in zip(sample.values, overlap, strict=True):
        rest = sample.choose(~shared)
        if len(rest.values) >= LEAST_COUNT and rest.freedom >= LEAST_COUNT - 1:
            low, high = band(expect(rest))
            inside.append(low <= value <= high)
    return float(np.mean(inside)) if inside else None


def judge_halves(parts: RealParts) -> tuple[int, int]:
    """Judge parts of the real material as if they were members, against parts that share no voxel
    with them.

    Returns
    -------
    failed, judged : int
        Sets of real parts: all that fail are false alarms, or the exemplar is not one material.
    """
    failed = judged = 0
    for low, high in parts.halves():
        samples = {name: parts.sample(name) for name in parts.names() if parts.known(name).all()}
        ends = [
            {name: sample.choose(mask) for name, sample in samples.items()} for mask in (low, high)
        ]
        if any(
            len(end.values) < LEAST_COUNT or end.freedom < LEAST_COUNT - 1
            for each in ends
            for end in each.values()
        ):
            continue
        found = compare(ends[0], {name: expect(sample) for name, sample in ends[1].items()})
        judged += 1
        failed += any(one.faults for one in found.values())
    return failed, judged


def contradictions(parts: RealParts) -> list[str]:
    """Return the figures whose means differ between exemplars by more than their parts explain."""
    names = [name for name in parts.names() if parts.known(name).all()]
    held = [n for n, boxes in enumerate(parts.boxes) if len(boxes) > 1]
    if len(held) < 2 or not names:
        return []
    found = adjust([_between(parts.sample(name), parts.exemplar_of, held) for name in names])
    return [name for name, value in zip(names, found, strict=True) if value < ALPHA]


def _between(sample: CorrelatedSample, owner: np.ndarray, held: list[int]) -> float:
    """Return the p value of a variance analysis of the exemplars' means."""
    groups = [sample.choose(owner == n) for n in held]
    freedom = sum(group.freedom for group in groups)
    variance = sum(group.freedom * group.deviation**2 for group in groups) / freedom
    weights = np.array([group.count for group in groups])
    means = np.array([group.mean for group in groups])
    between = float(weights @ (means - np.average(means, weights=weights)) ** 2) / (len(held) - 1)
    if between <= variance:
        return 1.0
    ratio = between / variance if variance > 0 else math.inf
    return variance_ratio_tail(float(len(held) - 1), freedom, ratio)

"""Figures of members against those of real parts: tests, intervals, and a verdict for each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trabecula.numerics.quantiles import student, variance_ratio_share
from trabecula.report.dependence import CorrelatedSample
from trabecula.report.ensemble_figures import is_one_sided, is_share
from trabecula.report.real_parts import Expected
from trabecula.report.two_samples import (
    RankTests,
    adjust,
    mean_p,
    spread_interval,
    spread_p,
    tail_share,
    welch_freedom,
)

CONFIDENCE = 0.95
"""Of intervals and of the band of single parts."""
ALPHA = 0.05
"""Share of ensembles of real material that some figure may fail."""
ALIKE = 1.25
"""A ratio of spreads nearer to 1 than this factor is no fault, however sure it is."""
NEAR = 0.2
"""A shift of the mean by fewer real standard deviations is no fault, however sure it is."""
SPREAD_BLUR = 2.0
"""Where the ratio of spreads is not known to within this factor, a figure without fault is not
passed: half the spread would not be seen.
"""
MEAN_BLUR = 2.5
"""So is it where the mean is not known to within so many real standard deviations. One exemplar no
larger than a member knows it to 2.3.
"""

PASS, MEAN, SMALL, LARGE, SHAPE, OPEN = (
    "pass",
    "mean off",
    "spread too small",
    "spread too large",
    "shape off",
    "cannot tell",
)
"""Verdicts of a figure."""

RANK_TESTS = {"kolmogorov_smirnov": "Kolmogorov-Smirnov", "mann_whitney": "Mann-Whitney"}


@dataclass(frozen=True)
class Comparison:
    """Members against real parts in one figure."""

    members: tuple[float, ...]
    real: tuple[float, ...]
    """Of the real parts; empty where none is as large as the members."""
    mean: float
    deviation: float
    real_mean: float
    real_deviation: float
    ratio: float | None
    """Of the standard deviations; None where real parts do not differ at all."""
    ratio_interval: tuple[float, float] | None
    shift: float | None
    """Of the mean, in real standard deviations."""
    shift_interval: tuple[float, float] | None
    p: Mapping[str, float]
    """By test: "mean", "spread", "kolmogorov_smirnov", "mann_whitney"."""
    band: tuple[float, float]
    """Where 95 % of single parts of the members' size are."""
    adjusted: Mapping[str, float]
    """As `p`, corrected for all tests of all figures."""
    chance: float
    """Probability that spreads of real material agree within a quarter, with so few values."""
    faults: tuple[str, ...]
    """Verdicts that it fails by, the worst first."""
    reason: str

    @property
    def verdict(self) -> str:
        """Return the verdict: a fault, "pass" or "cannot tell"."""
        return self.faults[0] if self.faults else PASS if not self.reason else OPEN

    @property
    def passed(self) -> bool | None:
        """Return whether it passes; None where that is not decided."""
        return False if self.faults else {PASS: True}.get(self.verdict)

    @property
    def within(self) -> bool:
        """Return whether spreads agree within a quarter and no single test is below 0.05."""
        alike = self.ratio is not None and 1 / ALIKE <= self.ratio <= ALIKE
        return alike and min(self.p.values()) > ALPHA

    @property
    def inside(self) -> float:
        """Return the share of members inside the band."""
        low, high = self.band
        return float(np.mean([low <= value <= high for value in self.members]))


def compare(
    members: Mapping[str, CorrelatedSample], expected: Mapping[str, Expected]
) -> dict[str, Comparison]:
    """Compare figures of members with what is expected of them, by name.

    p values of all tests of all figures are corrected together.
    """
    p = {name: _test(sample, expected[name]) for name, sample in members.items()}
    keys = [(name, test) for name, tests in p.items() for test in tests]
    corrected = dict(zip(keys, adjust([p[name][test] for name, test in keys]), strict=True))
    found = {}
    for name, sample in members.items():
        real, constant = expected[name], sample.deviation == 0
        adjusted = {test: corrected[name, test] for test in p[name]}
        effects = _measure_effects(sample, real)
        better = is_one_sided(name) and effects is not None and effects.shift > 0
        faults = () if better else _faults(effects, adjusted, constant)
        reason = "" if better else _doubt(effects, constant)
        found[name] = Comparison(
            members=tuple(sample.values.tolist()),
            real=() if real.sample is None else tuple(real.sample.values.tolist()),
            mean=sample.mean,
            deviation=sample.deviation,
            real_mean=real.mean,
            real_deviation=real.deviation,
            ratio=effects.ratio if effects else None,
            ratio_interval=effects.ratio_interval if effects else None,
            shift=effects.shift if effects else None,
            shift_interval=effects.shift_interval if effects else None,
            p=p[name],
            band=band(real, share=is_share(name)),
            adjusted=adjusted,
            chance=effects.chance if effects else 0.0,
            faults=faults,
            reason=_explain(effects, faults, adjusted, constant) if faults else reason,
        )
    return found


@dataclass(frozen=True)
class _Effects:
    """Differences in one figure, with their intervals."""

    ratio: float
    """Of the standard deviations."""
    ratio_interval: tuple[float, float]
    shift: float
    """Of the mean, in real standard deviations."""
    shift_interval: tuple[float, float]
    chance: float
    """Probability of a ratio within `ALIKE`, were there no difference."""

    @property
    def spread_fault(self) -> str | None:
        """Return the fault of a spread that is too far from the real one to be overlooked."""
        if 1 / ALIKE <= self.ratio <= ALIKE:
            return None
        return SMALL if self.ratio < 1 else LARGE


def _test(members: CorrelatedSample, real: Expected) -> dict[str, float]:
    """Return the p values of the tests that are possible."""
    error, freedom = _error(members, real)
    p = {"mean": mean_p(members.mean - real.mean, error, freedom)}
    if real.deviation > 0:
        freedoms = _freedoms(members, real)
        low, high = _ratios(members, real)
        within = low < 1 < high  # between both extrapolations nothing is wrong
        p["spread"] = 1.0 if within else max(spread_p(each, freedoms) for each in (low, high))
    if real.sample is not None:
        tests = _rank_tests(members.correlation.tobytes(), real.sample.correlation.tobytes())
        values = members.values, real.sample.values
        p["kolmogorov_smirnov"] = tests.kolmogorov_smirnov(*values)
        p["mann_whitney"] = tests.mann_whitney(*values)
    return p


def _measure_effects(members: CorrelatedSample, real: Expected) -> _Effects | None:
    """Return the differences; None where real parts all have one value."""
    if real.deviation <= 0:
        return None
    freedoms, ratios = _freedoms(members, real), _ratios(members, real)
    error, freedom = _error(members, real)
    difference = members.mean - real.mean
    reach = student(freedom, (1 + CONFIDENCE) / 2) * error
    return _Effects(
        ratios[0],
        (
            spread_interval(ratios[0], freedoms, CONFIDENCE)[0],
            spread_interval(ratios[1], freedoms, CONFIDENCE)[1],
        ),
        difference / real.deviation,
        ((difference - reach) / real.deviation, (difference + reach) / real.deviation),
        variance_ratio_share(*freedoms, ALIKE**2),
    )


def _error(members: CorrelatedSample, real: Expected) -> tuple[float, float]:
    """Return the standard error of the difference of means, and its degrees of freedom."""
    errors = members.error, real.error
    return math.hypot(*errors), welch_freedom(errors, (members.freedom, real.freedom))


def _freedoms(members: CorrelatedSample, real: Expected) -> tuple[float, float]:
    """Return the degrees of freedom of both variances."""
    share = tail_share(*([members] if real.sample is None else [members, real.sample]))
    return share * members.freedom, share * real.freedom


def _ratios(members: CorrelatedSample, real: Expected) -> tuple[float, float]:
    """Return the ratios to both real deviations, which differ where they are extrapolated."""
    return members.deviation / real.deviation, members.deviation / real.least_deviation


@lru_cache(maxsize=4)
def _rank_tests(first: bytes, second: bytes) -> RankTests:
    """Return the rank tests for two correlations, drawn once for all figures."""
    one, other = (
        np.frombuffer(each).reshape((math.isqrt(len(each) // 8),) * 2) for each in (first, second)
    )
    return RankTests(one, other)


def _faults(
    effects: _Effects | None, adjusted: Mapping[str, float], constant: bool
) -> tuple[str, ...]:
    """Return the faults that the corrected tests are sure of and that matter."""
    sure = {test for test, value in adjusted.items() if value < ALPHA}
    if effects is None:
        return (MEAN if constant else LARGE,) if sure else ()
    ranks = bool(sure & set(RANK_TESTS))
    spread, found = effects.spread_fault, []
    if "spread" in sure and spread:
        found.append(spread)
    low, high = effects.shift_interval
    if ("mean" in sure or ranks) and abs(effects.shift) >= NEAR and (low > 0 or high < 0):
        found.append(MEAN)
    if ranks and not found:
        low, high = effects.ratio_interval
        found.append(spread if spread and (low > 1 or high < 1) else SHAPE)
    return tuple(sorted(found, key=(SMALL, MEAN, LARGE, SHAPE).index))


def _explain(
    effects: _Effects | None, faults: tuple[str, ...], adjusted: Mapping[str, float], constant: bool
) -> str:
    """Return what the faults are, with their sizes."""
    if effects is None:
        return "real parts all have one value, and members another"
    texts = []
    for fault in faults:
        if fault in (SMALL, LARGE):
            low, high = effects.ratio_interval
            texts.append(f"spread {effects.ratio:.2f} of the real one ({low:.2f} to {high:.2f})")
        elif fault == MEAN:
            low, high = effects.shift_interval
            by = f"{effects.shift:+.1f} real standard deviations off ({low:+.1f} to {high:+.1f})"
            texts.append(f"mean {by}")
        else:
            worst = min(RANK_TESTS, key=lambda test: adjusted[test])
            texts.append(f"mean and spread agree, the distribution does not ({RANK_TESTS[worst]})")
    return "; ".join([*texts, *(["all members have one value"] if constant else [])])


def _doubt(effects: _Effects | None, constant: bool) -> str:
    """Return why a figure without faults proves nothing; empty where it does."""
    if effects is None:
        return "" if constant else "real parts all have one value: there is no spread to compare"
    texts = []
    low, high = effects.ratio_interval
    if not 0 < high <= SPREAD_BLUR**2 * low:
        texts.append(f"the ratio of spreads is only known to be {low:.2f} to {high:.2f}")
    low, high = effects.shift_interval
    if high - low > 2 * MEAN_BLUR:
        reach = (high - low) / 2
        texts.append(f"the mean is only known to within {reach:.1f} real standard deviations")
    return "; ".join(texts)


def band(real: Expected, *, share: bool = False) -> tuple[float, float]:
    """Return where 95 % of single parts of the members' size are; of a share between 0 and 1."""
    reach = student(real.freedom, (1 + CONFIDENCE) / 2)
    far = reach * math.hypot(real.deviation, real.error)
    low, high = real.mean - far, real.mean + far
    return (max(low, 0.0), min(high, 1.0)) if share else (low, high)

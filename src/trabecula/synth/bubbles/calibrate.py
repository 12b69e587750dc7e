"""Settings that come near to an exemplar, found by a search over trials.

A trial grows a small volume and measures its distances to the exemplar (`fit_objective`). The
search is the pattern search of Hooke and Jeeves (1961), doi:10.1145/321062.321069: each number is
tried one step up and one step down, and the better one is kept; a round that helped is repeated as
a leap, and one that did not halves the steps. It starts from points that are spread evenly (Halton
1960, doi:10.1007/BF01386213). All trials have the same seed, so that two of them differ by their
settings alone. The search changes only settings that are at their defaults; a given flow stays, and
the search finds how far bubbles follow it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.measure.fabric import fabric
from trabecula.synth.api.exemplar_info import without_exemplar
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.fit_objective import (
    Exemplar,
    Maker,
    reduce_exemplar,
    total_distance,
    trial,
)


@dataclass(frozen=True)
class Scale:
    """A number of the search.

    Attributes
    ----------
    name : str
    low, high : float
        Its range.
    step : float
        Of the first round; all are halved together.
    """

    name: str
    low: float
    high: float
    step: float


_PRIMES = (2, 3, 5, 7, 11, 13, 17)

Point = tuple[float, ...]


@dataclass
class Search:
    """A pattern search with a record of its trials.

    Attributes
    ----------
    cost : callable
        Of a point, the less the better.
    scales : sequence of Scale
    most : int
        Points that may be tried.
    tried : dict
        Cost by point, in the order of trials.
    """

    cost: Callable[[Point], float]
    scales: Sequence[Scale]
    most: int
    tried: dict[Point, float] = field(default_factory=dict)

    @property
    def out_of_trials(self) -> bool:
        """Return whether all trials are used."""
        return len(self.tried) >= self.most

    def evaluate(self, point: Sequence[float]) -> tuple[float, Point]:
        """Return the cost of a point clipped to the ranges, and that point.

        The cost is infinite where no trial is left.
        """
        inside = tuple(min(max(x, s.low), s.high) for x, s in zip(point, self.scales, strict=True))
        if inside not in self.tried:
            if self.out_of_trials:
                return float("inf"), inside
            self.tried[inside] = self.cost(inside)
        return self.tried[inside], inside

    def run(self, starts: Sequence[Sequence[float]], *, halvings: int = 3) -> None:
        """Search for the least cost from the best start until the steps are small.

        Then it continues from the next start while trials are left.
        """
        costs = sorted(self.evaluate(start) for start in starts)
        for begun in costs:
            best, share, signs = begun, 1.0, [1.0] * len(self.scales)
            while not self.out_of_trials and share >= 0.5**halvings:
                before = best
                best = self._explore(best, share, signs)
                if best[0] < before[0]:
                    leap = [2 * new - old for new, old in zip(best[1], before[1], strict=True)]
                    best = min(best, self.evaluate(leap))
                else:
                    share /= 2

    def best(self, count: int) -> list[Point]:
        """Return the points of least cost in rising order; of equal ones the first trial."""
        return sorted(self.tried, key=lambda point: self.tried[point])[:count]

    def _explore(
        self, best: tuple[float, Point], share: float, signs: list[float]
    ) -> tuple[float, Point]:
        """Try every number one step up or down, first in the direction that last helped."""
        for n, scale in enumerate(self.scales):
            for sign in (signs[n], -signs[n]):
                moved = list(best[1])
                moved[n] += sign * share * scale.step
                found = self.evaluate(moved)
                if found[0] < best[0]:
                    best, signs[n] = found, sign
                    break
        return best


def halton_points(scales: Sequence[Scale], around: Point, count: int) -> list[Point]:
    """Return points spread evenly over the ranges, at most four steps from `around`."""
    found = []
    for number in range(1, count + 1):
        place = []
        for scale, middle, prime in zip(scales, around, _PRIMES, strict=False):
            low = max(scale.low, middle - 4 * scale.step)
            high = min(scale.high, middle + 4 * scale.step)
            eighth = scale.step / 8
            place.append(
                round((low + (high - low) * _radical_inverse(number, prime)) / eighth) * eighth
            )
        found.append(tuple(place))
    return found


def _radical_inverse(number: int, base: int) -> float:
    """Return the digits of a number in a base, mirrored about the point (van der Corput)."""
    value, weight = 0.0, 1.0
    while number:
        number, digit = divmod(number, base)
        weight /= base
        value += digit * weight
    return value


_THIN = 20  # of 200 walls in order of thickness: one between two bubbles, not between many
_PRESSED = 0.4
_SEED = 0
_CANDIDATES, _OTHER_SEEDS = 5, (1, 2)
"""Number of the best points that are tried again beside the first, and the seeds of that."""

_CHECK_SEEDS = (3, 4, 5)
"""New seeds for the distances of the result."""

_ROOM = 0.005  # porosity in reach beyond the wanted one
_START_SHARE = 0.3  # share of the trials spent on starting points
_ALIKE = 1.15  # longest over shortest intercept length from which a direction is preferred
_SCALES = {
    "size": Scale("size", -4.0, 4.0, 0.75),  # log2 of the first guess's density over the trial's
    "wall": Scale("wall", -7.0, -1.5, 0.5),  # log2 of the thickness over L
    "spread": Scale("spread", 0.0, 0.6, 0.125),
    "regularity": Scale("regularity", 0.0, 1.0, 0.25),
    "coalescence": Scale("coalescence", 0.0, 1.0, 0.25),
    "roughness": Scale("roughness", 0.0, 1.0, 0.25),
    "follow": Scale("follow", -3.0, 0.0, 0.25),  # log2 of the randomness
}
_UNSCALED = ("spread", "regularity", "coalescence", "roughness")


def calibrate(
    config: BubblesConfig, exemplar: Image, make: Maker
) -> tuple[BubblesConfig, dict[str, Any]]:
    """Return the settings that come nearest to an exemplar, and a report of the search.

    Parameters
    ----------
    config : BubblesConfig
        Its `trials` are the most settings to try; a setting that differs from its default stays.
    exemplar : Image of void and another phase, (Z, Y, X) or (Y, X)
    make : callable
        Makes the model of settings and of the size of a voxel.

    Returns
    -------
    found : BubblesConfig
    report : dict
        Plain JSON: `found` (the settings by name), `start` and `end` (distances by name, and their
        weighted sum `total`), `checks` (those of the end for new seeds), `trace`
        (the least total so far after every trial).
    """
    if not config.trials:
        return config, {}
    seen = reduce_exemplar(exemplar)
    first = replace(config, **_guess(config, seen))
    scales = [scale for name, scale in _SCALES.items() if _is_free(name, config, first)]

    def cost(point: Point) -> float:
        progress.report("fitting bubbles", len(search.tried) / config.trials)
        return total_distance(trial(_settings_at(first, scales, point), seen, make, _SEED))

    search = Search(cost, scales, config.trials)
    start = _point(first, scales)
    if scales:
        search.run(_starts(start, scales, config.trials))
    best = search.best(1 + min(_CANDIDATES, config.trials // 10)) or [start]
    candidates = [_settings_at(first, scales, point) for point in best]
    found = _choose_robust(candidates, seen, make)
    progress.report("fitting bubbles", 1.0)
    changed = {
        f.name: getattr(found, f.name)
        for f in fields(found)
        if getattr(found, f.name) != getattr(config, f.name)
    }
    report = {
        "found": changed,
        "start": _with_total(trial(first, seen, make, _SEED)),
        "end": _with_total(trial(found, seen, make, _SEED)),
        "checks": [_with_total(trial(found, seen, make, seed)) for seed in _CHECK_SEEDS],
        "trace": np.minimum.accumulate([*search.tried.values()] or [0.0]).tolist(),
    }
    return found, report


def _choose_robust(candidates: list[BubblesConfig], seen: Exemplar, make: Maker) -> BubblesConfig:
    """Choose the candidate that is nearest for other seeds than that of the search.

    The best of many settings is fitted in part to the chance of one seed.
    """
    costs = [
        sum(total_distance(trial(config, seen, make, seed)) for seed in _OTHER_SEEDS)
        for config in candidates
    ]
    return _ensure_reachable(candidates[costs.index(min(costs))], seen, make)


def _ensure_reachable(found: BubblesConfig, seen: Exemplar, make: Maker) -> BubblesConfig:
    """Drop the porosity where walls hardly leave room for it.

    Growth to the end comes as near to it, and is never refused.
    """
    if found.porosity is None:
        return found
    model = make(
        replace(found, porosity=min(found.porosity + _ROOM, 0.9999)),
        [without_exemplar(seen.spacing, seen.image.unit)],
    )
    try:
        model.generate(seen.image.shape, seed=_SEED)
    except RequestError:
        return replace(found, porosity=None)
    return found


def _settings_at(first: BubblesConfig, scales: list[Scale], point: Point) -> BubblesConfig:
    """Return the first guess with the numbers of a point.

    Powers are rounded, since machines disagree about their last bits.
    """
    numbers = {scale.name: value for scale, value in zip(scales, point, strict=True)}
    changes: dict[str, Any] = {name: numbers[name] for name in _UNSCALED if name in numbers}
    if "size" in numbers and first.density is not None:
        changes["density"] = _round_digits(first.density * 2 ** -numbers["size"])
    if "wall" in numbers:
        changes["thickness"] = _round_digits(2 ** numbers["wall"])
    if "follow" in numbers:
        changes["randomness"] = max(_round_digits(2 ** numbers["follow"]), 0.05)
    return replace(first, **changes)


def _guess(config: BubblesConfig, seen: Exemplar) -> dict[str, Any]:
    """Guess density, wall thickness, porosity and flow from the measures alone."""
    measured, ndim = seen.measured, seen.ndim
    ball = math.pi / 6 if ndim == 3 else math.pi / 4
    # Balls of that diameter make that porosity; where bubbles are pressed together, the largest
    # ball in one is smaller than the bubble.
    ball_diameter = measured.pores.mean() / (1 - _PRESSED * measured.porosity)
    apart_by = ball_diameter * (ball / measured.porosity) ** (1 / ndim)
    changes: dict[str, Any] = {}
    if _is_default(config, "density") and _is_default(config, "distance"):
        changes["density"] = _round_digits(apart_by**-ndim)
    if _is_default(config, "separation") and _is_default(config, "thickness"):
        changes["thickness"] = _round_digits(min(max(measured.walls[_THIN] / apart_by, 0.01), 0.35))
    if config.time is None and config.porosity is None:
        changes["porosity"] = _round_digits(measured.porosity)
    if config.flow == "none" and not config.flow_regions and _is_default(config, "randomness"):
        changes |= _direction(seen)
    return changes


def _direction(seen: Exemplar) -> dict[str, Any]:
    """Return a flow along the longest intercepts, where they differ, and its randomness."""
    found = fabric(seen.image)
    longest, others = found.lengths[0], found.lengths[1:]
    if longest < _ALIKE * others.min():
        return {}
    axis = found.directions[0]
    along = np.round(axis * np.sign(axis[np.argmax(np.abs(axis))]), 2)
    ratio = float(np.exp(np.mean(np.log(others / longest))))
    return {
        "flow": ", ".join(f"{part:g}" for part in along[::-1] + 0.0),
        "randomness": _round_digits(max(ratio, 0.2)),
    }


def _is_free(name: str, config: BubblesConfig, first: BubblesConfig) -> bool:
    """Return whether the search may change a number."""
    if name == "size":
        return _is_default(config, "density") and _is_default(config, "distance")
    if name == "wall":
        return _is_default(config, "separation") and _is_default(config, "thickness")
    if name == "follow":
        return first.flow != "none" and _is_default(config, "randomness")
    return _is_default(config, name)


def _is_default(config: BubblesConfig, name: str) -> bool:
    """Return whether a setting is at its default."""
    return bool(getattr(config, name) == getattr(BubblesConfig, name))


def _point(first: BubblesConfig, scales: list[Scale]) -> Point:
    """Return the point of the first guess."""
    places = {"size": 0.0, "wall": _log2(first.thickness), "follow": _log2(first.randomness)}
    return tuple(places.get(scale.name, getattr(first, scale.name, 0.0)) for scale in scales)


def _starts(start: Point, scales: list[Scale], trials: int) -> list[Point]:
    """Return the first guess, the same with merging pores, and points over all ranges."""
    opened = [
        tuple(
            share if scale.name == "coalescence" else x
            for scale, x in zip(scales, start, strict=True)
        )
        for share in (0.0, 0.5, 1.0)
    ]
    return list(
        dict.fromkeys([start, *opened, *halton_points(scales, start, int(trials * _START_SHARE))])
    )


def _log2(value: float) -> float:
    """Return the binary logarithm, rounded to eighths."""
    return round(8 * math.log2(value)) / 8


def _round_digits(value: float) -> float:
    """Round to four significant digits."""
    return float(f"{value:.4g}")


def _with_total(parts: Mapping[str, float]) -> dict[str, float]:
    """Add the weighted sum to distances."""
    return {**parts, "total": total_distance(parts)}

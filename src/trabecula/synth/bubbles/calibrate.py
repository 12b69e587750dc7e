"""Settings that make bubbles look like an exemplar, found by trial.

A trial grows a small volume and measures how far it is from the exemplar (`likeness`); `search`
looks for the settings that are nearest. All trials have the same seed: what differs between two is
due to their settings. Only settings that are at their defaults are looked for; a flow that was
given stays, and how far it is followed is found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, with_values
from trabecula.measure.fabric import fabric
from trabecula.synth.api.exemplar_info import ExemplarInfo, without_exemplar
from trabecula.synth.api.method import Model
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.fit_objective import Look, apart, look_of
from trabecula.synth.bubbles.fit_search import Point, Scale, Search, even

_SIDE = {3: 72, 2: 400}
"""Voxels of the exemplar along an axis that are looked at, the middle ones."""

_FINE = 10  # voxels of a mean pore's diameter: finer ones are not needed
_THIN = 20  # of 200 walls in order of thickness: what is between two bubbles, and not between many
_PRESSED = 0.4
_SEED = 0
_LAST, _OTHERS = 5, (1, 2)
"""How many of the best are tried again beside the first, and with which seeds."""

_CHECKS = (3, 4, 5)
"""Seeds that neither has seen, by which what was found is judged."""

# bytes a voxel of a trial and its measures, and of directions, whatever its size
_HELD, _LEAST_HELD = 30, 8_600_000
_ROOM = 0.005  # porosity that has to be in reach beyond what is wanted
_LEAST = 32  # voxels along an axis that a coarser exemplar keeps
_LOOKS = 0.3  # share of the trials that look where to begin
# of the distances in their sum: a direction is seen long before it measures much
_WEIGHTS = {"anisotropy": 3.0}
_ALIKE = 1.15  # longest over shortest intercept length from which a direction is preferred
_SCALES = {
    "size": Scale("size", -4.0, 4.0, 0.75),  # log2 of the first guess's density over what is tried
    "wall": Scale("wall", -7.0, -1.5, 0.5),  # log2 of the thickness over L
    "spread": Scale("spread", 0.0, 0.6, 0.125),
    "regularity": Scale("regularity", 0.0, 1.0, 0.25),
    "coalescence": Scale("coalescence", 0.0, 1.0, 0.25),
    "roughness": Scale("roughness", 0.0, 1.0, 0.25),
    "follow": Scale("follow", -3.0, 0.0, 0.25),  # log2 of the randomness
}
_SAME = ("spread", "regularity", "coalescence", "roughness")

Maker = Callable[[BubblesConfig, list[ExemplarInfo]], Model]


@dataclass(frozen=True)
class Exemplar:
    """What is looked at of an exemplar: void 0 and solid 1, in voxels no finer than needed."""

    image: Image
    look: Look
    ndim: int

    @property
    def spacing(self) -> float:
        """Of a voxel."""
        return self.image.spacing[0]


def calibrated(
    config: BubblesConfig, exemplar: Image, make: Maker
) -> tuple[BubblesConfig, dict[str, Any]]:
    """The settings that come nearest to an exemplar, and how they were found.

    Parameters
    ----------
    config : BubblesConfig
        Its `trials` are the settings that are tried, at most; what differs from its default is
        kept.
    exemplar : Image of void and another phase, (Z, Y, X) or (Y, X)
    make : callable
        The model of settings and facts (blank).

    Returns
    -------
    found : BubblesConfig
    report : dict
        Plain JSON: `found` (the settings by name), `start` and `end` (distances by name, and their
        weighted sum `total`), `checks` (the end's for seeds that the search has not seen), `trace`
        (the least total so far after every trial).
    """
    if not config.trials:
        return config, {}
    seen = reduced(exemplar)
    first = replace(config, **_guess(config, seen))
    scales = [scale for name, scale in _SCALES.items() if _is_free(name, config, first)]

    def cost(point: Point) -> float:
        progress.report("fitting bubbles", len(search.tried) / config.trials)
        return total(trial(moved(first, scales, point), seen, make, _SEED))

    search = Search(cost, scales, config.trials)
    start = _point(first, scales)
    if scales:
        search.run(_starts(start, scales, config.trials))
    found = _steady(
        [
            moved(first, scales, point)
            for point in search.best(1 + min(_LAST, config.trials // 10)) or [start]
        ],
        seen,
        make,
    )
    progress.report("fitting bubbles", 1.0)
    changed = {
        f.name: getattr(found, f.name)
        for f in fields(found)
        if getattr(found, f.name) != getattr(config, f.name)
    }
    report = {
        "found": changed,
        "start": _told(trial(first, seen, make, _SEED)),
        "end": _told(trial(found, seen, make, _SEED)),
        "checks": [_told(trial(found, seen, make, seed)) for seed in _CHECKS],
        "trace": np.minimum.accumulate([*search.tried.values()] or [0.0]).tolist(),
    }
    return found, report


def _steady(candidates: list[BubblesConfig], seen: Exemplar, make: Maker) -> BubblesConfig:
    """The one that is nearest for other seeds than the search's, to which the best of many settings
    is fitted by chance.
    """
    costs = [
        sum(total(trial(config, seen, make, seed)) for seed in _OTHERS) for config in candidates
    ]
    return _reachable(candidates[costs.index(min(costs))], seen, make)


def _reachable(found: BubblesConfig, seen: Exemplar, make: Maker) -> BubblesConfig:
    """Without a porosity where walls hardly leave room for it: growth to the end comes as near, and
    is never refused.
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


def reduced(exemplar: Image) -> Exemplar:
    """The middle of an exemplar, coarser where its pores are large.

    Raises
    ------
    InputError
        The middle holds one phase alone.
    """
    void = exemplar.phases.index("void") if "void" in exemplar.phases else 0
    whole = Image(
        (exemplar.values != void).astype(np.uint8), "labels", exemplar.spacing, exemplar.unit
    )
    image = _middle(whole)
    look = _seen(image)
    factor = int(look.pores.mean() / exemplar.spacing[0] / _FINE)
    if factor > 1 and min(exemplar.shape) // factor >= _LEAST:
        image = _middle(_coarser(whole, factor))
        look = _seen(image)
    return Exemplar(image, look, exemplar.ndim)


def _seen(image: Image) -> Look:
    look = look_of(image)
    if look is None:
        raise InputError(
            f"the middle of the exemplar, {image.shape}, holds one phase alone: give a crop with bubbles all over"
        )
    return look


def _middle(image: Image) -> Image:
    cuts = []
    for side in image.shape:
        keep = min(side, _SIDE[image.ndim])
        cuts.append(slice((side - keep) // 2, (side - keep) // 2 + keep))
    return with_values(image, np.ascontiguousarray(image.values[tuple(cuts)]))


def _coarser(image: Image, factor: int) -> Image:
    """Blocks of voxels as one, solid where most of it is, so that as much is solid as before."""
    shape = [side // factor for side in image.shape]
    inner = image.values[tuple(slice(0, side * factor) for side in shape)]
    split = inner.reshape([part for side in shape for part in (side, factor)])
    counts = split.sum(axis=tuple(range(1, 2 * image.ndim, 2)), dtype=np.int64)
    level = np.sort(counts, axis=None)[::-1][
        min(round(inner.mean() * counts.size), counts.size - 1)
    ]
    either = (counts >= level, counts > level)
    solid = min(either, key=lambda chosen: abs(chosen.mean() - inner.mean()))
    return with_values(
        image, solid.astype(np.uint8), spacing=tuple(edge * factor for edge in image.spacing)
    )


def trial(config: BubblesConfig, seen: Exemplar, make: Maker, seed: int) -> Mapping[str, float]:
    """Distances of a volume of these settings, as large as what is looked at of the exemplar.

    Where walls leave no room for the porosity, growth goes on to the end, and the porosity that
    lacks is a distance.
    """
    facts = without_exemplar(seen.spacing, seen.image.unit)
    for tried in (config, replace(config, porosity=None)):
        try:
            return apart(
                look_of(make(tried, [facts]).generate(seen.image.shape, seed=seed)), seen.look
            )
        except RequestError:
            continue
    return apart(None, seen.look)


def bytes_of_search(shape: Sequence[int]) -> int:
    """Memory that trials for an exemplar of this shape take, and what is looked at of it."""
    seen = math.prod(min(side, _SIDE[len(shape)]) for side in shape)
    return math.prod(shape) + max(_HELD * seen, _LEAST_HELD)


def total(parts: Mapping[str, float]) -> float:
    """One distance of all: their sum, some of them weighted."""
    return round(sum(_WEIGHTS.get(name, 1.0) * value for name, value in parts.items()), 6)


def moved(first: BubblesConfig, scales: list[Scale], point: Point) -> BubblesConfig:
    """The first guess with the numbers that are searched for at a point.

    Powers are rounded, since machines disagree about their last bits.
    """
    numbers = {scale.name: value for scale, value in zip(scales, point, strict=True)}
    changes: dict[str, Any] = {name: numbers[name] for name in _SAME if name in numbers}
    if "size" in numbers and first.density is not None:
        changes["density"] = _rounded(first.density * 2 ** -numbers["size"])
    if "wall" in numbers:
        changes["thickness"] = _rounded(2 ** numbers["wall"])
    if "follow" in numbers:
        changes["randomness"] = max(_rounded(2 ** numbers["follow"]), 0.05)
    return replace(first, **changes)


def _guess(config: BubblesConfig, seen: Exemplar) -> dict[str, Any]:
    """What measures alone tell: how many bubbles, how thick their walls are, when growth stops, and
    which way it goes.
    """
    look, ndim = seen.look, seen.ndim
    ball = math.pi / 6 if ndim == 3 else math.pi / 4
    # Balls of that diameter make that porosity; where bubbles are pressed together, what fits into
    # one is smaller than it.
    ball_diameter = look.pores.mean() / (1 - _PRESSED * look.porosity)
    apart_by = ball_diameter * (ball / look.porosity) ** (1 / ndim)
    changes: dict[str, Any] = {}
    if _is_default(config, "density") and _is_default(config, "distance"):
        changes["density"] = _rounded(apart_by**-ndim)
    if _is_default(config, "separation") and _is_default(config, "thickness"):
        changes["thickness"] = _rounded(min(max(look.walls[_THIN] / apart_by, 0.01), 0.35))
    if config.time is None and config.porosity is None:
        changes["porosity"] = _rounded(look.porosity)
    if config.flow == "none" and not config.flow_regions and _is_default(config, "randomness"):
        changes |= _direction(seen)
    return changes


def _direction(seen: Exemplar) -> dict[str, Any]:
    """A flow along the longest intercepts, where they differ; how far it is followed makes them as
    long.
    """
    found = fabric(seen.image)
    longest, others = found.lengths[0], found.lengths[1:]
    if longest < _ALIKE * others.min():
        return {}
    along = np.round(
        found.directions[0] * np.sign(found.directions[0][np.argmax(np.abs(found.directions[0]))]),
        2,
    )
    ratio = float(np.exp(np.mean(np.log(others / longest))))
    return {
        "flow": ", ".join(f"{part:g}" for part in along[::-1] + 0.0),
        "randomness": _rounded(max(ratio, 0.2)),
    }


def _is_free(name: str, config: BubblesConfig, first: BubblesConfig) -> bool:
    if name == "size":
        return _is_default(config, "density") and _is_default(config, "distance")
    if name == "wall":
        return _is_default(config, "separation") and _is_default(config, "thickness")
    if name == "follow":
        return first.flow != "none" and _is_default(config, "randomness")
    return _is_default(config, name)


def _is_default(config: BubblesConfig, name: str) -> bool:
    return bool(getattr(config, name) == getattr(BubblesConfig, name))


def _point(first: BubblesConfig, scales: list[Scale]) -> Point:
    """Where the first guess lies."""
    places = {"size": 0.0, "wall": _log2(first.thickness), "follow": _log2(first.randomness)}
    return tuple(places.get(scale.name, getattr(first, scale.name, 0.0)) for scale in scales)


def _starts(start: Point, scales: list[Scale], trials: int) -> list[Point]:
    """The first guess, it with pores that are open to each other, and points all over."""
    opened = [
        tuple(
            share if scale.name == "coalescence" else x
            for scale, x in zip(scales, start, strict=True)
        )
        for share in (0.0, 0.5, 1.0)
    ]
    return list(dict.fromkeys([start, *opened, *even(scales, start, int(trials * _LOOKS))]))


def _log2(value: float) -> float:
    """In eighths."""
    return round(8 * math.log2(value)) / 8


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _told(parts: Mapping[str, float]) -> dict[str, float]:
    return {**parts, "total": total(parts)}

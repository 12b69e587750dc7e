"""Material that has a property: the porosity that gives it is sought by the solvers.

Small trials over the porosities that the exemplar holds say what the material can have; they are
the map from porosity to property. The result is made at the porosity that the map names, measured,
and made again where it is off: the map keeps its slope and takes the level of what was measured,
then results on both sides of it bound the next one. Another porosity is another result, so that
they scatter: where three are off, the surface of the nearest is moved until it has the property.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from trabecula.core.checks import as_number, check_name, quote
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify, track
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.finish.offset import offset
from trabecula.measure.properties import PROPERTIES, measure_property
from trabecula.synth.api.model import Model, as_request

MOST = 3
"""Results that are made and measured at most."""

MOVES = 5
"""Times that the surface of the nearest result is moved, and it is measured again, at most."""

_SIDE = 64  # voxels of a trial along every axis, at most
_TRIALS = 5  # porosities of the map
_WIDEST = (0.02, 0.98)  # porosities of trials where the exemplar sets no bounds
_STEP = 0.05  # of porosity, where a map says nothing of the next
_DIGITS = 6  # of a porosity
_NEAR = 1e-4  # of a porosity to one that was made: it would be much the same result
_JUMP = 3e-3  # of porosity between results, within which they differ by chance
_FARTHEST = 0.03  # of porosity that a surface is moved by

Point = tuple[float, float]
"""A porosity, and the property of material that was made with it."""


@dataclass(frozen=True)
class PropertyMatch:
    """Material made to have a property.

    Attributes
    ----------
    image : Image
        The nearest result. Its recipe names the porosity, and that of a moved surface, so that
        `tb.rerun` needs no search.
    request : Request
        The request that made it, with the porosity it was made with as target.
    porosity : float
        What the image has: another where its surface was moved.
    name : str
    asked, value : float
        The property's goal, and what the image has.
    within : float
        Relative error that was allowed.
    trials : tuple of (float, float)
        Porosity and property of small trials, by porosity.
    made : tuple of (float, float)
        Porosity and property of every result of full size, in their order.
    moved : tuple of (float, float)
        The same of the nearest of them with its surface moved (`finish.offset`).
    """

    image: Image
    request: Request
    porosity: float
    name: str
    asked: float
    value: float
    within: float
    trials: tuple[Point, ...]
    made: tuple[Point, ...]
    moved: tuple[Point, ...]

    @property
    def error(self) -> float:
        """Return value / asked - 1."""
        return self.value / self.asked - 1

    @property
    def met(self) -> bool:
        """Return whether the error is within what was allowed."""
        return abs(self.error) <= self.within

    def __str__(self) -> str:
        """Return the match in a line."""
        unit = _unit(self.image.unit, PROPERTIES[self.name.partition(":")[0]].power)
        verdict = "" if self.met else f", NOT within {self.within:.3g}"
        return (
            f"{self.name} {self.value:.4g}{unit} at porosity {self.porosity:.4g}: "
            f"{self.error:+.1%} off {self.asked:.4g}{verdict}"
        )


def match_property(
    model: Model,
    shape: Request | int | Sequence[int],
    asked: Mapping[str, float],
    *,
    seed: int | None = None,
    within: float = 0.02,
    memory: int | None = None,
    periodic: bool | Sequence[bool] = False,
) -> PropertyMatch:
    """Make material that has a property: permeability, stiffness, ...

    The porosity is what is changed; it stays where the exemplar's own places are (windows of a
    quarter of its sides).

    Parameters
    ----------
    model : Model
        Of a method that honours a target porosity, with two phases.
    shape : int, sequence of int, or Request
        Of the result, in memory as a whole. A Request with shape, seed and periodic alone.
    asked : mapping
        One name with the value to have, in the image's unit of length, as `measure_property`
        measures it: {"permeability": 2e-6}, {"stiffness:z": 0.05}.
    seed : int
        As of `Model.generate`. All trials and results have it.
    within : float
        Relative error that ends the search, .001 .. .5. It takes 3 results at most; then the
        surface of the nearest is moved, by .03 of porosity and 5 times at most.
    memory : int, optional
        Budget in bytes of every result. Default: the memory that is available.
    periodic
        As of `Request`.

    Returns
    -------
    match : PropertyMatch
        The nearest result; `met` says whether it is within.

    Raises
    ------
    UnknownNameError
        No such property or axis.
    RequestError
        The method takes no target porosity; a mask, fixed voxels or a target beside the property;
        a value outside of what the trials show that the material can have, which the
        message names.
    InputError
        Several properties, or a value that is none.

    Examples
    --------
    >>> model = tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 48))
    ... # doctest: +SKIP
    >>> tb.match_property(model, 96, {"stiffness:z": 0.05}).met  # doctest: +SKIP
    True
    """
    name, wanted = as_property(asked)
    limit = float(as_number(within, name="within", low=1e-3, high=0.5))
    request = _plain_request(shape, seed, periodic)
    _check_model(model, request)
    small = replace(request, shape=tuple(min(side, _SIDE) for side in request.shape))
    trials = _map(model, small, name, memory)
    start = _first(trials, name, wanted, model)
    goal = _Goal(name, wanted, limit, tuple(trials))

    def make(porosity: float) -> Image:
        return model.generate(replace(request, target={"porosity": porosity}), memory=memory)

    results = _approach(goal, make, None, start=start, most=MOST, scatter=_JUMP)
    first = nearest = min(results, key=goal.off)
    moves: list[_Result] = []
    if goal.off(first) > limit:

        def move(porosity: float) -> Image | None:
            try:
                return offset(first.image, fraction=1 - porosity, periodic=request.periodic)
            except InputError:  # beyond what a surface of its topology can reach
                return None

        start = _next(goal, [(first.porosity, first.value)], scatter=0)
        moves = _approach(goal, move, first, start=start, most=MOVES, scatter=0)
        nearest = min([first, *moves], key=goal.off)
    match = PropertyMatch(
        image=nearest.image,
        request=replace(request, target={"porosity": first.porosity}),
        porosity=nearest.porosity,
        name=name,
        asked=wanted,
        value=nearest.value,
        within=limit,
        trials=goal.trials,
        made=tuple((one.porosity, one.value) for one in results),
        moved=tuple((one.porosity, one.value) for one in moves),
    )
    return replace(match, image=_with_report(match))


@dataclass(frozen=True, eq=False)
class _Result:
    """An image with its porosity and its property."""

    porosity: float
    value: float
    image: Image


@dataclass(frozen=True)
class _Goal:
    """A property that is asked for, and what small trials have."""

    name: str
    asked: float
    within: float
    trials: tuple[Point, ...]

    def off(self, result: _Result) -> float:
        """Return how far a result is off, over the value that it is to have."""
        return abs(result.value / self.asked - 1)


def _approach(
    goal: _Goal,
    make: Callable[[float], Image | None],
    of: _Result | None,
    *,
    start: float,
    most: int,
    scatter: float,
) -> list[_Result]:
    """Make results until one is near enough: after the first at porosities that those before
    name.

    Parameters
    ----------
    goal : _Goal
    make : callable
        Porosity -> image, or None where there is none.
    of : _Result, optional
        What others are made of: they stay within .03 of its porosity.
    start : float
        The first porosity.
    most : int
    scatter : float
        Results whose porosities are nearer differ by chance.
    """
    found: list[_Result] = []
    points = [] if of is None else [(of.porosity, of.value)]
    porosity = start
    while len(found) < most:
        if of is not None:
            porosity = min(of.porosity + _FARTHEST, max(of.porosity - _FARTHEST, porosity))
        porosity = round(porosity, _DIGITS)
        image = make(porosity) if _is_new(porosity, points) else None
        if image is None:
            break
        value = measure_property(image, goal.name)
        found.append(_Result(porosity, value, image))
        points.append((porosity, value))
        notify(f"{goal.name} {value:.4g} at porosity {porosity:.4f}, {goal.asked:.4g} asked")
        if goal.off(found[-1]) <= goal.within:
            break
        porosity = _next(goal, points, scatter=scatter)
    return found


def as_property(given: Mapping[str, float]) -> tuple[str, float]:
    """Return the name and value of the one property that is asked for.

    Raises
    ------
    UnknownNameError, InputError
        As `match_property`.
    """
    if not isinstance(given, Mapping):
        raise InputError(
            f"the property asked for is {quote(given)}: give a name with its value, such as "
            "{'permeability': 2e-6}"
        )
    if len(given) != 1:
        raise InputError(
            f"{', '.join(map(str, given)) or 'no property'}: porosity alone is changed, so that "
            "one property can be met; give one"
        )
    ((name, value),) = given.items()
    word, colon, axis = str(name).partition(":")
    check_name(word, PROPERTIES, name="property")
    if colon and PROPERTIES[word].along is None:
        raise InputError(f"{word} has no direction: leave :{axis} out")
    if colon:
        check_name(axis, ("z", "y", "x"), name="axis")
    number = float(as_number(value, name=name, low=0, high=math.inf))
    if not number > 0:
        raise InputError(f"{name} is {number:g}: ask for more than 0")
    return name, number


def _plain_request(
    shape: Request | int | Sequence[int], seed: int | None, periodic: bool | Sequence[bool]
) -> Request:
    parts = {} if isinstance(shape, Request) else {"periodic": periodic}
    request = as_request(shape, seed, parts)
    beside = sorted(request.asks_for() - {"periodic"})
    if beside:
        raise RequestError(
            f"a property beside {', '.join(beside)}: it goes with shape, seed and periodic alone"
        )
    if len(request.shape) != 3:
        raise RequestError(
            f"a property is one of a volume, the request is for {request.shape}: give three numbers"
        )
    return request


def _check_model(model: Model, request: Request) -> None:
    known = model.capabilities
    if "target" not in known.honours or "porosity" not in known.targets:
        raise RequestError(
            f"method {known.name!r} takes no target porosity, by which a property is met: choose "
            "texture, quilt or lattice"
        )
    first = model.facts[0]
    if first.kind != "labels" or len(first.phases) != 2 or "void" not in first.phases:
        raise RequestError(
            f"a property is met for two phases of which one is void, the model's are {first.kind} "
            f"of {', '.join(first.phases) or 'no phases'}: segment the exemplar, or name its "
            "phases (--phases)"
        )
    model.plan(request)


def _map(model: Model, request: Request, name: str, memory: int | None) -> list[Point]:
    """Return small trials over the porosities that the model can make, by porosity."""
    least, most = model.porosities() or _WIDEST
    low, high = max(_WIDEST[0], least), min(_WIDEST[1], most)
    found = []
    for porosity in track(np.linspace(low, high, _TRIALS).tolist(), f"trials of {name}"):
        trial = replace(request, target={"porosity": round(porosity, _DIGITS)})
        try:
            image = model.generate(trial, memory=memory)
        except RequestError:  # a porosity that this method cannot make
            continue
        found.append((porosity, measure_property(image, name)))
    return found


def _first(trials: Sequence[Point], name: str, asked: float, model: Model) -> float:
    """Return the porosity that the trials name."""
    first = model.facts[0]
    usual = first.shares[first.phases.index("void")] if first.shares else 0.5
    porosity = _crossing(trials, asked, near=usual)
    if porosity is not None:
        return porosity
    values = [value for _, value in trials if value > 0]
    if not values:
        raise RequestError(
            f"{name} is 0 in all trials, whose porosities are {_listed(trials)}: nothing spans "
            "them; ask for another property"
        )
    unit = _unit(first.unit, PROPERTIES[name.partition(":")[0]].power)
    raise RequestError(
        f"{name} {asked:.4g}{unit} is outside what this material can have: trials with porosities "
        f"{_listed(trials)} have {min(values):.4g} .. {max(values):.4g}{unit}; ask for one in "
        "between, or give an exemplar that is denser or sparser"
    )


def _next(goal: _Goal, made: Sequence[Point], *, scatter: float) -> float:
    """Return the porosity of the next result, where those nearer than `scatter` differ by
    chance.
    """
    trials, asked = goal.trials, goal.asked
    done = sorted(made)
    apart = [done[0], *(one for before, one in pairwise(done) if one[0] - before[0] > scatter)]
    bracket = _crossing(apart, asked, near=made[-1][0])
    if bracket is not None and _is_new(bracket, made):
        return bracket
    nearest = sorted(made, key=lambda one: abs(one[1] - asked))
    porosity, value = nearest[0]
    # the map at the level of what was measured; results scatter, so that one that is denser may
    # have more: the next nearest says where to go on from there
    known = np.array([one for one in trials if one[1] > 0])
    for there, measured in nearest:
        if measured <= 0 or len(known) < 2:
            continue
        here = float(np.exp(np.interp(there, known[:, 0], np.log(known[:, 1]))))
        moved = [(one, other * measured / here) for one, other in known.tolist()]
        found = _crossing(moved, asked, near=there)
        if found is not None and _is_new(found, made):
            return found
    low, high = trials[0][0], trials[-1][0]
    rises = trials[-1][1] > trials[0][1]
    step = _STEP if (value < asked) == rises else -_STEP
    return min(high, max(low, porosity + step))


def _is_new(porosity: float, made: Sequence[Point]) -> bool:
    """Return whether a porosity is none that was made."""
    return all(abs(porosity - done) >= _NEAR for done, _ in made)


def _crossing(points: Sequence[Point], asked: float, *, near: float) -> float | None:
    """Return the porosity, nearest to `near`, where the logarithm of the property passes that of
    `asked`, linear between points; None where it does not.
    """
    found = []
    for (low, first), (high, last) in pairwise(points):
        if first <= 0 or last <= 0 or not min(first, last) <= asked <= max(first, last):
            continue
        share = 0.5 if first == last else math.log(asked / first) / math.log(last / first)
        found.append(low + share * (high - low))
    return min(found, key=lambda one: abs(one - near), default=None)


def _with_report(match: PropertyMatch) -> Image:
    """Return the image, its recipe's report with the search."""
    steps = match.image.recipe.to_json()
    steps[-1]["report"] = {
        **steps[-1].get("report", {}),
        "property": {
            "name": match.name,
            "asked": match.asked,
            "value": match.value,
            "within": match.within,
            "trials": [list(one) for one in match.trials],
            "made": [list(one) for one in match.made],
            "moved": [list(one) for one in match.moved],
        },
    }
    return replace(match.image, recipe=Recipe.from_json(steps))


def _listed(trials: Sequence[Point]) -> str:
    return f"{trials[0][0]:.3g} .. {trials[-1][0]:.3g}" if trials else "none"


def _unit(unit: str, power: int) -> str:
    return f" {unit}^{power}" if power not in (0, 1) else f" {unit}" if power else ""

"""Supports and loads of a part as data: places in shares of the sides, so that a case fits any
number of elements.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.fields.topology.places import (
    ALL,
    EVERYWHERE,
    Box,
    PartNodes,
    Place,
    read_place,
    write_place,
)
from trabecula.io.guard import check_there, report_damage


@dataclass(frozen=True)
class Support:
    """Nodes that do not move along the given axes."""

    box: Box = EVERYWHERE
    axes: str = "zyx"
    place: Place = ALL
    """Which of the box's nodes."""


@dataclass(frozen=True)
class Load:
    """A force, shared evenly among the nodes of a place."""

    box: Box
    force: tuple[float, float, float]
    """Along z, y, x; only its direction and its ratio to other loads matter."""
    place: Place = ALL
    """Which of the box's nodes."""


@dataclass(frozen=True)
class LoadSet:
    """Loads that act together, at another time than other cases'."""

    loads: tuple[Load, ...]
    weight: float = 1.0
    """Of its compliance in the sum that is made small."""


@dataclass(frozen=True)
class FixedRegion:
    """Elements that the design does not decide."""

    box: Box = EVERYWHERE
    place: Place = ALL
    depth: int = 1
    """Elements below a surface that `place` picks."""


@dataclass(frozen=True)
class Case:
    """Supports and loads of a part, and the proportions it is meant for.

    Parameters
    ----------
    name, summary : str
    shape : three ints
        Elements along z, y, x of the coarsest grid that shows it.
    supports : tuple of Support
    loads : tuple of Load
        Acting together.
    load_cases : tuple of LoadSet
        Further loads, each acting alone: the sum of the compliances is made small.
    solid, keep_out : tuple of FixedRegion
        Elements that are as dense as the bounds allow, and elements that are left out.
    volume, low, high, penalty : float
        Mean, bounds and exponent of the density that the case is usually run with.
    """

    name: str
    summary: str
    shape: tuple[int, int, int]
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    volume: float = 0.5
    low: float = 0.3
    high: float = 0.85
    penalty: float = 1.0
    load_cases: tuple[LoadSet, ...] = ()
    solid: tuple[FixedRegion, ...] = ()
    keep_out: tuple[FixedRegion, ...] = ()

    @property
    def alone(self) -> tuple[LoadSet, ...]:
        """Return all loads as cases that act alone, each with its weight."""
        first = (LoadSet(self.loads),) if self.loads or not self.load_cases else ()
        return first + self.load_cases


_ALL = (0.0, 1.0)
_FIRST, _LAST, _MIDDLE = (0.0, 0.0), (1.0, 1.0), (0.5, 0.5)

CASES = {
    "cantilever": Case(
        name="cantilever",
        summary="held at the upper and lower edges of one end, pulled down at the lower edge of "
        "the other (Liu 2016, figure 7)",
        shape=(16, 8, 30),
        supports=(Support((_FIRST, _ALL, _FIRST)), Support((_LAST, _ALL, _FIRST))),
        loads=(Load((_FIRST, _ALL, _LAST), (-1.0, 0.0, 0.0)),),
    ),
    "wheel": Case(
        name="wheel",
        summary="held at the four lower corners, pulled down in the middle of the lower face "
        "(Liu 2016, figure 9)",
        shape=(20, 40, 40),
        supports=tuple(Support((_FIRST, y, x)) for y in (_FIRST, _LAST) for x in (_FIRST, _LAST)),
        loads=(Load((_FIRST, _MIDDLE, _MIDDLE), (-1.0, 0.0, 0.0)),),
    ),
}
"""The two cases of the paper; z is up, and its index 0 is the bottom."""


def case(source: str | Path | Mapping[str, Any] | Case) -> Case:
    """Return a case by its name, or from a JSON file or a mapping with the fields of `Case`.

    Raises
    ------
    UnknownNameError
        No case and no file of that name, or an unknown field.
    FileError
        A file that is no JSON.
    InputError
        Fields that are none of a case's.

    Examples
    --------
    >>> case("cantilever").shape
    (16, 8, 30)
    """
    if isinstance(source, Case):
        return source
    if isinstance(source, Mapping):
        return _from_mapping(source)
    if not isinstance(source, str | Path):
        raise InputError(
            f"a case is a name, a .json file or a mapping, got {type(source).__name__}"
        )
    path = Path(source)
    if path.suffix != ".json":
        check_name(str(source), CASES, name="case (or a .json file)")
        return CASES[str(source)]
    check_there(path)
    with report_damage(path, "a case"):
        plain = json.loads(path.read_text(encoding="utf-8"))
    return _from_mapping(plain)


def to_json(given: Case) -> dict[str, Any]:
    """Return the fields of a case as plain JSON, which `case` reads back."""
    plain = dict(vars(given))
    plain["supports"] = [
        {"box": one.box, "axes": one.axes, **write_place(one.place)} for one in given.supports
    ]
    plain["loads"] = _plain_loads(given.loads)
    plain["load_cases"] = [
        {"loads": _plain_loads(one.loads), "weight": one.weight} for one in given.load_cases
    ]
    for name in ("solid", "keep_out"):
        plain[name] = [
            {"box": one.box, "depth": one.depth, **write_place(one.place)}
            for one in getattr(given, name)
        ]
    for name in ("load_cases", "solid", "keep_out"):
        if not plain[name]:
            del plain[name]
    return dict(json.loads(json.dumps(plain)))


def _plain_loads(loads: Sequence[Load]) -> list[dict[str, Any]]:
    return [{"box": one.box, "force": one.force, **write_place(one.place)} for one in loads]


def _from_mapping(given: Any) -> Case:
    loads = isinstance(given, Mapping) and ("loads" in given or "load_cases" in given)
    if not loads or not {"shape", "supports"} <= set(given):
        raise InputError("a case needs shape, supports and loads: see the how-to of target fields")
    for name in given:
        check_name(str(name), Case.__dataclass_fields__, name="field of a case")
    try:
        supports = tuple(
            Support(_box_of(s), str(s.get("axes", "zyx")), read_place(s)) for s in given["supports"]
        )
        load_cases = tuple(
            LoadSet(_loads_of(one["loads"]), _weight(one.get("weight", 1.0)))
            for one in given.get("load_cases", ())
        )
        z, y, x = (int(side) for side in given["shape"])
        rest = {
            name: float(given[name])
            for name in ("volume", "low", "high", "penalty")
            if name in given
        }
        found = Case(
            str(given.get("name", "case")),
            str(given.get("summary", "")),
            (z, y, x),
            supports,
            _loads_of(given.get("loads", ())),
            **rest,
            load_cases=load_cases,
            solid=_regions_of(given.get("solid", ())),
            keep_out=_regions_of(given.get("keep_out", ())),
        )
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(
            f"the case cannot be read ({type(error).__name__}: {error}): "
            "a support has box and axes, a load box and force"
        ) from None
    if any(set(support.axes) - set("zyx") or not support.axes for support in supports):
        raise InputError(
            f"axes of a support are letters of zyx: got {[support.axes for support in supports]}"
        )
    return found


def _loads_of(given: Any) -> tuple[Load, ...]:
    return tuple(Load(_box_of(one), _three(one["force"]), read_place(one)) for one in given)


def _regions_of(given: Any) -> tuple[FixedRegion, ...]:
    found = tuple(
        FixedRegion(_box_of(one), read_place(one), int(one.get("depth", 1))) for one in given
    )
    if any(one.depth < 1 for one in found):
        raise ValueError("the depth of a region is at least 1")
    return found


def _weight(given: Any) -> float:
    if not 0 < float(given) < 1e6:
        raise ValueError(f"a weight is above 0, got {given}")
    return float(given)


def _box_of(given: Mapping[str, Any]) -> Box:
    """Return the box of a support, load or region; one that names another place needs none."""
    if "box" not in given and read_place(given) != ALL:
        return EVERYWHERE
    box = tuple((float(low), float(high)) for low, high in given["box"])
    if len(box) != 3 or not all(0 <= low <= high <= 1 for low, high in box):
        raise ValueError(f"a box is three pairs of shares 0 .. 1, got {given['box']}")
    return box


def _three(given: Sequence[float]) -> tuple[float, float, float]:
    z, y, x = (float(part) for part in given)
    return z, y, x


def part_nodes(
    of: Case,
    inside: np.ndarray,
    spacing: Sequence[float],
    marks: Mapping[str, np.ndarray] | None = None,
) -> PartNodes:
    """Return the nodes of a part without the elements that a case keeps out; the shortest edge of
    an element is the unit of length.

    Raises
    ------
    InputError
        Nothing is left.
    """
    part = PartNodes(inside, marks, [edge / min(spacing) for edge in spacing])
    for region in of.keep_out:
        inside = part.inside & ~part.elements(region.box, region.place, region.depth)
        part = PartNodes(inside, part.marks, part.edges, part.form)
    if not part.inside.any():
        raise InputError(f"case {of.name!r} keeps out the whole part: leave some of it")
    return part

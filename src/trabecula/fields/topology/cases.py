"""Supports and loads of a part as data: boxes in shares of the sides, so that a case fits any
number of voxels.
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
from trabecula.io.guard import check_there, report_damage

Box = tuple[tuple[float, float], ...]
"""From and to along z, y, x, in shares of the sides 0 .. 1; a face, edge or corner where both are
equal.
"""


@dataclass(frozen=True)
class Support:
    """Nodes that do not move along the given axes."""

    box: Box
    axes: str = "zyx"


@dataclass(frozen=True)
class Load:
    """A force, shared evenly among the nodes of a box."""

    box: Box
    force: tuple[float, float, float]
    """Along z, y, x; only its direction and its ratio to other loads matter."""


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
    plain["supports"] = [{"box": support.box, "axes": support.axes} for support in given.supports]
    plain["loads"] = [{"box": load.box, "force": load.force} for load in given.loads]
    return dict(json.loads(json.dumps(plain)))


def _from_mapping(given: Any) -> Case:
    if not isinstance(given, Mapping) or not {"shape", "supports", "loads"} <= set(given):
        raise InputError("a case needs shape, supports and loads: see the how-to of target fields")
    for name in given:
        check_name(str(name), Case.__dataclass_fields__, name="field of a case")
    try:
        supports = tuple(
            Support(_as_box(s["box"]), str(s.get("axes", "zyx"))) for s in given["supports"]
        )
        loads = tuple(Load(_as_box(load["box"]), _three(load["force"])) for load in given["loads"])
        z, y, x = (int(side) for side in given["shape"])
        rest = {
            name: float(given[name])
            for name in ("volume", "low", "high", "penalty")
            if name in given
        }
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(
            f"the case cannot be read ({type(error).__name__}: {error}): "
            "a support has box and axes, a load box and force"
        ) from None
    if any(set(support.axes) - set("zyx") or not support.axes for support in supports):
        raise InputError(
            f"axes of a support are letters of zyx: got {[support.axes for support in supports]}"
        )
    return Case(
        str(given.get("name", "case")),
        str(given.get("summary", "")),
        (z, y, x),
        supports,
        loads,
        **rest,
    )


def _as_box(given: Sequence[Sequence[float]]) -> Box:
    box = tuple((float(low), float(high)) for low, high in given)
    if len(box) != 3 or not all(0 <= low <= high <= 1 for low, high in box):
        raise ValueError(f"a box is three pairs of shares 0 .. 1, got {given}")
    return box


def _three(given: Sequence[float]) -> tuple[float, float, float]:
    z, y, x = (float(part) for part in given)
    return z, y, x


def nodes_of(box: Box, shape: tuple[int, ...]) -> np.ndarray:
    """Return the nodes of a grid of elements in a box, the nearest ones at least, (Z + 1, Y + 1,
    X + 1) bool.
    """
    picked = []
    for (low, high), side in zip(box, shape, strict=True):
        node = np.arange(side + 1)
        first, last = int(np.ceil(low * side - 1e-9)), int(np.floor(high * side + 1e-9))
        if first > last:  # between two nodes
            first = last = round((low + high) / 2 * side)
        picked.append((node >= first) & (node <= last))
    return picked[0][:, None, None] & picked[1][None, :, None] & picked[2][None, None, :]

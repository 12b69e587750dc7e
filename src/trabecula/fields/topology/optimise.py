"""Least compliance for a given volume by optimality criteria (SIMP).

The stiffness of an element is density^penalty (Bendsoe 1989, doi:10.1007/BF01650949; update and
filter as in Liu and Tovar 2014, doi:10.1007/s00158-014-1107-x). With penalty 1 the problem is
convex: a graded material, and one best answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_shape, as_spacing
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import part, report, whole_run
from trabecula.core.recipe import digest
from trabecula.engine.memory import Plan, check_budget
from trabecula.fields.grid import as_field, as_marks, part_region
from trabecula.fields.topology.cases import Case, case, part_nodes, to_json
from trabecula.fields.topology.displacements import solve_displacements
from trabecula.fields.topology.elements import ElementGrid

_MOVE = 0.2  # the most that a density changes in a round
_BALANCE, _STEPS = 1e-4, 1000  # residual of the displacements, and their steps at most
_MANY = 100_000  # elements from which a coarser design is the start
_COARSER = 0.125  # of the time, for it
ELEMENT_BYTES = 500  # of an element: a dozen fields at nodes of three components, and the densities


def simp(
    of: str | Path | Mapping[str, Any] | Case,
    shape: int | Sequence[int] | None = None,
    *,
    volume: float | None = None,
    low: float | None = None,
    high: float | None = None,
    penalty: float | None = None,
    radius: float = 1.5,
    mask: Image | ArrayLike | None = None,
    marks: Mapping[str, ArrayLike] | None = None,
    poisson: float = 0.3,
    rounds: int = 80,
    tolerance: float = 1e-4,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
    memory: int | None = None,
) -> Image:
    """Optimise the density of a part for the greatest stiffness under its loads.

    Parameters
    ----------
    of : str, path, mapping or Case
        "cantilever", "wheel", a JSON file, or a case: supports and loads.
    shape : int or three ints, optional
        Elements along z (up), y, x. Default: the case's. Some thousands are enough: `resample`
        brings them to voxels.
    volume : float, optional
        Mean density. Default: the case's (the paper's .5).
    low, high : float, optional
        Bounds of the density, 0.001 .. 1. Default: the case's (the paper's .3 and .85).
    penalty : float, optional
        Exponent from density to stiffness, 1 .. 5. Default: the case's (the paper's 1).
    radius : float
        Of the density filter in elements; up to 1: none.
    mask : (Z, Y, X) bool array or Image of labels, optional
        Elements of the part, of an Image all but the phase "void"; elsewhere, as where the case
        keeps out, the density is `low` in the result and there is nothing in the mechanics.
    marks : mapping of str to (Z, Y, X) bool array, optional
        Elements that painted meshes go through, by the names that the case gives them.
    poisson : float
        Ratio of the solid, -0.9 .. 0.45.
    rounds : int
        At most.
    tolerance : float
        The rounds end when the compliance changes by less than this share.
    spacing, unit
        Of the elements.
    memory : int, optional
        Budget in bytes. Default: what the machine has available.

    Returns
    -------
    field : Image
        Grey, float32. Its recipe's step holds a `report`: `compliance` of every round (of the
        uniform density first).

    Raises
    ------
    InputError
        Bounds that do not hold the volume, loads that nothing holds, places that meet no element, a
        mask of another shape, a painted mesh that was not given.
    UnknownNameError
        No such case.
    MemoryBudgetError
        More elements than the memory has room for.

    Examples
    --------
    >>> field = simp("cantilever", (8, 4, 15))
    >>> field.values.mean().round(2), bool(field.values[4, 2, -1] < field.values[0, 2, 0])
    (np.float32(0.5), True)
    """
    chosen = case(of)
    sides = as_shape(chosen.shape if shape is None else shape)
    check_budget(
        Plan({"elements": ELEMENT_BYTES * int(np.prod(sides))}),
        budget=memory,
        advice="ask for fewer elements",
    )
    given = {"volume": volume, "low": low, "high": high, "penalty": penalty}
    asked = {
        name: getattr(chosen, name) if value is None else value for name, value in given.items()
    }
    settings: dict[str, Any] = {
        "radius": radius,
        "poisson": poisson,
        "rounds": rounds,
        "tolerance": tolerance,
        **asked,
    }
    settings = _check_settings(settings)
    edges = as_spacing(spacing, ndim=3)
    whole = part_region(mask, sides)
    painted = as_marks(marks, sides)
    with whole_run("optimising"):
        density, compliance = _optimise(Design(chosen, whole, painted, edges, settings))
    field = np.where(density > 0, density, settings["low"])
    parameters = {"of": to_json(chosen), "shape": sides, **settings, "spacing": edges, "unit": unit}
    if mask is not None:
        made = mask.recipe.to_json() if isinstance(mask, Image) else []
        parameters["mask"] = made or digest(whole.view(np.uint8))
    if painted:
        parameters["marks"] = {name: digest(one.view(np.uint8)) for name, one in painted.items()}
    return as_field(
        field, "simp", parameters, spacing=edges, unit=unit, report={"compliance": compliance}
    )


def _check_settings(given: dict[str, Any]) -> dict[str, Any]:
    ranges = {
        "volume": (1e-3, 1.0),
        "low": (1e-3, 1.0),
        "high": (1e-3, 1.0),
        "penalty": (1.0, 5.0),
        "radius": (0.0, 50.0),
        "poisson": (-0.9, 0.45),
        "tolerance": (1e-8, 0.5),
        "rounds": (1, 10_000),
    }
    found = {
        name: as_number(given[name], name=name, low=low, high=high, whole=name == "rounds")
        for name, (low, high) in ranges.items()
    }
    if not found["low"] <= found["volume"] <= found["high"]:
        raise InputError(
            f"volume {found['volume']:g} is outside the bounds {found['low']:g} .. "
            f"{found['high']:g}: "
            "no density between them has that mean"
        )
    return found


@dataclass(frozen=True, eq=False)
class Design:
    """What is optimised: a case on a part, with the settings of `simp`."""

    case: Case
    part: np.ndarray
    """(Z, Y, X) bool."""
    marks: Mapping[str, np.ndarray]
    edges: tuple[float, ...]
    settings: Mapping[str, Any]

    def halved(self) -> Design:
        """Return the design on elements of twice the edge, where any of eight is inside."""
        marks = {name: _halve(one) for name, one in self.marks.items()}
        return replace(self, part=_halve(self.part), marks=marks)


def _halve(inside: np.ndarray) -> np.ndarray:
    padded = np.pad(inside, [(0, side % 2) for side in inside.shape])
    z, y, x = (side // 2 for side in padded.shape)
    return np.asarray(padded.reshape(z, 2, y, 2, x, 2).any(axis=(1, 3, 5)))


def _optimise(design: Design) -> tuple[np.ndarray, list[float]]:
    """Return the densities (0 outside the part), and the compliance of every round."""
    settings = design.settings
    nodes = part_nodes(design.case, design.part, design.edges, design.marks)
    inside = nodes.inside
    solid = np.zeros(inside.shape, bool)
    for region in design.case.solid:
        solid |= nodes.elements(region.box, region.place, region.depth)
    _check_solid(solid, inside, settings)
    grid = ElementGrid.of(design.case, nodes, edges=nodes.edges, poisson=settings["poisson"])
    grids = grid.loaded(design.case, nodes)
    bounds = Bounds(inside, solid, settings["low"], settings["high"], settings["volume"])
    if np.count_nonzero(inside) <= _MANY or min(inside.shape) < 8:
        return _iterate(grids, _uniform(bounds), bounds, settings)
    with part(0.0, _COARSER):
        start = _from_coarser(design, bounds)
    with part(_COARSER, 1.0):
        return _iterate(grids, start, bounds, settings)


def _iterate(
    grids: list[tuple[float, ElementGrid]],
    start: np.ndarray,
    bounds: Bounds,
    settings: Mapping[str, Any],
) -> tuple[np.ndarray, list[float]]:
    """Update the densities until the compliance hardly changes."""
    inside, penalty = bounds.inside, settings["penalty"]
    smooth = DensityFilter(inside, settings["radius"])
    density, u = start, [np.zeros_like(grid.load) for _, grid in grids]
    label = f"optimising {' x '.join(map(str, inside.shape))} elements"
    compliance: list[float] = []
    done = 0.0
    for count in range(settings["rounds"]):
        report(label, done)
        stiff = _power(density, penalty)
        energy = np.zeros(inside.shape)
        for n, (weight, loaded) in enumerate(grids):
            u[n] = solve_displacements(loaded, stiff, u[n], tolerance=_BALANCE, most=_STEPS)
            energy += weight * loaded.energy(u[n])
        compliance.append(float((stiff * energy).sum()))
        if count:
            change = abs(compliance[-2] - compliance[-1]) / compliance[-2]
            if change < settings["tolerance"]:
                break
            # The change falls by about the same share in every round.
            near = np.log(min(change, 1.0)) / np.log(settings["tolerance"])
            done = max(done, float(near), (count + 1) / settings["rounds"])
        slope = penalty * _power(density, penalty - 1) * energy
        start, density = _update(start, smooth.back(slope), smooth, bounds)
    report(label, 1.0)
    return density, compliance


def _uniform(bounds: Bounds) -> np.ndarray:
    return np.where(bounds.inside, bounds.volume, 0.0)


def _from_coarser(design: Design, bounds: Bounds) -> np.ndarray:
    """Return the densities of a design on half as many elements along every axis."""
    inside = bounds.inside
    fine, _ = _optimise(design.halved())
    for axis, side in enumerate(inside.shape):
        fine = np.repeat(fine, 2, axis=axis).take(range(side), axis=axis)
    return np.where(inside & (fine > 0), fine, _uniform(bounds))


def _check_solid(solid: np.ndarray, inside: np.ndarray, settings: Mapping[str, Any]) -> None:
    """Raise where solid regions leave no density between the bounds for the rest."""
    share = np.count_nonzero(solid) / np.count_nonzero(inside)
    least = share * settings["high"] + (1 - share) * settings["low"]
    if settings["volume"] < least:
        raise InputError(
            f"solid regions take {share:.3g} of the part: with them the mean density is at least "
            f"{least:.3g}, volume is {settings['volume']:g}; ask for more, or for smaller regions"
        )


def _power(density: np.ndarray, exponent: float) -> np.ndarray:
    """Return a power; whole ones as products, which have the same last bit on every machine."""
    if exponent != int(exponent):
        return np.asarray(density**exponent)
    found = np.ones_like(density)
    for _ in range(int(exponent)):
        found = found * density
    return found


@dataclass(frozen=True, eq=False)
class Bounds:
    """Where densities may lie: between bounds, at the upper one in solid regions, with a mean."""

    inside: np.ndarray
    solid: np.ndarray
    low: float
    high: float
    volume: float


def _update(
    design: np.ndarray, gain: np.ndarray, smooth: DensityFilter, bounds: Bounds
) -> tuple[np.ndarray, np.ndarray]:
    """Take one step by optimality criteria: design and filtered density, whose mean is the
    volume.
    """
    inside = bounds.inside
    least = np.maximum(bounds.low, design - _MOVE)
    most = np.minimum(bounds.high, design + _MOVE)
    share = np.where(inside, gain / np.where(inside, smooth.back(inside.astype(float)), 1), 0)
    below, above = 0.0, float(share.max()) * 1e6 + 1e-300
    wanted = bounds.volume * np.count_nonzero(inside)
    for _ in range(200):
        price = (below + above) / 2 if below == 0 or above / below < 4 else np.sqrt(below * above)
        step = np.where(inside, np.clip(design * np.sqrt(share / price), least, most), 0)
        density = smooth(step)
        density[bounds.solid] = bounds.high
        held = density.sum()
        if abs(held - wanted) < 1e-7 * wanted or above - below < 1e-14 * above:
            break
        below, above = (price, above) if held > wanted else (below, price)
    return step, density


class DensityFilter:
    """Densities averaged with linearly falling weights over the elements of the part within a
    radius.
    """

    def __init__(self, inside: np.ndarray, radius: float) -> None:
        self.inside = inside
        reach = int(np.ceil(radius)) - 1 if radius > 1 else 0
        offsets = product(range(-reach, reach + 1), repeat=3)
        weighed = (
            [(o, radius - float(np.sqrt(sum(k * k for k in o)))) for o in offsets]
            if reach
            else [((0, 0, 0), 1.0)]
        )
        self.weights = [(offset, weight) for offset, weight in weighed if weight > 0]
        self.reach = reach
        self.total = np.where(inside, self._sum(inside.astype(float)), 1.0)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the average; 0 outside the part."""
        return np.where(self.inside, self._sum(values) / self.total, 0.0)

    def back(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose: turn slopes by the average into slopes by the values (weights are
        symmetric)."""
        return np.where(self.inside, self._sum(values / self.total), 0.0)

    def _sum(self, values: np.ndarray) -> np.ndarray:
        padded = np.pad(values, self.reach)
        total = np.zeros_like(values)
        for offset, weight in self.weights:
            at = tuple(
                slice(self.reach + o, self.reach + o + side)
                for o, side in zip(offset, values.shape, strict=True)
            )
            total += weight * padded[at]
        return total

"""Least compliance for a given volume by optimality criteria (SIMP).

The stiffness of an element is density^penalty (Bendsoe 1989, doi:10.1007/BF01650949; update and
filter as in Liu and Tovar 2014, doi:10.1007/s00158-014-1107-x). With penalty 1 the problem is
convex: a graded material, and one best answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_shape, as_spacing
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.recipe import digest
from trabecula.engine.memory import Plan, check_budget
from trabecula.fields.grid import as_field, as_region
from trabecula.fields.topology.cases import Case, case, to_json
from trabecula.fields.topology.displacements import solve_displacements
from trabecula.fields.topology.elements import ElementGrid

_MOVE = 0.2  # the most that a density changes in a round
_BALANCE, _STEPS = 1e-4, 1000  # residual of the displacements, and their steps at most
_BYTES = 500  # of an element: a dozen fields at nodes of three components, and the densities


def simp(
    of: str | Path | Mapping[str, Any] | Case,
    shape: int | Sequence[int] | None = None,
    *,
    volume: float | None = None,
    low: float | None = None,
    high: float | None = None,
    penalty: float | None = None,
    radius: float = 1.5,
    mask: ArrayLike | None = None,
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
    mask : (Z, Y, X) bool array, optional
        Elements of the part; elsewhere the density is `low` in the result and there is nothing in
        the mechanics.
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
        Bounds that do not hold the volume, loads that nothing holds, a mask of another shape.
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
        Plan({"elements": _BYTES * int(np.prod(sides))}),
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
    inside = np.ones(sides, bool) if mask is None else as_region(mask, sides, name="the mask")
    unit_edges = tuple(edge / min(edges) for edge in edges)
    grid = ElementGrid.of(chosen, inside, edges=unit_edges, poisson=settings["poisson"])
    density, compliance = _optimise(grid, settings)
    field = np.where(inside, density, settings["low"])
    parameters = {"of": to_json(chosen), "shape": sides, **settings, "spacing": edges, "unit": unit}
    if mask is not None:
        parameters["mask"] = digest(inside.view(np.uint8))
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


def _optimise(grid: ElementGrid, settings: dict[str, Any]) -> tuple[np.ndarray, list[float]]:
    """Return the densities (0 outside the part), and the compliance of every round."""
    inside, penalty = grid.inside, settings["penalty"]
    smooth = DensityFilter(inside, settings["radius"])
    design = np.where(inside, settings["volume"], 0.0)
    density, u = design, np.zeros_like(grid.load)
    compliance: list[float] = []
    for _ in track(range(settings["rounds"]), "optimising", total=settings["rounds"]):
        stiff = _power(density, penalty)
        u = solve_displacements(grid, stiff, u, tolerance=_BALANCE, most=_STEPS)
        energy = grid.energy(u)
        compliance.append(float((stiff * energy).sum()))
        if (
            len(compliance) > 1
            and abs(compliance[-2] - compliance[-1]) < settings["tolerance"] * compliance[-2]
        ):
            break
        slope = penalty * _power(density, penalty - 1) * energy
        design, density = _update(design, smooth.back(slope), smooth, settings)
    return density, compliance


def _power(density: np.ndarray, exponent: float) -> np.ndarray:
    """Return a power; whole ones as products, which have the same last bit on every machine."""
    if exponent != int(exponent):
        return np.asarray(density**exponent)
    found = np.ones_like(density)
    for _ in range(int(exponent)):
        found = found * density
    return found


def _update(
    design: np.ndarray, gain: np.ndarray, smooth: DensityFilter, settings: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Take one step by optimality criteria: design and filtered density, whose mean is the
    volume.
    """
    inside = smooth.inside
    least = np.maximum(settings["low"], design - _MOVE)
    most = np.minimum(settings["high"], design + _MOVE)
    share = np.where(inside, gain / np.where(inside, smooth.back(inside.astype(float)), 1), 0)
    below, above = 0.0, float(share.max()) * 1e6 + 1e-300
    wanted = settings["volume"] * np.count_nonzero(inside)
    for _ in range(200):
        price = (below + above) / 2 if below == 0 or above / below < 4 else np.sqrt(below * above)
        step = np.where(inside, np.clip(design * np.sqrt(share / price), least, most), 0)
        density = smooth(step)
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

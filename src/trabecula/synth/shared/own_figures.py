"""What is off in a result: a few cheap figures of it beside those of its exemplar, in units of what
the exemplar's own parts differ by.

Figures are those of centre boxes. A figure of parts of volume v spreads by d; that of a sample of
volume V by d (v / V)^(1/2), as beyond a few correlation lengths. So result and exemplar differ by d
(v / V + v / V')^(1/2) where nothing is off. `trabecula verify` measures more, and better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from trabecula import measure
from trabecula.core.image import Image, with_values
from trabecula.core.progress import notify
from trabecula.engine.memory import Array, Stage
from trabecula.measure.centre_crop import centre

BOX, SMALL_BOX = 96, 64
"""Voxels of the boxes along every axis, at most: of new material, and of what takes an eighth of
its time.
"""

SHAPES = "shape index"
"""What the names of figures of shapes begin with."""

LEAST = 32
"""Voxels of exemplar and result along every axis, to be measured."""

_BYTES = 24  # of a voxel of a box, at most, while it is measured
_REACH = 20  # voxels: the largest distance of the two-point function
_FAR, _NEAR = 3.0, 0.05  # off: beyond so many spreads, and by more than that
_VAGUE = 0.4  # a figure that spreads by more of itself says nothing


@dataclass(frozen=True)
class Figure:
    """A figure of a result over the exemplar's, or how far its curve is off; and its spread."""

    value: float
    spread: float
    is_distance: bool = False

    @property
    def apart(self) -> float:
        """Return by how much it differs."""
        return self.value if self.is_distance else abs(self.value - 1)

    @property
    def is_off(self) -> bool:
        """Return whether it differs by more than samples of the material do."""
        return self.apart > max(_NEAR, _FAR * self.spread)

    def describe(self, name: str) -> str:
        """Return it in words."""
        how = f"off by {self.value:.2f}" if self.is_distance else f"{self.value:.2f} times"
        return f"{name} {how} (spread {self.spread:.2f})"

    def to_json(self) -> dict[str, float | bool]:
        """Return it as plain JSON."""
        kind = "distance" if self.is_distance else "ratio"
        return {kind: round(self.value, 3), "spread": round(self.spread, 3), "off": self.is_off}


@dataclass(frozen=True)
class OwnFigures:
    """Figures of an exemplar's centre, and of its eight parts.

    Attributes
    ----------
    names : mapping of str to str
        Phases that all parts hold beside others, and what is added to the names of their figures.
    box : int
        Side of the centres of exemplar and results, at most.
    own, spreads : mapping of str to float
        Figures, and the share of it by which each differs between the parts.
    curves : mapping of str to array
        Two-point functions in covariance form, and shares of the shape index; their `spreads` are
        distances to them.
    reach : int
        Voxels: the largest distance of the two-point functions.
    size : int
        Voxels of the centre.
    """

    names: Mapping[str, str]
    box: int
    own: Mapping[str, float]
    spreads: Mapping[str, float]
    curves: Mapping[str, np.ndarray]
    reach: int
    size: int

    @classmethod
    def of(cls, exemplar: Image, *, box: int) -> OwnFigures | None:
        """Measure an exemplar of labels; None where it is too small."""
        if min(exemplar.shape) < LEAST:
            return None
        middle = _middle(exemplar, box, exemplar.values)
        parts = [_part(middle, corner) for corner in product((0, 1), repeat=3)]
        names = _names(exemplar, parts)
        reach = min(_REACH, min(middle.shape) // 4)
        own, curves = _numbers(middle, names), _curves(middle, names, reach)
        numbers = [_numbers(part, names) for part in parts]
        lines = [_curves(part, names, reach) for part in parts]
        spreads = {name: _spread([one[name] for one in numbers]) for name in own}
        for name, curve in curves.items():
            apart = [_distance(one[name], curve) for one in lines]
            spreads[name] = math.hypot(*apart) / math.sqrt(len(apart))
        return cls(names, box, own, spreads, curves, reach, middle.values.size)

    def compare(self, exemplar: Image, values: np.ndarray) -> dict[str, Figure]:
        """Return the figures of the values of a result by name; empty where it is too small, and
        without those that say nothing. No more of them than their centre is read.
        """
        if min(values.shape) < LEAST:
            return {}
        middle = _middle(exemplar, self.box, values)
        scale = math.sqrt((1 + self.size / middle.values.size) / 8)
        told = {name: spread * scale for name, spread in self.spreads.items()}
        told = {name: spread for name, spread in told.items() if spread < _VAGUE}
        numbers, lines = _numbers(middle, self.names), _curves(middle, self.names, self.reach)
        found = {
            name: Figure(numbers[name] / self.own[name], told[name])
            for name in numbers
            if name in told and self.own[name]
        }
        return found | {
            name: Figure(_distance(line, self.curves[name]), told[name], is_distance=True)
            for name, line in lines.items()
            if name in told
        }


def off_line(figures: Mapping[str, Figure]) -> str:
    """Return the figures that are off in words, the farthest first; empty where none is."""
    far = {
        name: one.apart / max(one.spread, _NEAR / _FAR)
        for name, one in figures.items()
        if one.is_off
    }
    names = sorted(far, key=lambda name: -far[name])
    return "; ".join(figures[name].describe(name) for name in names)


def tell_off(figures: Mapping[str, Figure], advice: str = "") -> dict[str, Any]:
    """Say what is off, where something is, and return the figures for a report."""
    if line := off_line(figures):
        notify(f"off beyond the exemplar's own spread: {line}{advice}")
    return {"figures": {name: one.to_json() for name, one in figures.items()}}


def figure_stages(shape: Sequence[int], exemplar: Sequence[int], *, box: int) -> tuple[Stage, ...]:
    """Declare the comparison of a result with its exemplar, the exemplar's own figures among it."""
    if min(*shape, *exemplar) < LEAST:
        return ()
    most = max(math.prod(min(side, box) for side in sides) for sides in (shape, exemplar))
    return (Stage("compare", {"result": Array(shape, np.uint8)}, _BYTES * most),)


def _names(exemplar: Image, parts: Sequence[Image]) -> dict[str, str]:
    """Return the phases that all parts hold beside others, and what is added to the names of their
    figures: nothing for the void, and for the solid where there is one.
    """
    present = np.unique(exemplar.values)
    phases = [exemplar.phases[label] for label in present]
    alone = len(phases) == 2 and "void" in phases
    shares = [[np.mean(part.values == label) for part in parts] for label in present]
    return {
        phase: "" if alone or phase == "void" else f" of {phase}"
        for phase, share in zip(phases, shares, strict=True)
        if min(share) > 0 and max(share) < 1
    }


def _numbers(image: Image, names: Mapping[str, str]) -> dict[str, float]:
    """Return the sizes of phases; surface and Euler density of all but the first."""
    found = {}
    for number, (phase, more) in enumerate(names.items()):
        size = "pore size" if phase == "void" else f"thickness{more}"
        found[size] = measure.thickness(image, phase=phase)
        if number:
            functionals = measure.minkowski(image, phase=phase)
            found[f"surface{more}"] = functionals.surface
            found[f"Euler density{more}"] = functionals.euler_density
    return found


def _curves(image: Image, names: Mapping[str, str], reach: int) -> dict[str, np.ndarray]:
    """Return of all phases but the first the two-point function in covariance form, and the
    distribution of the shape index.
    """
    found = {}
    for phase in list(names)[1:]:
        pairs = measure.two_point(image, r_max=reach, phase=phase)
        found[f"two-point function{names[phase]}"] = measure.covariance_form(pairs)[1:]
        found[f"{SHAPES}{names[phase]}"] = measure.shape_index(image, phase=phase)
    return found


def _distance(line: np.ndarray, own: np.ndarray) -> float:
    size = float(np.linalg.norm(own))
    return float(np.linalg.norm(line - own)) / size if size else math.inf


def _spread(values: Sequence[float]) -> float:
    """Return the standard deviation over the mean's size; infinite where the mean is 0."""
    mean = abs(float(np.mean(values)))
    return float(np.std(values, ddof=1)) / mean if mean else math.inf


def _middle(image: Image, box: int, values: np.ndarray) -> Image:
    sides = [min(side, box) for side in values.shape]
    return with_values(image, np.ascontiguousarray(centre(values, sides)))


def _part(image: Image, corner: Sequence[int]) -> Image:
    """Return the eighth at a corner, (0 or 1) along every axis."""
    cuts = tuple(
        slice(side - side // 2, side) if at else slice(0, side // 2)
        for at, side in zip(corner, image.shape, strict=True)
    )
    return with_values(image, np.ascontiguousarray(image.values[cuts]))

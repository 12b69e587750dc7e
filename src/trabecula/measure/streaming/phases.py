"""Every phase for itself, plane after plane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.contacts import contact_area
from trabecula.measure.correlation.lineal_path import segments_that_fit
from trabecula.measure.correlation.pair_geometry import Radial, Ray, probability
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import as_inside
from trabecula.measure.streaming.cubes import Cubes
from trabecula.measure.streaming.lines import Lines
from trabecula.measure.streaming.numbers import PhaseNumbers
from trabecula.measure.streaming.pairs import RadialPairs


class CurveTally:
    """S2 and lineal path of one phase, given plane after plane.

    Parameters
    ----------
    pairs : Radial
        Of the whole volume; no axis periodic, no mask.
    radial : bool
        Whether the radial curve is wanted, which takes longest.
    """

    def __init__(self, pairs: Radial, *, radial: bool = True) -> None:
        self._pairs, self._lines = pairs, Lines(pairs.r_max)
        self._radial = RadialPairs(pairs) if radial else None

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        self._lines.add(inside)
        if self._radial is not None:
            self._radial.add(inside)

    def two_point(self) -> dict[str, list[float]]:
        """S2 along every axis, and radial where it was wanted."""
        window, r_max = self._pairs.window, self._pairs.r_max
        rays = [
            Ray(window, r_max, tuple(float(along == axis) for along in range(3)))
            for axis in range(3)
        ]
        curves = {
            name: probability(self._lines.pairs[axis], rays[axis].fits()).tolist()
            for axis, name in enumerate(AXES)
        }
        return (
            curves if self._radial is None else {**curves, "radial": self._radial.result().tolist()}
        )

    def lineal_path(self) -> list[float]:
        """The lineal path, segments along all axes together."""
        shape, r_max = self._pairs.window.shape, self._pairs.r_max
        fits = sum(segments_that_fit(shape, r_max, axis, False) for axis in range(3))
        return [float(share) for share in self._lines.segments.sum(axis=0) / fits]


class PhaseTallies:
    """What `describe_phases` tells of every phase and pair, given plane after plane.

    Neither thickness nor cross-correlations nor triple-phase lines, which need the whole volume.

    Parameters
    ----------
    spacing, phases
        Of the whole volume.
    pairs : Radial
        Of the whole volume; no axis periodic, no mask.
    skipped : sequence of str
        Phases whose figures are found otherwise.
    """

    def __init__(
        self,
        spacing: tuple[float, ...],
        phases: tuple[str, ...],
        pairs: Radial,
        *,
        skipped: Sequence[str] = (),
    ) -> None:
        self._spacing, self._phases = spacing, phases
        self._voxels = int(np.prod(pairs.window.shape))
        self._numbers: dict[str, PhaseNumbers] = {}
        self._curves: dict[str, CurveTally] = {}
        for name in phases:
            if name not in skipped:
                self._numbers[name] = PhaseNumbers(pairs.window.shape, spacing)
                self._curves[name] = CurveTally(pairs, radial=len(phases) > 2 or name == phases[-1])
        # With three phases two of them together are what the third is not.
        self._joint = {pair: Cubes() for pair in self._pairs() if len(phases) > 3}

    def _pairs(self) -> Iterator[tuple[str, str]]:
        return combinations(self._phases, 2) if len(self._phases) > 2 else iter(())

    def add(self, slab: Image) -> None:
        """Take the next planes."""
        for name, numbers in self._numbers.items():
            inside = as_inside(slab.values == self._phases.index(name))
            numbers.add(inside)
            self._curves[name].add(inside)
        for (first, second), cubes in self._joint.items():
            either = (slab.values == self._phases.index(first)) | (
                slab.values == self._phases.index(second)
            )
            cubes.add(as_inside(either))

    def result(self) -> dict[str, Any]:
        """By the names of `describe_phases`; `triples` is None where there would be some."""
        phases = {}
        for name, numbers in self._numbers.items():
            curves = self._curves[name]
            phases[name] = {
                "fraction": numbers.pieces().voxels / self._voxels,
                **numbers.result(),
                "thickness": None,
                "two_point": curves.two_point(),
                "lineal_path": curves.lineal_path(),
            }
        pairs = {
            "-".join(pair): {"contact": self._contact(pair), "cross_correlation": None}
            for pair in self._pairs()
        }
        return {"phases": phases, "pairs": pairs, "triples": None if len(self._phases) > 2 else {}}

    def _contact(self, pair: tuple[str, str]) -> float:
        if pair in self._joint:
            joint = self._joint[pair].inside()
        else:
            joint = self._numbers[next(name for name in self._phases if name not in pair)].cubes()[
                ::-1
            ]
        first, second = (self._numbers[name].cubes() for name in pair)
        return contact_area(first, second, joint, self._spacing)

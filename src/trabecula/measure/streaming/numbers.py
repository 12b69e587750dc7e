"""The numbers of `describe` and `describe_phases` that one pass over the planes gives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.contacts import contact_area
from trabecula.measure.correlation.lineal_path import segments_that_fit
from trabecula.measure.correlation.pair_geometry import Radial, Ray, probability
from trabecula.measure.effective_properties import finite
from trabecula.measure.minkowski import Minkowski, densities, euler_of
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import as_inside, check_sides, indicator
from trabecula.measure.streaming.components import ComponentSizes, ComponentTally
from trabecula.measure.streaming.cubes import ConfigurationCounts
from trabecula.measure.streaming.lines import CrossingTally, LineTally
from trabecula.measure.streaming.pairs import RadialPairTally
from trabecula.measure.thickness import mean_chord

SOLID_NUMBERS = (
    *(
        "porosity",
        "specific_surface",
        "euler",
        "euler_density",
        "mean_curvature",
        "components",
        "floating",
    ),
    *("floating_voxels", "largest_fraction", "percolates", "percolating_fraction", "chord_length"),
)
"""The figures of `SolidNumbers` that need a solid."""


class PhaseNumbers:
    """Minkowski functionals, components, percolation and chords of one phase, given plane after
    plane.

    Parameters
    ----------
    shape, spacing
        Of the whole image, (Z, Y, X); a 2-D one is a single plane.
    """

    def __init__(self, shape: tuple[int, ...], spacing: tuple[float, ...]) -> None:
        check_sides(shape, what="has no surface inside")
        self._spacing, self._voxels = spacing, int(np.prod(shape))
        self._cubes = ConfigurationCounts(flat=len(shape) == 2)
        self._components, self._crossings = ComponentTally(), CrossingTally()

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes, or the one of a 2-D image."""
        for tally in (self._cubes, self._components, self._crossings):
            tally.add(inside)

    def component_sizes(self) -> ComponentSizes:
        """Return the components of the phase."""
        return self._components.result()

    def cubes(self) -> np.ndarray:
        """Count how often each configuration occurs inside the volume, (256,)."""
        return self._cubes.inside()

    def euler(self) -> int:
        """Return the Euler number of the phase as an object."""
        return euler_of(self._cubes.object(), 6 if len(self._spacing) == 3 else 4)

    def result(self) -> dict[str, Any]:
        """Return the numbers by the names of `describe`."""
        shape = densities(self.cubes(), self._spacing, 6 if len(self._spacing) == 3 else 4)
        return phase_figures(
            shape, self.component_sizes(), self._crossings.rates(self._spacing), self._voxels
        )


def phase_figures(
    shape: Minkowski, sizes: ComponentSizes, rates: Sequence[float], voxels: int
) -> dict[str, Any]:
    """Return the numbers of one phase by the names of `describe`.

    Parameters
    ----------
    shape : Minkowski
    sizes : ComponentSizes
        Its components.
    rates : sequence of float
        Crossings of its interface per length along every axis of the image.
    voxels : int
        Of the whole image.
    """
    ndim = len(rates)
    through = {name: sizes.through(3 - ndim + n) for n, name in enumerate(AXES[3 - ndim :])}
    return {
        "specific_surface": shape.surface,
        "euler_density": shape.euler_density,
        "mean_curvature": shape.mean_curvature,
        "components": sizes.components,
        "floating": max(0, sizes.components - 1),
        "floating_voxels": sizes.voxels - sizes.largest,
        "largest_fraction": sizes.largest / sizes.voxels if sizes.voxels else 0.0,
        "percolates": {name: voxels > 0 for name, voxels in through.items()},
        "percolating_fraction": {
            name: voxels / max(1, sizes.voxels) for name, voxels in through.items()
        },
        "chord_length": finite(mean_chord(sizes.voxels / voxels, rates)),
    }


class SolidNumbers:
    """Amounts of every phase and the numbers of the solid, given plane after plane.

    Parameters
    ----------
    shape, spacing, phases
        Of the whole image, (Z, Y, X); a 2-D one is a single plane.
    """

    def __init__(
        self, shape: tuple[int, ...], spacing: tuple[float, ...], phases: tuple[str, ...]
    ) -> None:
        self._solid, self._phases = PhaseNumbers(shape, spacing), phases
        self._counts = np.zeros(len(phases), np.int64)

    def add(self, slab: Image) -> None:
        """Take the next planes, or the one of a 2-D image."""
        self._counts += np.bincount(slab.values.ravel(), minlength=len(self._phases))
        self._solid.add(as_inside(indicator(slab, None)[1]))

    def component_sizes(self) -> ComponentSizes:
        """Return the components of the solid."""
        return self._solid.component_sizes()

    def result(self) -> dict[str, Any]:
        """Return the numbers by the names of `describe`."""
        fractions = fractions_of(self._counts, self._phases)
        solid = self._solid.result()
        first = {
            "porosity": fractions["void"],
            "fractions": fractions,
            "specific_surface": solid["specific_surface"],
        }
        return {**first, "euler": self._solid.euler(), **solid}


def fractions_of(counts: np.ndarray, phases: Sequence[str]) -> dict[str, float]:
    """Return the fraction of every phase from its count of voxels."""
    total = int(counts.sum())
    return {name: int(count) / total for name, count in zip(phases, counts, strict=True)}


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
        self._pairs, self._lines = pairs, LineTally(pairs.r_max)
        self._radial = RadialPairTally(pairs) if radial else None

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        self._lines.add(inside)
        if self._radial is not None:
            self._radial.add(inside)

    def two_point(self) -> dict[str, list[float]]:
        """Return S2 along every axis, and radial where it was requested."""
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
        """Return the lineal path, segments along all axes together."""
        shape, r_max = self._pairs.window.shape, self._pairs.r_max
        fits = sum(segments_that_fit(shape, r_max, axis, False) for axis in range(3))
        return [float(share) for share in self._lines.segments.sum(axis=0) / fits]


class PhaseTallies:
    """The figures of `describe_phases` of every phase and pair, given plane after plane.

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
        self._joint = {pair: ConfigurationCounts() for pair in self._pairs() if len(phases) > 3}

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
        """Return the figures by the names of `describe_phases`; `triples` is None where there would
        be some.
        """
        phases = {}
        for name, numbers in self._numbers.items():
            curves = self._curves[name]
            phases[name] = {
                "fraction": numbers.component_sizes().voxels / self._voxels,
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

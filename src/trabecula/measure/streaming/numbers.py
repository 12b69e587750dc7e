"""The numbers of `describe` that one pass over the planes gives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.effective_properties import finite
from trabecula.measure.minkowski import Minkowski, densities, euler_of
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import as_inside, check_sides, indicator
from trabecula.measure.streaming.components import Pieces, PieceSizes
from trabecula.measure.streaming.cubes import Cubes
from trabecula.measure.streaming.lines import Crossings
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
"""What `Numbers` tells that needs a solid."""


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
        self._cubes, self._pieces, self._crossings = (
            Cubes(flat=len(shape) == 2),
            Pieces(),
            Crossings(),
        )

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes, or the one of a 2-D image."""
        for tally in (self._cubes, self._pieces, self._crossings):
            tally.add(inside)

    def pieces(self) -> PieceSizes:
        """The components of the phase."""
        return self._pieces.result()

    def cubes(self) -> np.ndarray:
        """(256,) how often each configuration occurs inside the volume."""
        return self._cubes.inside()

    def euler(self) -> int:
        """The Euler number of the phase as an object."""
        return euler_of(self._cubes.object(), 6 if len(self._spacing) == 3 else 4)

    def result(self) -> dict[str, Any]:
        """By the names of `describe`."""
        shape = densities(self.cubes(), self._spacing, 6 if len(self._spacing) == 3 else 4)
        return phase_figures(
            shape, self.pieces(), self._crossings.rates(self._spacing), self._voxels
        )


def phase_figures(
    shape: Minkowski, pieces: PieceSizes, rates: Sequence[float], voxels: int
) -> dict[str, Any]:
    """Return the numbers of one phase by the names of `describe`.

    Parameters
    ----------
    shape : Minkowski
    pieces : PieceSizes
        Its components.
    rates : sequence of float
        Crossings of its interface per length along every axis of the image.
    voxels : int
        Of the whole image.
    """
    ndim = len(rates)
    through = {name: pieces.through(3 - ndim + n) for n, name in enumerate(AXES[3 - ndim :])}
    return {
        "specific_surface": shape.surface,
        "euler_density": shape.euler_density,
        "mean_curvature": shape.mean_curvature,
        "components": pieces.components,
        "floating": max(0, pieces.components - 1),
        "floating_voxels": pieces.voxels - pieces.largest,
        "largest_fraction": pieces.largest / pieces.voxels if pieces.voxels else 0.0,
        "percolates": {name: voxels > 0 for name, voxels in through.items()},
        "percolating_fraction": {
            name: voxels / max(1, pieces.voxels) for name, voxels in through.items()
        },
        "chord_length": finite(mean_chord(pieces.voxels / voxels, rates)),
    }


class Numbers:
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

    def pieces(self) -> PieceSizes:
        """The components of the solid."""
        return self._solid.pieces()

    def result(self) -> dict[str, Any]:
        """By the names of `describe`."""
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

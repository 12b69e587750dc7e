"""The numbers of `describe` that one pass over the planes gives."""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.minkowski import densities, euler_of
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import as_inside, check_sides, indicator
from trabecula.measure.physics import finite
from trabecula.measure.tallies.components import Pieces, PieceSizes
from trabecula.measure.tallies.cubes import Cubes
from trabecula.measure.tallies.lines import Crossings
from trabecula.measure.thickness import mean_chord


class Numbers:
    """Amounts, Minkowski functionals, components, percolation and chords of the solid, given plane after plane.

    Parameters
    ----------
    shape, spacing, phases
        Of the whole image, (Z, Y, X); a 2-D one is a single plane.
    """

    def __init__(self, shape: tuple[int, ...], spacing: tuple[float, ...], phases: tuple[str, ...]) -> None:
        check_sides(shape, what="has no surface inside")
        self._spacing, self._phases = spacing, phases
        self._counts = np.zeros(len(phases), np.int64)
        self._cubes, self._pieces, self._crossings = Cubes(flat=len(shape) == 2), Pieces(), Crossings()

    def add(self, slab: Image) -> None:
        """Take the next planes, or the one of a 2-D image."""
        self._counts += np.bincount(slab.values.ravel(), minlength=len(self._phases))
        inside = as_inside(indicator(slab, None)[1])
        for tally in (self._cubes, self._pieces, self._crossings):
            tally.add(inside)

    def pieces(self) -> PieceSizes:
        """The components of the solid."""
        return self._pieces.result()

    def result(self) -> dict[str, Any]:
        """By the names of `describe`."""
        ndim, total = len(self._spacing), int(self._counts.sum())
        fractions = {name: int(count) / total for name, count in zip(self._phases, self._counts, strict=True)}
        shape = densities(self._cubes.inside(), self._spacing, 6 if ndim == 3 else 4)
        pieces = self.pieces()
        # Not the fractions' sum, which would round.
        solid = (total - int(self._counts[self._phases.index("void")])) / total
        through = {name: pieces.through(3 - ndim + n) for n, name in enumerate(AXES[3 - ndim :])}
        return {
            "porosity": fractions["void"],
            "fractions": fractions,
            "specific_surface": shape.surface,
            "euler": euler_of(self._cubes.object(), 6 if ndim == 3 else 4),
            "euler_density": shape.euler_density,
            "mean_curvature": shape.mean_curvature,
            "components": pieces.components,
            "floating": max(0, pieces.components - 1),
            "floating_voxels": pieces.voxels - pieces.largest,
            "largest_fraction": pieces.largest / pieces.voxels if pieces.voxels else 0.0,
            "percolates": {name: voxels > 0 for name, voxels in through.items()},
            "percolating_fraction": {name: voxels / max(1, pieces.voxels) for name, voxels in through.items()},
            "chord_length": finite(mean_chord(solid, self._crossings.rates(self._spacing))),
        }

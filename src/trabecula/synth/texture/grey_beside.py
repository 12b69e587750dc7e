"""Grey values and colours beside known ones.

Known voxels tell a structure, and how far their levels lie from what that structure and a random
residual would make of them. New levels take over what their known neighbours have more, on several
scales, so that grain and trends go on across the joint and fade beyond it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.synth.shared.tiles import tile_with_halo, tiles_of
from trabecula.synth.texture.scan_phases import ScanPhases

SCALES = (4.0, 2.0, 1.0)
"""Voxels, of the Gaussians by which levels are taken over, one after the other."""

_LEAST = 0.1  # of a Gaussian's weight in known voxels: beyond them what is taken over fades
_FILL = 2.0  # voxels, of the Gaussian that fills what is next to known voxels


@dataclass(frozen=True)
class KnownLevels:
    """Levels that a result is to have.

    Attributes
    ----------
    values : (Z, Y, X) or (Z, Y, X, 3) array
        Grey values or colours.
    known : (Z, Y, X) bool
        Where they are known.
    fields : callable
        Returns the fields (C, Z, Y, X) float32 of values.
    periodic : three bools
        Axes that continue at the opposite face.
    """

    values: np.ndarray
    known: np.ndarray
    fields: Callable[[np.ndarray], np.ndarray]
    periodic: Sequence[bool]

    def _around(
        self, tile: tuple[slice, ...], reach: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray, tuple[slice, ...]]:
        """Return the fields of a tile and what is around it, which of them are known, and the
        tile's place therein.
        """
        known, inner = tile_with_halo(self.known, tile, reach, self.periodic)
        values, _ = tile_with_halo(self.values, tile, reach, self.periodic)
        return self.fields(values), known, inner

    def structure(self, scan: ScanPhases) -> np.ndarray:
        """Return the phases (Z, Y, X) uint8 of the tiles that hold known voxels, 0 elsewhere.

        What they would be smoothed with beyond the joint is taken to be as near known voxels are.
        """
        found = memmap.empty(self.known.shape, np.uint8)
        reach = (scan.reach + reach_of(_FILL),) * 3
        for tile in tiles_of(found.shape):
            found[tile] = 0
            if self.known[tile].any():
                fields, known, inner = self._around(tile, reach)
                found[tile] = scan.structure_of(_filled(fields, known))[inner]
        return found

    def continue_in(self, levels: np.ndarray, sigmas: Sequence[Sequence[float]]) -> None:
        """Write the known levels into levels (C, Z, Y, X) float32, and what they have more than
        these in part into those beside them, by Gaussians of `sigmas` voxels along every axis.
        """
        reach = np.sum([[reach_of(edge) for edge in sigma] for sigma in sigmas], axis=0)
        for tile in tiles_of(self.known.shape):
            if self.known[tile].all():
                continue
            fields, known, inner = self._around(tile, reach)
            if not known.any():
                continue
            free, there = ~known[inner], known.astype(np.float32)
            weights = [gaussian(there, sigma) + np.float32(_LEAST) for sigma in sigmas]
            for field, channel in zip(fields, levels, strict=True):
                own, _ = tile_with_halo(channel, tile, reach, self.periodic)
                wanted = (field - own) * there
                more = np.zeros_like(wanted)
                for sigma, weight in zip(sigmas, weights, strict=True):
                    more += gaussian((wanted - more) * there, sigma) / weight
                # known ones stay, which other tiles compare with
                channel[tile][free] += more[inner][free]
        for tile in tiles_of(self.known.shape):
            known = self.known[tile]
            if known.any():
                levels[(slice(None), *tile)][:, known] = self.fields(self.values[tile])[:, known]


def _filled(fields: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return fields (C, Z, Y, X) with means of known voxels near by where none is known."""
    weight = np.maximum(gaussian(known, _FILL), np.float32(1e-30))
    means = np.stack([gaussian(field * known, _FILL) / weight for field in fields])
    return np.where(known, fields, means)

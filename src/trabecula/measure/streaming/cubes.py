"""Counts of the 256 cubes of 2x2x2 voxels, plane after plane (see `measure.configurations`)."""

from __future__ import annotations

import numpy as np

from trabecula.measure.configurations import count_cubes


class ConfigurationCounts:
    """Counts of cubes inside a volume, and of those with a margin of outside voxels around it,
    given plane after plane.

    Parameters
    ----------
    flat : bool
        The one plane given is a 2-D image, which has no margin before and behind it.
    """

    def __init__(self, *, flat: bool = False) -> None:
        self._flat = flat
        self._last: np.ndarray | None = None
        self._inside = np.zeros(256, np.int64)
        self._rim = np.zeros(256, np.int64)

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        if self._flat:
            inside = np.concatenate([inside, inside])
        elif self._last is None:
            self._rim += count_cubes(_add_margin(inside[:1], z=(1, 0)), None)
        else:
            inside = np.concatenate([self._last, inside])
        self._inside += count_cubes(inside, None)
        self._rim += _around(inside)
        self._last = inside[-1:].copy()

    def inside(self) -> np.ndarray:
        """Return the counts of cubes wholly inside the volume, (256,): densities are taken over
        them.
        """
        return self._inside.copy()

    def object(self) -> np.ndarray:
        """Return the counts of cubes of the volume and a margin around it, (256,): the phase as an
        object, cut faces being surface.
        """
        if self._flat or self._last is None:
            return self._inside + self._rim
        return self._inside + self._rim + count_cubes(_add_margin(self._last, z=(0, 1)), None)


def _add_margin(plane: np.ndarray, *, z: tuple[int, int]) -> np.ndarray:
    return np.pad(plane, (z, (1, 1), (1, 1)))


def _around(inside: np.ndarray) -> np.ndarray:
    """Count the cubes with a corner beyond the faces across y and x: thin plates along these faces
    hold them all.
    """
    low = np.pad(inside[:, :1], ((0, 0), (1, 0), (1, 1)))
    high = np.pad(inside[:, -1:], ((0, 0), (0, 1), (1, 1)))
    left = np.pad(inside[:, :, :1], ((0, 0), (0, 0), (1, 0)))
    right = np.pad(inside[:, :, -1:], ((0, 0), (0, 0), (0, 1)))
    return np.sum([count_cubes(plate, None) for plate in (low, high, left, right)], axis=0)

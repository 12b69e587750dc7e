"""The lattices of the cases: cells of one period whose struts swell with a volume fraction, and the
two cells that they hold.

Solid is where cos z + cos y + cos x lies below a level. A cell that begins in the middle of a
hollow is a node with six arms (type 1: one piece without a hole); one that begins in a node is the
frame around a hollow (type 2: its Euler number is -4, and 2 once the windows in its faces have
closed). Both are windows of the same lattice, half a period apart.
"""

from __future__ import annotations

import numpy as np

import trabecula as tb

PERIOD = 10


def lattice(fraction: np.ndarray, *, period: int = PERIOD, frames: bool = False) -> tb.Image:
    """A lattice with this volume fraction at every voxel; of nodes in the cells' middles, or of
    frames.
    """
    places = (np.indices(fraction.shape, np.float32) + 0.5) * np.float32(2 * np.pi / period)
    values = np.cos(places).sum(axis=0) * (-1 if frames else 1)
    at = np.cos((np.arange(40) + 0.5) / 40 * 2 * np.pi)
    cell = np.sort((at[:, None, None] + at[:, None] + at).ravel())
    level = cell[np.clip((fraction * len(cell)).astype(int), 0, len(cell) - 1)]
    return tb.Image((values < level).astype(np.uint8), "labels")


def reference(
    side: int = 80, *, low: float = 0.28, high: float = 0.87, frames: bool = False
) -> tb.Image:
    """The sample: a cube of the lattice that is dense here and open there, even in parts, with
    gradients in many directions.
    """
    z, y, x = 1.5 * np.pi * np.indices((side,) * 3) / (side - 1)
    wave = np.cos(x + 0.5 * y) * np.cos(0.9 * y + 0.3 * z) * np.cos(0.5 * z - 0.2 * x)
    wave = np.clip(1.5 * wave, -1, 1)
    wave = (wave - wave.min()) / (wave.max() - wave.min())
    return lattice(low + (high - low) * wave, frames=frames)


def gentle(side: int = 80, *, frames: bool = False) -> tb.Image:
    """The sample without turned copies: dense and open parts that are even in themselves, with
    gradients so slow that neighbouring windows of equal density fit.

    In step with a place there are 343 windows alone, so that density and gradient of each matter;
    these waves were chosen among about a dozen by the cantilever.
    """
    z, y, x = np.indices((side,) * 3, np.float32) / (side - 1)
    wave = np.cos(1.6 * np.pi * (z + 0.2 * y)) * np.cos(1.2 * np.pi * (x - 0.1 * y))
    wave = np.clip(1.5 * wave * np.cos(0.8 * np.pi * (y - 0.2 * x - 0.35)), -1, 1)
    wave = (wave - wave.min()) / (wave.max() - wave.min())
    return lattice(0.297 + (0.853 - 0.297) * wave, frames=frames)

"""A lattice of struts along the axes with period 8, thicker and thinner from place to place."""

import numpy as np


def lattice(fraction, period=8):
    """Return solid where cos + cos + cos is below the level of a fraction; (Z, Y, X) uint8."""
    z, y, x = np.indices(fraction.shape) + 0.5
    values = sum(np.cos(2 * np.pi * at / period) for at in (z, y, x))
    at = (np.arange(24) + 0.5) / 24 * 2 * np.pi
    cell = np.sort(np.add.outer(np.add.outer(np.cos(at), np.cos(at)), np.cos(at)).ravel())
    return (values < cell[(fraction * (len(cell) - 1)).astype(int)]).astype(np.uint8)


def reference(side=40, low=0.3, high=0.8):
    """Return a cube of the lattice whose fraction varies in several directions."""
    z, y, x = np.indices((side,) * 3) / (side - 1)
    wave = (
        np.cos(np.pi * (x + 0.5 * y))
        * np.cos(np.pi * (0.9 * y + 0.3 * z))
        * np.cos(np.pi * (0.5 * z - 0.2 * x))
    )
    wave = (wave - wave.min()) / (wave.max() - wave.min())
    return lattice(low + (high - low) * wave)

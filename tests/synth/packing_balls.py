"""Balls for tests of `packing`: drawn into a box that repeats, and packed."""

import numpy as np

from trabecula.synth.packing.arrangement import arrange
from trabecula.synth.packing.radial_shapes import SIZE
from trabecula.synth.packing.scan_bodies import ScanBodies


def balls_in(side, places, radii):
    """Return a volume of labels with balls in a box that repeats."""
    inside = np.zeros((side,) * 3, bool)
    for place, radius in zip(places, np.broadcast_to(radii, len(places)), strict=True):
        lines = [np.arange(int(at - radius) - 1, int(at + radius) + 2) for at in place]
        off = np.ix_(*(line + 0.5 - at for line, at in zip(lines, place, strict=True)))
        inside[np.ix_(*(line % side for line in lines))] |= sum(o**2 for o in off) < radius**2
    return inside


def bodies_of(*radii, density=1e-3, lie=False):
    """Return bodies that are balls of these radii, each as frequent."""
    tables = np.stack([np.full(SIZE, radius, np.float32) for radius in radii])
    weights = np.full(len(radii), 1 / len(radii))
    return ScanBodies(tables, weights, density, 0.3, 0.0, lie)


def packed(bodies, side, seed=0, **settings):
    """Return bodies packed in a cube."""
    given = {"separation": 1.0, "any_way": True, "density": bodies.density} | settings
    return arrange(bodies, (float(side),) * 3, seed=seed, quiet=True, **given)


def beads(side, seed, radius=6.0, share=0.5):
    """Return the places of touching balls of one size in a cube that repeats, and its voxels."""
    density = share / (4 / 3 * np.pi * radius**3)
    places = packed(bodies_of(radius, density=density), side, seed=seed).places
    return places, balls_in(side, places, radius)

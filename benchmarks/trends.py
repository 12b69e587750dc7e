"""Trends of fraction, direction and size: false alarms on stationary material, and graded material
that is to be found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

import trabecula as tb
from common import table
from trabecula.measure.smooth import gaussian
from trabecula.report.stationarity import find_trends
from trabecula.report.structure import lengths_along_axes

IMAGES = 160
SIDE = 96


def field(shape: object, length: object, porosity: float, covariance: str = "gaussian") -> Callable:
    """What makes a thresholded Gaussian field of a seed."""
    made = tb.method("noise", covariance=covariance, length=length, porosity=porosity).fit()
    return lambda seed: made.generate(shape, seed=seed)


def spheres(side: int, radius: float, share: float) -> Callable[[int], tb.Image]:
    """What makes a Boolean model of spheres of a seed."""

    def make(seed: int) -> tb.Image:
        rng = np.random.default_rng(seed)
        density = -np.log(1 - share) / (4 / 3 * np.pi * radius**3)
        count = rng.poisson(density * (side + 2 * radius) ** 3)
        inside = np.zeros((side,) * 3, bool)
        for centre in rng.uniform(-radius, side + radius, (count, 3)):
            add_ellipsoid(inside, centre, (radius,) * 3, 0.0)
        return tb.Image(inside.astype(np.uint8), "labels")

    return make


def add_ellipsoid(
    inside: np.ndarray, centre: np.ndarray, axes: tuple[float, ...], turn: float
) -> None:
    """Add an ellipsoid of half axes z, across and along, turned in the plane of y and x."""
    reach = max(axes) + 1
    box = tuple(
        slice(max(0, int(c - reach)), max(0, min(side, int(c + reach) + 1)))
        for c, side in zip(centre, inside.shape, strict=True)
    )
    z, y, x = (part - c for part, c in zip(np.ogrid[box], centre, strict=True))
    along, across = y * np.sin(turn) + x * np.cos(turn), y * np.cos(turn) - x * np.sin(turn)
    inside[box] |= (z / axes[0]) ** 2 + (across / axes[1]) ** 2 + (along / axes[2]) ** 2 <= 1


def graded_size(coarse: float, seed: int) -> tb.Image:
    """A Gaussian field whose length grows along z from 4 voxels, at one fraction in every slice."""
    noise = np.random.default_rng(seed).standard_normal((SIDE,) * 3).astype(np.float32)
    levels = [gaussian(noise, length / 2) for length in np.linspace(4, coarse, 8)]
    levels = [level / level.std() for level in levels]
    inside = np.empty(noise.shape, bool)
    for z, at in enumerate(np.linspace(0, 7, SIDE)):
        n, rest = min(int(at), 6), at - min(int(at), 6)
        plane = (1 - rest) * levels[n][z] + rest * levels[n + 1][z]
        inside[z] = plane > 0.25 * plane.std()
    return tb.Image(inside.astype(np.uint8), "labels")


def turning(degrees: float, seed: int) -> tb.Image:
    """Ellipsoids three times as long as wide that turn along z."""
    rng, inside = np.random.default_rng(seed), np.zeros((SIDE,) * 3, bool)
    for centre in rng.uniform(-6, SIDE + 6, (900, 3)):
        add_ellipsoid(inside, centre, (3, 3, 9), np.deg2rad(degrees) * centre[0] / SIDE)
    return tb.Image(inside.astype(np.uint8), "labels")


STATIONARY: dict[str, Callable] = {
    "field 64, length 3": field(64, 3.0, 0.6),
    "field 64, 5, sparse": field(64, 5.0, 0.85),
    "field 96, length 4": field(96, 4.0, 0.5),
    "exponential 64, 4": field(64, 4.0, 0.5, "exponential"),
    "stretched 72, 8 3 3": field(72, (8.0, 3.0, 3.0), 0.5),
    "picture 160, length 4": field((160, 160), 4.0, 0.5),
    "spheres 72, radius 4": spheres(72, 4.0, 0.4),
    "spheres 72, 4, sparse": spheres(72, 4.0, 0.15),
    "spheres 64, radius 6": spheres(64, 6.0, 0.5),
}


def trends() -> None:
    """False alarms of 160 images of every stationary material, and what is found in graded ones."""
    row = table("stationary", "images", "fraction", "direction", "size")
    for name, make in STATIONARY.items():
        said: Counter[str] = Counter()
        for seed in range(IMAGES):
            said.update({trend.what.split()[0] for trend in surest(make(seed))})
        row(name, IMAGES, *(said[what] for what in ("fraction", "direction", "size")))
    row = table("graded", "seed", "what", "along", "standard errors")
    for name, graded, steps, seeds in (
        ("length 4 to", graded_size, (5, 6, 8), 3),
        ("turning by", turning, (20, 45, 90, 180), 2),
    ):
        for step in steps:
            for seed in range(seeds):
                for trend in surest(graded(step, seed)):
                    row(f"{name} {step}", seed, trend.what, trend.name, f"{trend.errors:.1f}")


def surest(image: tb.Image) -> tuple:
    """The surest trend of every quantity that has one."""
    return find_trends(image, lengths_along_axes(image)).surest

"""The figures that an ensemble is judged by: few, of every kind, each known by another name in the
literature.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.parallel import map_items
from trabecula.measure.blockwise import images_at_once
from trabecula.measure.correlation import decay_length, two_point
from trabecula.measure.fractions import volume_fractions
from trabecula.measure.registry import AT_LEAST, DESCRIPTORS
from trabecula.report.metrics import find_descriptor

NUMBERS = (
    "porosity",
    "specific_surface",
    "mean_curvature",
    "chord_length",
    "thickness",
    "pore_size",
    "largest_fraction",
    "euler_density",
)
"""Descriptors of the registry, measured one by one."""

TRANSPORT = ("diffusivity", "permeability")
"""Of the void, the mean of the axes; volumes only."""

LAGS = {"half": 0.5, "one": 1.0, "two": 2.0}
"""Distances at which the two-point function is a figure, in correlation lengths."""


@dataclass(frozen=True)
class EnsembleFigures:
    """How members and real parts are measured."""

    level: str
    lags: Mapping[str, float]
    """Distances in voxels, by the end of a name."""
    box: int | None = None
    """Edge of the centre box, voxels, that transport is solved in."""

    def measure(self, image: Image) -> dict[str, float | None]:
        """Measure every figure of an image, by name; None where it does not exist."""
        known = [DESCRIPTORS[name] for name in NUMBERS]
        found: dict[str, float | None] = {
            one.name: _number(one.measure(image))
            for one in known
            if one.measure is not None and one.is_measured(self.level)
        }
        if len(image.phases) > 2:
            shares = volume_fractions(image).items()
            found |= {f"fraction_{phase}": float(share) for phase, share in shares}
        curve = two_point(image, r_max=math.ceil(max(self.lags.values())))
        for name, lag in self.lags.items():
            found[f"two_point_{name}"] = float(np.interp(lag, np.arange(len(curve)), curve))
        if self.level == "full" and image.ndim == 3:
            for name in TRANSPORT:
                solve = DESCRIPTORS[name].measure
                assert solve is not None  # the registry has a function for each
                values = [solve(image, axis=axis, box=self.box).value for axis in range(3)]
                found[name] = _number(float(np.mean(values)))
        return {name: found[name] for name in sorted(found, key=_place)}

    def measure_all(self, images: Sequence[Image], label: str) -> list[dict[str, float | None]]:
        """Measure every figure of every image; report under `label` how many are done."""
        most = images_at_once([image.shape for image in images], self.level)
        return map_items(self.measure, images, label, most=most)

    def title(self, name: str) -> str:
        """Return the title of a figure."""
        lag = self.lags.get(name.removeprefix("two_point_"))
        if lag is None:
            return find_descriptor(name).title
        return f"Two-point function at {lag:.3g} voxels"


def choose_lags(exemplars: Sequence[Image], r_max: int) -> dict[str, float]:
    """Return half, one and two correlation lengths in voxels, the longest `r_max` at most."""
    lengths = [decay_length(two_point(exemplar, r_max=r_max)) for exemplar in exemplars]
    length = min(float(np.mean(lengths)), r_max / max(LAGS.values()))
    return {name: share * length for name, share in LAGS.items()}


def power(name: str) -> int:
    """Return the power of the unit of length that a figure has."""
    return 0 if name.startswith("two_point_") else find_descriptor(name).power


def is_one_sided(name: str) -> bool:
    """Return whether more of a figure is no fault, such as of the share of the largest component:
    scans have loose specks.
    """
    return not name.startswith("two_point_") and find_descriptor(name).rule == AT_LEAST


def is_share(name: str) -> bool:
    """Return whether a figure lies between 0 and 1."""
    return name.startswith("two_point_") or find_descriptor(name).share


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _place(name: str) -> tuple[int, float]:
    """Return the place of a figure: that of its descriptor in the registry, then its lag."""
    places = {known: place for place, known in enumerate(DESCRIPTORS)}
    if name.startswith("two_point_"):
        return places["two_point"], LAGS[name.removeprefix("two_point_")]
    return places[name if name in places else "fraction"], 0.0

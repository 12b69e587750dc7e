"""What is measured of an image, and how far two images are apart: one stick for labels, one for grey and colour."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.engine.slabs import Slabs
from trabecula.measure.blockwise import LEFT_OUT, count_slabs, fitting_depth
from trabecula.measure.components import component_sizes, sizes_distance
from trabecula.measure.correlation import covariance_form
from trabecula.measure.describe import autocorrelation_lines, describe_curves, describe_numbers
from trabecula.measure.grey import grey_values, histogram, kullback_leibler, ten_bins
from trabecula.measure.orientation import orientation
from trabecula.measure.physics import describe_physics
from trabecula.report.figures import FIGURES

BINS = 64
"""Of the histograms that are compared."""

NOTHING = np.empty(0)

_SLOW = ("pore_size", "thickness", "anisotropy")  # None at level "quick": not measured, and not missing


@dataclass(frozen=True)
class Measured:
    """One image, measured."""

    shape: tuple[int, ...]
    numbers: Mapping[str, Any]
    """By the names of the table of figures: a number, truth values by axis, or None where it does not exist."""
    curves: Mapping[str, np.ndarray]
    """By name; those along an axis end with its letter."""
    sizes: np.ndarray
    """Share of the volume that every component has; empty for grey and colour."""
    details: Mapping[str, Any]
    """What is told and not judged: the stiffness matrix, whether solvers converged."""


class Stick(Protocol):
    """How images of one kind are measured and compared."""

    def measure(self, image: Image, *, part: bool = False) -> Measured:
        """Every number and curve of an image, or of a part of one."""

    def distances(self, image: Measured, exemplar: Measured) -> dict[str, float]:
        """Every distance of an image to the exemplar."""


class LabelStick:
    """Measures of phases."""

    def __init__(self, *, r_max: int, level: str, box: int | None = None, memory: int | None = None) -> None:
        self.r_max, self.level, self.box, self.memory = r_max, level, box, memory

    def measure(self, image: Image | Slabs, *, part: bool = False) -> Measured:
        """Numbers, curves and sizes of components; at level "full" transport and stiffness, and unless it is a part what
        halving the voxel changes. A volume in slabs is measured at level "quick"."""
        if isinstance(image, Slabs):
            return self._measure_slabs(image)
        found = describe_numbers(image, level=self.level)
        curves = describe_curves(image, r_max=self.r_max, level=self.level)
        physics = describe_physics(image, box=self.box, halving=not part) if self.level == "full" else {}
        return Measured(
            image.shape,
            numbers_of(found, physics, self.level),
            _curves_of(curves),
            component_sizes(image) / image.values.size,
            physics,
        )

    def _measure_slabs(self, volume: Slabs) -> Measured:
        depth = fitting_depth(volume, r_max=self.r_max, memory=self.memory)
        found, pieces = count_slabs(volume, r_max=self.r_max, depth=depth)
        found |= dict.fromkeys(LEFT_OUT)
        sizes = pieces.sizes() / math.prod(volume.shape)
        return Measured(volume.shape, numbers_of(found, {}, "quick"), _curves_of(found), sizes, {})

    def distances(self, image: Measured, exemplar: Measured) -> dict[str, float]:
        """Raw, relative and covariance-normalised distances of the curves, and of the component sizes."""
        found = {
            "porosity_error": abs(image.numbers["porosity"] / exemplar.numbers["porosity"] - 1),
            "two_point_distance": float(np.linalg.norm((image.curves["two_point"] - exemplar.curves["two_point"])[1:])),
            "component_distance": sizes_distance(image.sizes, exemplar.sizes),
        }
        for name in ("two_point", "lineal_path", "two_point_cluster"):
            if name in exemplar.curves:
                suffix = "relative" if name == "two_point" else "distance"
                found[f"{name}_{suffix}"] = _relative(image.curves[name], exemplar.curves[name])
        forms = {
            name: _relative(covariance_form(image.curves[name]), covariance_form(curve))
            for name, curve in exemplar.curves.items()
            if name.startswith("two_point") and "cluster" not in name
        }
        found["two_point_covariance"] = forms.pop("two_point")
        found["two_point_axial"] = max(forms.values())
        return found


class TextureStick:
    """Measures of grey values and colours as they are.

    Parameters
    ----------
    exemplar : Image
        Its range of values is cut into the bins of every histogram.
    lags : int
    """

    def __init__(self, exemplar: Image, *, lags: int) -> None:
        self.lags = lags
        self.bytes = exemplar.values.dtype == np.uint8
        low, high = (0.0, 256.0) if self.bytes else (float(exemplar.values.min()), float(exemplar.values.max()))
        self.edges = np.linspace(low, high if high > low else low + 1, BINS + 1)

    def measure(self, image: Image, *, part: bool = False) -> Measured:
        """First and second order statistics and local orientations."""
        values = grey_values(image)
        numbers = {
            "mean": float(values.mean(dtype=np.float64)),
            "standard_deviation": float(values.std(dtype=np.float64)),
        }
        curves = {
            # Of a colour image the channels' one after another.
            "histogram": histogram(image, bins=self.edges.tolist()).ravel(),
            "orientation": orientation(image).shares.ravel(),
        }
        if self.bytes and image.values.dtype == np.uint8:
            curves["ten_bins"] = ten_bins(image)
        lines = autocorrelation_lines(image, lags=self.lags)
        return Measured(
            image.shape,
            numbers,
            curves | {f"autocorrelation_{axis}": line for axis, line in lines.items()},
            NOTHING,
            {},
        )

    def distances(self, image: Measured, exemplar: Measured) -> dict[str, float]:
        """As the 2014 paper compares textures (its section VI), and the 2017 paper's ten bins."""
        ours, own = image.curves, exemplar.curves
        found = {
            "histogram_divergence": kullback_leibler(
                ours["histogram"].reshape(-1, BINS), own["histogram"].reshape(-1, BINS)
            ),
            "autocorrelation_distance": max(
                _relative(ours[name], own[name]) for name in own if name.startswith("autocorrelation")
            ),
        }
        if ours["orientation"].any() and own["orientation"].any():
            found["orientation_divergence"] = kullback_leibler(ours["orientation"], own["orientation"])
        if "ten_bins" in ours and "ten_bins" in own:
            found["ten_bins_distance"] = float(np.abs(ours["ten_bins"] - own["ten_bins"]).max())
        return found


def numbers_of(found: Mapping[str, Any], physics: Mapping[str, Any], level: str) -> dict[str, Any]:
    """Flat: one name a number. A property that has one value an axis gives its mean and each of them."""
    numbers = {figure.name: found[figure.name] for figure in FIGURES if figure.name in found}
    if level == "quick":
        numbers = {name: value for name, value in numbers.items() if name not in _SLOW}
    if len(found["fractions"]) > 2:
        numbers |= {f"fraction_{phase}": share for phase, share in found["fractions"].items()}
    numbers["percolating_fraction"] = float(np.mean(list(found["percolating_fraction"].values())))
    if found["morphometry"]:
        numbers["trabecular_number"] = found["morphometry"]["Tb.N"]
    along = {name: physics.get(name) for name in ("diffusivity", "conductivity", "permeability")}
    along["stiffness"] = physics["stiffness"]["moduli"] if physics.get("stiffness") else None
    for name, axes in along.items():
        if axes:
            numbers[name] = float(np.mean(list(axes.values())))
            numbers |= {f"{name}_{axis}": value for axis, value in axes.items()}
    return numbers


def _curves_of(found: Mapping[str, Any]) -> dict[str, np.ndarray]:
    curves = {"two_point": np.array(found["two_point"]["radial"]), "lineal_path": np.array(found["lineal_path"])}
    if found["two_point_cluster"] is not None:
        curves["two_point_cluster"] = np.array(found["two_point_cluster"])
    return curves | {f"two_point_{axis}": np.array(c) for axis, c in found["two_point"].items() if axis != "radial"}


def _relative(curve: ArrayLike, reference: ArrayLike) -> float:
    reference = np.asarray(reference)
    return float(np.linalg.norm(np.asarray(curve) - reference) / np.linalg.norm(reference))

"""Sets of descriptors: how an image is measured and how far two images are apart, for labels and
for grey and colour.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.engine.lazy_volume import Slabs
from trabecula.measure.blockwise import count_slabs, fitting_depth, names_without_slabs
from trabecula.measure.components import component_sizes, sizes_distance
from trabecula.measure.correlation import covariance_form
from trabecula.measure.correlation.lineal_path import segments_that_fit
from trabecula.measure.describe import (
    SOLID_CURVES,
    autocorrelation_lines,
    describe_curves,
    describe_numbers,
)
from trabecula.measure.effective_properties import describe_physics, finite
from trabecula.measure.evenness import Evenness
from trabecula.measure.grey import grey_values, histogram, kullback_leibler, ten_bins
from trabecula.measure.orientation import orientation
from trabecula.measure.phase_lists import phase_curves, phase_numbers
from trabecula.measure.phases import as_inside, indicator
from trabecula.measure.registry import AXES, DESCRIPTORS, PHYSICS, measure_one_by_one, select
from trabecula.measure.streaming import LineTally
from trabecula.measure.streaming.cells import CellMeans, CellSums, cells_of
from trabecula.measure.streaming.lines import CrossingTally
from trabecula.measure.thickness import mean_chord
from trabecula.report.evenness import Windows, measure_evenness, phases_of

_PHYSICS_TOLERANCE = 1e-2
"""Of the solvers: figures then are right within .3 % (measured on bone and sandstone, 96^3), and
bands are wider than that by far."""

BINS = 64
"""Bins of the histograms that are compared."""


@dataclass(frozen=True)
class Measurements:
    """One image, measured."""

    shape: tuple[int, ...]
    numbers: Mapping[str, Any]
    """By the names of the registry: a number, truth values by axis, or None where it does
    not exist.
    """
    curves: Mapping[str, np.ndarray]
    """By name; those along an axis end with its letter."""
    sizes: np.ndarray
    """Share of the volume that every component has; empty for grey and colour."""
    details: Mapping[str, Any]
    """Reported and not judged: the stiffness matrix, the convergence of solvers."""
    evenness: Mapping[str, Evenness] = field(default_factory=dict)
    """Local figures of every phase by the suffix of their names; empty of parts."""
    cells: CellMeans | None = None
    """Sums over cells, which the local figures are added up from."""
    samples: float = 1.0
    """Independent images of this shape that the figures are means of."""


class DescriptorSet(Protocol):
    """How images of one kind are measured and compared."""

    def measure(self, image: Image, *, part: bool = False) -> Measurements:
        """Measure every number and curve of an image, or of a part of one."""

    def distances(self, image: Measurements, exemplar: Measurements) -> dict[str, float]:
        """Return every distance of an image to the exemplar."""


class LabelDescriptors:
    """Descriptors of phases.

    Parameters
    ----------
    r_max : int
        Largest distance of the curves, voxels.
    level : {"quick", "default", "full"}
    windows : Windows, optional
        Of the local figures. Default: none are measured.
    box : int, optional
        Edge of the centre box, voxels, that transport and stiffness are solved in.
    memory : int, optional
        Bytes that a volume in slabs may take.
    """

    def __init__(
        self,
        *,
        r_max: int,
        level: str,
        windows: Windows | None = None,
        box: int | None = None,
        memory: int | None = None,
    ) -> None:
        self.r_max, self.level = r_max, level
        self.windows, self.box, self.memory = windows, box, memory

    def measure(self, image: Image | Slabs, *, part: bool = False) -> Measurements:
        """Measure numbers, curves and sizes of components; at level "full" transport and stiffness.

        Of a part neither local figures nor what halving the voxel changes are measured. A volume in
        slabs is measured at level "quick".
        """
        if isinstance(image, Slabs):
            return self._measure_slabs(image)
        found = describe_numbers(image, level=self.level)
        curves = describe_curves(image, r_max=self.r_max, level=self.level)
        physics: dict[str, Any] = {}
        if self.level == "full":
            physics = describe_physics(
                image, box=self.box, halving=not part, tolerance=_PHYSICS_TOLERANCE
            )
        lines = _AxisTallies(image.ndim, self.r_max)
        lines.add(image)
        each_numbers: dict[str, Any] = {}
        each_curves: dict[str, np.ndarray] = {}
        if self.level != "quick":
            each_numbers = phase_numbers(image, level=self.level)
            each_curves = phase_curves(image, r_max=self.r_max)
        local = None if part or self.windows is None else cells_of(image, cell=self.windows.cell)
        return Measurements(
            image.shape,
            flat_numbers(found, physics, self.level)
            | lines.numbers(found["porosity"], image.spacing)
            | each_numbers,
            _curves_of(curves) | lines.curves(image.shape) | each_curves,
            component_sizes(image) / image.values.size,
            physics,
            _evenness(local, self.windows, image),
            local,
        )

    def _measure_slabs(self, volume: Slabs) -> Measurements:
        depth = fitting_depth(volume, r_max=self.r_max, memory=self.memory)
        lines = _AxisTallies(3, self.r_max)
        sums = self.windows and CellSums(
            volume.shape, volume.spacing, len(volume.phases), cell=self.windows.cell
        )
        tallies = [lines, *([sums] if sums else [])]
        found, components = count_slabs(volume, r_max=self.r_max, depth=depth, tallies=tallies)
        found |= dict.fromkeys(names_without_slabs())
        local = sums.result() if sums else None
        return Measurements(
            volume.shape,
            flat_numbers(found, {}, "quick") | lines.numbers(found["porosity"], volume.spacing),
            _curves_of(found) | lines.curves(volume.shape),
            components.sizes() / math.prod(volume.shape),
            {},
            _evenness(local, self.windows, volume),
            local,
        )

    def distances(self, image: Measurements, exemplar: Measurements) -> dict[str, float]:
        """Return raw, relative and covariance-normalised distances of the curves, and of the
        component sizes.
        """
        found = {
            "porosity_error": abs(image.numbers["porosity"] / exemplar.numbers["porosity"] - 1),
            "two_point_distance": float(
                np.linalg.norm((image.curves["two_point"] - exemplar.curves["two_point"])[1:])
            ),
            "component_distance": sizes_distance(image.sizes, exemplar.sizes),
        }
        distances = {one.compares: one.name for one in select(kind="labels") if one.compares}
        for name, own in exemplar.curves.items():
            # one of them is too thin for it, or the exemplar has no interface off its faces
            if name not in image.curves or not np.any(own):
                continue
            curve = image.curves[name]
            stems = [known for known in distances if f"{name}_".startswith(f"{known}_")]
            if not stems:
                continue
            stem = max(stems, key=len)
            ending = name[len(stem) :].replace("_axis_", "_")  # an axis, a phase or a pair of them
            if stem == "two_point":
                if not ending:
                    found["two_point_relative"] = _relative(curve[1:], own[1:])
                curve, own = covariance_form(curve), covariance_form(own)
            found[distances[stem] + ending] = _relative(curve, own)
        return found


class _AxisTallies:
    """Chords and lineal paths of single axes, of the solid and of the void, plane after plane."""

    def __init__(self, ndim: int, r_max: int) -> None:
        self.ndim, self.r_max = ndim, r_max
        self._lines = {"": LineTally(r_max), "_void": LineTally(r_max)}
        self._crossings = CrossingTally()

    def add(self, image: Image) -> None:
        """Take the next planes of a volume, or the one of a 2-D image."""
        inside = as_inside(indicator(image, None)[1])
        self._crossings.add(inside)
        self._lines[""].add(inside)
        self._lines["_void"].add(~inside)

    def numbers(self, porosity: float, spacing: tuple[float, ...]) -> dict[str, float | None]:
        """Return the mean chord of the solid along every axis."""
        rates = self._crossings.rates(spacing)
        if len(rates) != self.ndim:
            return {}
        names = "zyx"[3 - self.ndim :]
        chords = {
            name: finite(mean_chord(1 - porosity, [rate]))
            for name, rate in zip(names, rates, strict=True)
        }
        surfaces = {
            f"specific_surface_{name}": 2 * rate for name, rate in zip(names, rates, strict=True)
        }
        return {f"chord_length_{name}": chord for name, chord in chords.items()} | surfaces

    def curves(self, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
        """Return the lineal path of the void, and of both along every axis."""
        sides = (1,) * (3 - self.ndim) + tuple(shape)
        axes = range(3 - self.ndim, 3)
        fits = {axis: segments_that_fit(sides, self.r_max, axis, False) for axis in axes}
        found = {}
        for suffix, lines in self._lines.items():
            for axis in axes:
                found[f"lineal_path{suffix}_axis_{'zyx'[axis]}"] = lines.segments[axis] / fits[axis]
        total = sum(fits.values())
        found["lineal_path_void"] = (
            sum(self._lines["_void"].segments[axis] for axis in axes) / total
        )
        return found


class TextureDescriptors:
    """Descriptors of grey values and colours as they are.

    Parameters
    ----------
    exemplar : Image
        Its range of values is cut into the bins of every histogram.
    lags : int
    windows : Windows, optional
        Of the local figures. Default: none are measured.
    """

    def __init__(self, exemplar: Image, *, lags: int, windows: Windows | None = None) -> None:
        self.lags, self.windows = lags, windows
        self.bytes = exemplar.values.dtype == np.uint8
        low, high = 0.0, 256.0
        if not self.bytes:
            low, high = float(exemplar.values.min()), float(exemplar.values.max())
        self.edges = np.linspace(low, high if high > low else low + 1, BINS + 1)

    def measure(self, image: Image, *, part: bool = False) -> Measurements:
        """Measure first and second order statistics and local orientations."""
        values = grey_values(image)
        numbers = {
            "mean": float(values.mean(dtype=np.float64)),
            "standard_deviation": float(values.std(dtype=np.float64)),
            **measure_one_by_one(image, level="full"),
        }
        curves = {
            # Of a colour image the channels' one after another.
            "histogram": histogram(image, bins=self.edges.tolist()).ravel(),
            "orientation": orientation(image).shares.ravel(),
        }
        if self.bytes and image.values.dtype == np.uint8:
            curves["ten_bins"] = ten_bins(image)
        lines = autocorrelation_lines(image, lags=self.lags)
        local = None if part or self.windows is None else cells_of(image, cell=self.windows.cell)
        return Measurements(
            image.shape,
            numbers,
            curves | {f"autocorrelation_{axis}": line for axis, line in lines.items()},
            np.empty(0),
            {},
            _evenness(local, self.windows, image),
            local,
        )

    def distances(self, image: Measurements, exemplar: Measurements) -> dict[str, float]:
        """Compare as the 2014 paper (section VI) does, and by the 2017 paper's ten bins."""
        ours, own = image.curves, exemplar.curves
        found = {
            "histogram_divergence": kullback_leibler(
                ours["histogram"].reshape(-1, BINS), own["histogram"].reshape(-1, BINS)
            ),
            "autocorrelation_distance": max(
                _relative(ours[name], own[name])
                for name in own
                if name.startswith("autocorrelation")
            ),
        }
        if ours["orientation"].any() and own["orientation"].any():
            found["orientation_divergence"] = kullback_leibler(
                ours["orientation"], own["orientation"]
            )
        if "ten_bins" in ours and "ten_bins" in own:
            found["ten_bins_distance"] = float(np.abs(ours["ten_bins"] - own["ten_bins"]).max())
        return found


def flat_numbers(
    found: Mapping[str, Any], physics: Mapping[str, Any], level: str
) -> dict[str, Any]:
    """Return the numbers that `describe` and `describe_physics` found, one name a number.

    A property that has one value an axis gives its mean and each of them. Descriptors above the
    level are left out: they are not missing.
    """
    numbers = {
        name: found[name]
        for name, descriptor in DESCRIPTORS.items()
        if descriptor.group and name in found and descriptor.is_measured(level)
    }
    if len(found["fractions"]) > 2:
        numbers |= {f"fraction_{phase}": share for phase, share in found["fractions"].items()}
    numbers["percolating_fraction"] = float(np.mean(list(found["percolating_fraction"].values())))
    if found["morphometry"]:
        numbers["trabecular_number"] = found["morphometry"]["Tb.N"]
    by_axis = {one.name: physics.get(one.name) for one in select(source=PHYSICS) if one.group}
    for one in select(source="", kind="labels"):
        if one.by_axis and one.rule != AXES:
            by_axis[one.name] = numbers.pop(one.name, None)
    for name, axes in by_axis.items():
        if isinstance(axes, float):
            numbers[name] = axes
        elif axes:
            axes = axes["moduli"] if name == "stiffness" else axes
            numbers[name] = float(np.mean(list(axes.values())))
            numbers |= {f"{name}_{axis}": value for axis, value in axes.items()}
    return numbers


def _evenness(
    local: CellMeans | None, windows: Windows | None, image: Image | Slabs
) -> dict[str, Evenness]:
    if local is None or windows is None:
        return {}
    return measure_evenness(local, windows, phases_of(image))


def _curves_of(found: Mapping[str, Any]) -> dict[str, np.ndarray]:
    curves = {
        "two_point": np.array(found["two_point"]["radial"]),
        "lineal_path": np.array(found["lineal_path"]),
    }
    single = [one.name for one in select(source="", kind="labels") if one.curve]
    for name in (*SOLID_CURVES, *single):
        if found[name] is not None:
            curves[name] = np.array(found[name])
    along = {
        f"two_point_axis_{axis}": np.array(c)
        for axis, c in found["two_point"].items()
        if axis != "radial"
    }
    return curves | along


def _relative(curve: ArrayLike, reference: ArrayLike) -> float:
    reference = np.asarray(reference)
    return float(np.linalg.norm(np.asarray(curve) - reference) / np.linalg.norm(reference))

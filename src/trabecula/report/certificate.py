"""The certificate: every descriptor of an image against the exemplar, and against what the exemplar's own parts
differ by.

The *real band* of a metric is the spread of that metric over equal parts of the exemplar: halves along every axis
that is long enough, eight octants as a rule. A result inside it is no further from the exemplar than the exemplar is
from itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core import progress
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, describe_fields
from trabecula.measure.amount import porosity
from trabecula.measure.correlation import covariance_form
from trabecula.measure.describe import describe_curves, describe_numbers

LEAST_PART = 24
"""A part of fewer voxels a side says little about the material."""

# Numbers that are compared as they are: inside the band of the parts, widened by the exemplar's own value.
_PLAIN = (
    "porosity",
    "specific_surface",
    "mean_curvature",
    "euler_density",
    "chord_length",
    "pore_size",
    "thickness",
    "largest_fraction",
)
# Counts grow with the volume: the band is that of the parts' counts per voxel, times the image's voxels.
_COUNTS = ("components", "floating", "floating_voxels")
# Fewer loose parts than the exemplar has is no fault (a scan has specks): these have one end only.
_AT_LEAST = ("largest_fraction",)
_AT_MOST = _COUNTS


@dataclass(frozen=True)
class Metric:
    """One figure of the certificate."""

    value: Any
    """Number; for `percolates` one truth value per axis; `None` where it does not exist."""
    real_band: tuple[float, float] | None = None
    """The figure's spread between parts of the exemplar; `None` where the exemplar is too small, or no band makes
    sense."""
    passed: bool | None = None
    """Inside the band; `None` where there is nothing to judge by."""
    exemplar: Any = None
    """The exemplar's own value (0 for a distance to it; a count is scaled to the image's volume)."""

    def to_json(self) -> dict[str, Any]:
        """Value, band and verdict by the names that scripts rely on."""
        return {"value": self.value, "real_band": list(self.real_band) if self.real_band else None, "pass": self.passed}


@dataclass(frozen=True)
class Certificate:
    """What `verify` found about one image."""

    metrics: Mapping[str, Metric]
    """By name, the distances to the exemplar first."""
    notes: tuple[str, ...] = ()
    """What to know before believing the figures."""
    name: str = "image"
    curves: Mapping[str, Any] = field(default_factory=dict)
    """By "exemplar", "image" and "parts": the two-point and lineal-path curves that were compared."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """Shape, spacing, unit, phases and recipe of "exemplar" and "image"."""

    @property
    def passed(self) -> bool | None:
        """Whether no metric failed; `None` where none could be judged."""
        verdicts = [metric.passed for metric in self.metrics.values() if metric.passed is not None]
        return all(verdicts) if verdicts else None

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the metrics that failed."""
        return tuple(name for name, metric in self.metrics.items() if metric.passed is False)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON: metrics with value, real_band and pass; the verdict; notes."""
        metrics = {name: metric.to_json() for name, metric in self.metrics.items()}
        return {"metrics": metrics, "passed": self.passed, "notes": list(self.notes)}

    def to_table(self) -> str:
        """A table for a terminal."""
        from trabecula.report.table import table

        return table(self)

    def to_html(
        self, path: str | Path | None = None, *, pictures: Iterable[tuple[str, str | Path | bytes]] = ()
    ) -> str:
        """One self-contained page; written to `path` where one is given.

        Parameters
        ----------
        path : str or Path, optional
        pictures : iterable of (caption, PNG file or its bytes), optional
            Shown side by side, and kept in the page.

        Returns
        -------
        html : str
        """
        from trabecula.report.page import page, write_page

        html = page([self], pictures=pictures)
        if path is not None:
            write_page(html, path)
        return html


@overload
def verify(
    exemplar: Image | ArrayLike, image: Image | ArrayLike, /, *, r_max: int = ..., names: Sequence[str] | None = ...
) -> Certificate: ...


@overload
def verify(
    exemplar: Image | ArrayLike, /, *images: Image | ArrayLike, r_max: int = ..., names: Sequence[str] | None = ...
) -> list[Certificate]: ...


def verify(
    exemplar: Image | ArrayLike, /, *images: Image | ArrayLike, r_max: int = 50, names: Sequence[str] | None = None
) -> Certificate | list[Certificate]:
    """Judge whether images are of the same material as the exemplar.

    Parameters
    ----------
    exemplar, *images : Image or array of labels, (Z, Y, X) or (Y, X)
        Of the same phases, spacing and unit; sizes may differ.
    r_max : int
        Largest distance of the curves in voxels; lowered to half the smallest side of either image, and to what fits
        into a part of the exemplar.
    names : sequence of str, optional
        What to call the images.

    Returns
    -------
    certificate : Certificate, or a list of them for several images

    Raises
    ------
    InputError
        No image; phases, spacing, unit or dimensions that do not correspond; an exemplar of one phase only.

    Notes
    -----
    Distances to the exemplar: `porosity_error` = abs(phi - phi_e) / phi_e; over the radial S2 of the solid,
    `two_point_distance` = the l2 norm of the difference for r = 1 .. r_max, `two_point_relative` = the norm over
    that of the exemplar for r = 0 .. r_max, `two_point_covariance` = the same of (S2 - phi^2) / (phi - phi^2),
    `two_point_axial` = the largest of that along an axis; `lineal_path_distance` = relative l2 of the lineal
    path. They pass below the largest of the parts' distances to the whole.

    Numbers pass inside the spread of the parts, widened by the exemplar's own value. The band of `components`,
    `floating` and `floating_voxels` is scaled to the image's volume; these and `largest_fraction` fail on one side
    only, since fewer loose parts than the exemplar has are no fault. `percolates` fails along an axis where the
    exemplar percolates and the image does not.
    """
    exemplar = as_image(exemplar, name="exemplar")
    check_labels(exemplar, name="exemplar")
    if not images:
        raise InputError("verify needs an image to compare with the exemplar: verify(exemplar, image)")
    if r_max < 1:
        raise InputError(f"r_max {r_max} must be at least 1 voxel")
    if not 0 < porosity(exemplar) < 1:
        raise InputError("the exemplar is all void or holds none: there is nothing to compare; check its threshold")
    others = [as_image(image, name=f"image {n}") for n, image in enumerate(images, start=1)]
    if names is None:
        names = ["image"] if len(others) == 1 else [f"image {n + 1}" for n in range(len(others))]
    if len(names) != len(others):
        raise InputError(f"{len(names)} names for {len(others)} images: give one for each")
    for image, name in zip(others, names, strict=True):
        _check_corresponds(exemplar, image, name)
    reference = _Reference(exemplar, min(r_max, *(min(image.shape) // 2 for image in (exemplar, *others))))
    certificates = [
        reference.judge(image, name)
        for image, name in progress.track(list(zip(others, names, strict=True)), "comparing")
    ]
    return certificates[0] if len(certificates) == 1 else certificates


def _check_corresponds(exemplar: Image, image: Image, name: str) -> None:
    check_labels(image, name=name)
    if image.ndim != exemplar.ndim:
        raise InputError(f"{name} is {image.ndim}-D, the exemplar {exemplar.ndim}-D: compare images of equal dimension")
    if set(image.phases) != set(exemplar.phases):
        raise InputError(
            f"phases do not correspond: {name} has {', '.join(image.phases)}, the exemplar "
            f"{', '.join(exemplar.phases)}; give both the same names (tb.Image(..., phases=...))"
        )
    if image.unit != exemplar.unit or not np.allclose(image.spacing, exemplar.spacing, rtol=1e-4):
        raise InputError(
            f"voxels do not correspond: {name} has {_voxel(image)}, the exemplar {_voxel(exemplar)}; give both their "
            "spacing, or resample one"
        )


def _voxel(image: Image) -> str:
    return f"{' x '.join(f'{edge:g}' for edge in image.spacing)} {image.unit}"


class _Reference:
    """The exemplar and its parts, measured once for all images."""

    def __init__(self, exemplar: Image, r_max: int) -> None:
        self.exemplar = exemplar
        pieces = list(parts(exemplar))
        fits = min((min(piece.shape) - 1 for piece in pieces), default=r_max)
        self.r_max = max(1, min(r_max, fits))
        self.numbers, self.curves = _measured(exemplar, self.r_max)
        measured = [_measured(piece, self.r_max) for piece in progress.track(pieces, "measuring the exemplar's parts")]
        self.part_numbers = [numbers for numbers, _ in measured]
        self.part_curves = [curves for _, curves in measured]
        self.part_distances = [self.distances(*both) for both in measured]
        self.notes = tuple(_notes(exemplar, len(pieces)))

    def distances(self, numbers: Mapping[str, Any], curves: Mapping[str, Any]) -> dict[str, float]:
        """Every distance of an image to the exemplar."""
        radial, own = np.array(curves["two_point"]["radial"]), np.array(self.curves["two_point"]["radial"])
        own_porosity = self.numbers["porosity"]
        axes = [name for name in curves["two_point"] if name != "radial"]

        def form(of: Mapping[str, Any], axis: str) -> np.ndarray:
            return covariance_form(of["two_point"][axis])

        return {
            "porosity_error": abs(numbers["porosity"] - own_porosity) / own_porosity,
            "two_point_distance": float(np.linalg.norm((radial - own)[1:])),
            "two_point_relative": _relative(radial, own),
            "two_point_covariance": _relative(covariance_form(radial), covariance_form(own)),
            "two_point_axial": max(_relative(form(curves, axis), form(self.curves, axis)) for axis in axes),
            "lineal_path_distance": _relative(curves["lineal_path"], self.curves["lineal_path"]),
        }

    def judge(self, image: Image, name: str) -> Certificate:
        """The certificate of one image."""
        numbers, curves = _measured(image, self.r_max)
        metrics = {}
        for key, value in self.distances(numbers, curves).items():
            band = (0.0, max(part[key] for part in self.part_distances)) if self.part_distances else None
            metrics[key] = Metric(value, band, None if band is None else bool(value <= band[1]), 0.0)
        for key in _PLAIN:
            metrics[key] = self._number(key, numbers[key], [part[key] for part in self.part_numbers], self.numbers[key])
        for key in _COUNTS:
            per_part = [part[key] * image.values.size / np.prod(part["shape"]) for part in self.part_numbers]
            own = self.numbers[key] * image.values.size / self.exemplar.values.size
            metrics[key] = self._number(key, numbers[key], per_part, own)
        if len(image.phases) > 2:
            for phase in self.exemplar.phases:
                spread = [part["fractions"][phase] for part in self.part_numbers]
                own = self.numbers["fractions"][phase]
                metrics[f"fraction_{phase}"] = self._number("fraction", numbers["fractions"][phase], spread, own)
        metrics["euler"] = Metric(numbers["euler"], exemplar=self.numbers["euler"])
        holds = all(numbers["percolates"][axis] for axis, through in self.numbers["percolates"].items() if through)
        judged = holds if self.part_numbers else None
        metrics["percolates"] = Metric(numbers["percolates"], None, judged, self.numbers["percolates"])
        return Certificate(
            metrics,
            self.notes + tuple(_image_notes(self.exemplar, image, metrics["floating"])),
            name,
            {"exemplar": self.curves, "image": curves, "parts": self.part_curves},
            {"exemplar": _about(self.exemplar), "image": _about(image)},
        )

    def _number(self, key: str, value: float | None, spread: list[float | None], own: float | None) -> Metric:
        known = [number for number in (*spread, own) if number is not None]
        if not spread or not known:
            return Metric(value, None, None, own)
        low, high = float(min(known)), float(max(known))
        if value is None:
            return Metric(None, (low, high), False, own)
        inside = bool((key in _AT_MOST or value >= low) and (key in _AT_LEAST or value <= high))
        return Metric(value, (low, high), inside, own)


def parts(exemplar: Image) -> Iterable[Image]:
    """Halves of the exemplar along every axis whose halves are long enough; none where no axis is.

    Every part has the same shape: of an odd side the middle slice is left out.
    """
    choices = []
    for side in exemplar.shape:
        half = side // 2
        choices.append([slice(0, half), slice(side - half, side)] if half >= LEAST_PART else [slice(0, side)])
    if all(len(choice) == 1 for choice in choices):
        return
    for box in product(*choices):
        yield Image(
            np.ascontiguousarray(exemplar.values[box]),
            "labels",
            spacing=exemplar.spacing,
            unit=exemplar.unit,
            phases=exemplar.phases,
        )


def _measured(image: Image, r_max: int) -> tuple[dict[str, Any], dict[str, Any]]:
    return describe_numbers(image), describe_curves(image, r_max=r_max)


def _relative(curve: ArrayLike, reference: ArrayLike) -> float:
    reference = np.asarray(reference)
    return float(np.linalg.norm(np.asarray(curve) - reference) / np.linalg.norm(reference))


def _about(image: Image) -> dict[str, Any]:
    return {"shape": list(image.shape), **describe_fields(image)}


def _notes(exemplar: Image, count: int) -> Iterable[str]:
    if count == 0:
        yield (
            f"The exemplar ({_size(exemplar)}) is too small for parts of {LEAST_PART} voxels a side: no band says what "
            "real material differs by, so nothing is judged."
        )
    elif count < 4:
        yield f"The band comes from {count} parts of the exemplar only: it is narrower than the material's own spread."
    bare = [
        f"{end} {axis}"
        for n, axis in enumerate("zyx"[3 - exemplar.ndim :])
        for end, at in (("first", 0), ("last", -1))
        if np.ptp(exemplar.values.take(at, axis=n)) == 0
    ]
    if bare:
        yield (
            f"The outermost slices of the exemplar hold one phase alone ({', '.join(bare)}): a margin of the scan? "
            "Crop them, or they count as material and hide percolation."
        )


def _image_notes(exemplar: Image, image: Image, floating: Metric) -> Iterable[str]:
    if np.prod(image.shape) < np.prod(exemplar.shape) / 8:
        yield "The image is smaller than an eighth of the exemplar: it may leave the band by chance."
    if floating.exemplar > 10 and floating.value < floating.exemplar / 10:
        yield (
            f"The exemplar has {floating.exemplar:.0f} floating parts in this volume, the image {floating.value}. "
            "Specks change mean curvature, Euler number and pore size: to leave them out, verify against "
            "finish.connect(exemplar, reach=0)."
        )


def _size(image: Image) -> str:
    return " x ".join(map(str, image.shape))

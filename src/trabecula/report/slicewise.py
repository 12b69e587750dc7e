"""The certificate of a volume whose exemplar is a picture, or one for each of several views.

Slices of the volume are measured by the same stick as the picture and its parts, and their means
are judged; what only a volume has (connectivity in 3-D, transport) is told and not judged, since no
picture says what it should be.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.components import largest_fraction
from trabecula.measure.describe import describe_numbers
from trabecula.measure.effective_properties import describe_physics, physics_notes
from trabecula.measure.percolation import percolates
from trabecula.report.band import LEAST_PART
from trabecula.report.baseline import gaussian_field
from trabecula.report.descriptors import LabelDescriptors, Measured, TextureDescriptors, numbers_of
from trabecula.report.evenness import local_fractions, choose_windows
from trabecula.report.verdict import Certificate, Metric, about_image
from trabecula.report.metrics import VOLUME, in_order
from trabecula.report.notes import exemplar_notes, span_note
from trabecula.report.planes import SLICES, SlicePlane, check_volume, slice_planes, take_slices
from trabecula.report.reference import Reference, coherence_of
from trabecula.report.slices import SliceStick, reach_of
from trabecula.report.undecided import exemplar_reasons, level_reasons, picture_reason

_TOLD = (
    "components",
    "floating",
    "floating_voxels",
    "largest_fraction",
    "percolates",
    "percolating_fraction",
    "euler_density",
    "euler",
    "thickness",
    "pore_size",
    "anisotropy",
)
_PHYSICS = ("diffusivity", "conductivity", "permeability", "stiffness")
_WORST = (
    *(f"two_point_covariance_{axis}" for axis in "yx"),
    *(f"lineal_path_distance{void}_{axis}" for void in ("", "_void") for axis in "yx"),
    "axis_preference",
    "autocorrelation_distance",
    "texture_preference",
)
"""Of these the worst plane counts: a mean over planes would hide one that is wrong."""

_BY_PLANE = ("porosity", "mean", "two_point_covariance", "histogram_divergence")
"""Told for each plane as well."""


def judge_volumes(
    pictures: Sequence[Image],
    images: Sequence[Image],
    names: Sequence[str],
    *,
    views: Sequence[str],
    r_max: int,
    level: str,
    box: int | None,
) -> list[Certificate]:
    """One certificate for every volume; the parameters are those of `verify`.

    Raises
    ------
    InputError
        Images that are not volumes of the pictures' voxels, or pictures and views that do not fit
        each other.
    """
    faces = slice_planes(pictures, views)
    for image, name in zip(images, names, strict=True):
        check_volume(image, pictures, views, name)
    smallest = min(
        min(min(image.shape) for image in images), *(min(picture.shape) for picture in pictures)
    )
    reach = max(
        1, min(r_max, smallest // 2, *(max(LEAST_PART, min(p.shape) // 2) - 1 for p in pictures))
    )
    judges = [_Judge(face, images, reach, level) for face in faces]
    found = []
    for image, name in progress.track(list(zip(images, names, strict=True)), "comparing"):
        metrics: dict[str, Metric] = {}
        for judge in judges:
            metrics |= judge.judge(image)
        told, details = _of_volume(image, level, box)
        metrics |= told
        about = {"exemplar": about_image(pictures[0]), "image": about_image(image), "level": level}
        about["planes"] = {face.suffix or "all": list(face.planes) for face in faces}
        if details:
            about["physics"] = {"exemplar": {}, "image": details}
        ordered = {name: metrics[name] for name in in_order(metrics)}
        notes = (
            *(note for judge in judges for note in judge.notes()),
            *_volume_notes(ordered, details),
        )
        baseline = {key: m for judge in judges for key, m in judge.baseline.items()} or None
        reasons = [reason for judge in judges for reason in judge.reasons(level)]
        reasons += [picture_reason()] if images[0].kind == "labels" else []
        curves = judges[0].curves(image)
        found.append(
            Certificate(
                ordered, notes, name, curves, about, baseline, tuple(reasons), judges[0].maps(image)
            )
        )
    return found


class _Judge:
    """A picture, measured once, and the planes that are judged by it."""

    def __init__(self, face: SlicePlane, images: Sequence[Image], r_max: int, level: str) -> None:
        self.face, picture = face, face.picture
        labels = picture.kind == "labels"
        cuts = [take_slices(image, plane, 1)[0] for image in images for plane in face.planes]
        windows = choose_windows(picture, cuts)
        inner: Any = TextureDescriptors(picture, lags=min(r_max, 32), windows=windows)
        if labels:
            inner = LabelDescriptors(
                r_max=r_max, level="quick" if level == "quick" else "default", windows=windows
            )
        self.stick = SliceStick(inner, reach=reach_of(picture, r_max))
        self.copying = labels and level != "quick"
        # Counts and shares depend on how much is seen at once: parts of the picture are as large as
        # slices.
        shape = [min(cut.shape[n] for cut in cuts) for n in range(2)]
        self.reference = Reference(picture, self.stick, copying=self.copying, shape=shape)
        self._measured: tuple[Image, Measured] | None = None
        self.field = self.stick.measure(gaussian_field(picture)) if self.copying else None
        self.baseline = self._named(self.reference.judged(self.field)) if self.field else {}

    def judge(self, image: Image) -> dict[str, Metric]:
        """Every figure of a volume's slices, and of single planes those of `_BY_PLANE`."""
        planes = {plane: self.stick.measure_plane(image, plane) for plane in self.face.planes}
        whole = self.stick.mean(list(planes.values()))
        self._measured = image, whole
        found = self.reference.judged(whole)
        each = {plane: self.reference.judged(measured) for plane, measured in planes.items()}
        for name in found:
            if name in _WORST:
                found[name] = max(
                    (metrics[name] for metrics in each.values()), key=lambda metric: metric.value
                )
        if self.copying:
            # Not the middle slice, which may be the picture itself, asked for.
            cuts = [take_slices(image, plane, 2)[0] for plane in self.face.planes]
            shares = [coherence_of(self.face.picture, cut) for cut in cuts]
            known = [share for share in shares if share is not None]
            found["coherence"] = self.reference.judged_coherence(
                float(np.mean(known)) if known else None
            )
        found = self._named(found)
        if len(planes) > 1:
            found |= {
                f"{name}_{plane}": each[plane][name]
                for plane in planes
                for name in _BY_PLANE
                if name in each[plane]
            }
        return found

    def _named(self, metrics: Mapping[str, Metric]) -> dict[str, Metric]:
        suffix = f"_{self.face.suffix}" if self.face.suffix else ""
        return {name + suffix: metric for name, metric in metrics.items()}

    def curves(self, image: Image) -> dict[str, Any]:
        """Of the picture, the slices of the image that was judged last, the picture's parts and the
        baseline.
        """
        reference = self.reference
        found = {
            "exemplar": reference.own.curves,
            "parts": [part.curves for part in reference.parts],
        }
        found["image"] = (
            self._measured[1].curves if self._measured and self._measured[0] is image else {}
        )
        return found | ({"baseline": self.field.curves} if self.field else {})

    def maps(self, image: Image) -> dict[str, Any]:
        """Return local fractions of the picture and of the first slice of the image that was judged
        last.
        """
        measured = self._measured[1] if self._measured and self._measured[0] is image else None
        found = {"exemplar": self.reference.own, "image": measured}
        return {
            who: local_fractions(each)
            for who, each in found.items()
            if each is not None and each.cells is not None
        }

    def reasons(self, level: str) -> Iterable[str]:
        """Return what the picture cannot decide."""
        yield from exemplar_reasons(self.reference, what=self._what()[0].lower() + self._what()[1:])
        yield from level_reasons(self.reference, level, self.baseline or None, {})

    def _what(self) -> str:
        return (
            f"The picture of {' and '.join(self.face.planes)}"
            if self.face.suffix
            else "The picture"
        )

    def notes(self) -> Iterable[str]:
        """Return what to know of the picture."""
        return exemplar_notes(self.reference, what=self._what())


def _of_volume(
    image: Image, level: str, box: int | None
) -> tuple[dict[str, Metric], dict[str, Any]]:
    """What is told of the volume as such, and what there is to say of its solvers."""
    if image.kind != "labels":
        return {}, {}
    details = describe_physics(image, box=box, halving=True) if level == "full" else {}
    numbers = numbers_of(describe_numbers(image, level=level), details, level)
    named = {
        name: numbers[name] for name in numbers if name in _TOLD or name.split("_")[0] in _PHYSICS
    }
    told = {
        f"{name}_{VOLUME}" if name in _TOLD else _with_volume(name): value
        for name, value in named.items()
    }
    told |= {
        f"largest_fraction_{VOLUME}_void": largest_fraction(image, phase="void"),
        f"percolates_{VOLUME}_void": percolates(image, phase="void"),
    }
    return {name: Metric(value) for name, value in told.items()}, details


def _with_volume(name: str) -> str:
    stem, _, axis = name.partition("_")
    return f"{stem}_{VOLUME}" + (f"_{axis}" if axis else "")


def _volume_notes(metrics: Mapping[str, Metric], details: Mapping[str, Any]) -> Iterable[str]:
    yield (
        f"The exemplar is a picture: at most {SLICES} slices a plane are judged by it. Figures in 3-D are told and not "
        "judged, for no picture says what they should be."
    )
    if f"percolates_{VOLUME}" in metrics:
        yield from span_note(metrics[f"percolates_{VOLUME}"])
    yield from physics_notes(details)


def check_pictures(pictures: Sequence[Image]) -> None:
    """Raise where several exemplars are not pictures of one kind.

    Raises
    ------
    InputError
        A volume among several exemplars; kinds or phases that differ.
    """
    first = pictures[0]
    for picture in pictures:
        if picture.ndim != 2 and len(pictures) > 1:
            raise InputError(
                f"several exemplars are pictures, one is {picture.ndim}-D: give one volume, or pictures"
            )
        if picture.kind != first.kind or set(picture.phases) != set(first.phases):
            raise InputError(
                f"pictures of one material agree in kind and phases: got {first.kind} {'/'.join(first.phases)} and "
                f"{picture.kind} {'/'.join(picture.phases)}; segment or name them alike"
            )

"""The certificate of a volume whose exemplar is a picture, or one for each of several views.

Slices of the volume are measured as the picture and its parts are, and their means are judged.
Figures that only a volume has are judged by what slices imply (`report.stereology`); where slices
imply nothing they are reported, and the certificate says that the picture does not decide them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.image import Image
from trabecula.exemplar.sections import gap_contradiction
from trabecula.exemplar.views import SLICES, take_slices
from trabecula.measure.describe import describe_numbers
from trabecula.measure.effective_properties import describe_physics, physics_notes
from trabecula.measure.registry import DESCRIPTORS
from trabecula.report.band import part_boxes
from trabecula.report.baseline import gaussian_field
from trabecula.report.cell_sections import judge_cells
from trabecula.report.compatibility import check_volume
from trabecula.report.decidability import exemplar_reasons, level_reasons, picture_reason
from trabecula.report.descriptors import (
    LabelDescriptors,
    Measurements,
    TextureDescriptors,
    flat_numbers,
)
from trabecula.report.evenness import choose_windows, local_fractions
from trabecula.report.metrics import VOLUME, Metric, in_order, stem
from trabecula.report.notes import exemplar_notes, span_note
from trabecula.report.planes import SliceDescriptors, SlicePlane, reach_of, slice_planes
from trabecula.report.reference import Reference, try_coherence
from trabecula.report.sections import FIGURE, SectionJudge
from trabecula.report.stereology import (
    Joined,
    beyond,
    implied_notes,
    joined_in,
    judge_connections,
    judge_isotropy,
    void_figures,
)
from trabecula.report.verdict import Certificate, about_image


def judge_volumes(
    pictures: Sequence[Image],
    images: Sequence[Image],
    names: Sequence[str],
    *,
    views: Sequence[str],
    gap: int,
    r_max: int,
    level: str,
    box: int | None,
) -> list[Certificate]:
    """Judge volumes by pictures, with a certificate each; the parameters are those of `verify`.

    Raises
    ------
    InputError
        Images that are not volumes of the pictures' voxels; pictures, views and gap that do not fit
        each other.
    """
    sections = pictures if gap else ()
    planes = slice_planes(pictures, views, gap=gap)
    contradiction, by_sections = None, None
    if sections:
        contradiction = gap_contradiction(sections, gap)
        if sections[0].kind == "labels":
            by_sections = SectionJudge(sections, gap, trusted=contradiction is None)
    pictures = [plane.picture for plane in planes]
    for image, name in zip(images, names, strict=True):
        check_volume(image, pictures, views, name)
    smallest = min(
        min(min(image.shape) for image in images), *(min(picture.shape) for picture in pictures)
    )
    boxes = [box for picture in pictures for box in part_boxes(picture.shape)]
    fits = [each.stop - each.start - 1 for box in boxes for each in box]
    reach = max(1, min(r_max, smallest // 2, *fits))
    judges = [_Judge(plane, images, reach, level) for plane in planes]
    found = []
    for image, name in progress.track(list(zip(images, names, strict=True)), "comparing"):
        metrics: dict[str, Metric] = {}
        for judge in judges:
            metrics |= judge.judge(image)
        whole, details = _measure_volume(image, level, box)
        metrics |= whole
        if by_sections is not None:
            metrics |= by_sections.judge(image)
        joined: dict[str, Joined] = {}
        for judge in judges if whole else []:
            for ending, phase in judge.joined().items():
                joined[ending] = phase.union(joined.get(ending, Joined()))
        metrics |= judge_connections(joined, metrics)
        about = {"exemplar": about_image(pictures[0]), "image": about_image(image), "level": level}
        about["planes"] = {plane.suffix or "all": list(plane.planes) for plane in planes}
        if details:
            about["physics"] = {"exemplar": {}, "image": details}
        ordered = {name: metrics[name] for name in in_order(metrics)}
        own_notes = (note for judge in judges for note in judge.notes())
        notes = (*own_notes, *_volume_notes(ordered, joined, details))
        judged = FIGURE in ordered and ordered[FIGURE].passed is not None
        if sections:
            about["sections"] = {"count": len(sections), "gap": gap}
            notes = (*notes, _sections_note(len(sections), gap, judged=judged))
        baseline = {key: m for judge in judges for key, m in judge.baseline.items()} or None
        reasons = [picture_reason()] if joined else []
        reasons += [contradiction] if contradiction else []
        reasons += [reason for judge in judges for reason in judge.reasons(level)]
        found.append(
            Certificate(
                ordered,
                notes,
                name,
                judges[0].curves(image),
                about,
                baseline,
                tuple(reasons),
                judges[0].maps(image),
                tuple(beyond(joined, ordered, sections=judged)) if joined else (),
            )
        )
    return found


class _Judge:
    """A picture, measured once, and the planes that are judged by it."""

    def __init__(self, own: SlicePlane, images: Sequence[Image], r_max: int, level: str) -> None:
        self.own, picture = own, own.picture
        labels = picture.kind == "labels"
        cuts = [take_slices(image, plane, 1)[0] for image in images for plane in own.planes]
        windows = choose_windows(picture, cuts)
        inner: Any = TextureDescriptors(picture, lags=min(r_max, 32), windows=windows)
        if labels:
            inner = LabelDescriptors(
                r_max=r_max, level="quick" if level == "quick" else "default", windows=windows
            )
        self.descriptors = SliceDescriptors(inner, reach=reach_of(picture, r_max))
        self.copying = labels and level != "quick"
        # Counts and shares depend on how much is seen at once: parts of the picture are as large as
        # slices.
        self.shape = [min(cut.shape[n] for cut in cuts) for n in range(2)]
        self.reference = Reference(
            picture, self.descriptors, copying=self.copying, shape=self.shape
        )
        self._measured: tuple[Image, Measurements] | None = None
        self.field = self.descriptors.measure(gaussian_field(picture)) if self.copying else None
        self.baseline = {}
        if self.field:
            self.baseline = self._rename(self.reference.judge_measurements(self.field))

    def judge(self, image: Image) -> dict[str, Metric]:
        """Judge every figure of a volume's slices, and some of single planes."""
        planes = {plane: self.descriptors.measure_plane(image, plane) for plane in self.own.planes}
        whole = self.descriptors.mean(list(planes.values()))
        self._measured = image, whole
        found = self.reference.judge_measurements(whole)
        each = {
            plane: self.reference.judge_measurements(measured) for plane, measured in planes.items()
        }
        for name in found:
            if _is_worst_plane(name):
                found[name] = max(
                    (metrics[name] for metrics in each.values()), key=lambda metric: metric.value
                )
        if self.copying:
            # Not the middle slice, which may be the picture itself, asked for.
            cuts = [take_slices(image, plane, 2)[0] for plane in self.own.planes]
            shares = [try_coherence(self.own.picture, cut) for cut in cuts]
            known = [share for share in shares if share is not None]
            found["coherence"] = self.reference.judge_coherence(
                float(np.mean(known)) if known else None
            )
        if image.kind == "labels":
            found |= judge_cells(self.reference, self.own.planes, image, whole)
        found = self._rename(found)
        if len(planes) > 1:
            found |= {
                f"{name}_{plane}": each[plane][name]
                for plane in planes
                for name, descriptor in DESCRIPTORS.items()
                if descriptor.by_plane and name in each[plane]
            }
        if image.kind == "labels" and not self.own.suffix and len(planes) == 3:
            found |= judge_isotropy(self.reference, image, whole, planes)
        return found

    def joined(self) -> dict[str, Joined]:
        """Return the connections in the picture, for slices of the image that was judged last."""
        assert self._measured is not None
        return joined_in(self.reference, self.own.planes, self._measured[1], self.shape)

    def _rename(self, metrics: Mapping[str, Metric]) -> dict[str, Metric]:
        suffix = f"_{self.own.suffix}" if self.own.suffix else ""
        return {name + suffix: metric for name, metric in metrics.items()}

    def curves(self, image: Image) -> dict[str, Any]:
        """Return the curves of the picture, of the slices of the image that was judged last, of the
        picture's parts and of the baseline.
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
        """Yield the reasons why the picture cannot decide."""
        title = self._title()
        yield from exemplar_reasons(self.reference, what=title[0].lower() + title[1:])
        yield from level_reasons(self.reference, level, self.baseline or None, {})

    def _title(self) -> str:
        return (
            f"The picture of {' and '.join(self.own.planes)}" if self.own.suffix else "The picture"
        )

    def notes(self) -> Iterable[str]:
        """Return the notes on the picture."""
        return exemplar_notes(self.reference, what=self._title())


def _is_worst_plane(name: str) -> bool:
    """Return whether the worst plane counts for a figure, and not the mean over planes."""
    base = stem(name)
    return name[len(base) :] in DESCRIPTORS[base].worst


def _measure_volume(
    image: Image, level: str, box: int | None
) -> tuple[dict[str, Metric], dict[str, Any]]:
    """Measure the figures that are reported of the volume itself, and details of its solvers."""
    if image.kind != "labels":
        return {}, {}
    details = describe_physics(image, box=box, halving=True) if level == "full" else {}
    numbers = flat_numbers(describe_numbers(image, level=level), details, level)
    found = {
        f"{stem(name)}_{VOLUME}{name[len(stem(name)) :]}": value
        for name, value in numbers.items()
        if DESCRIPTORS[stem(name)].in_volume
    }
    return {name: Metric(value) for name, value in found.items()} | void_figures(image), details


def _sections_note(count: int, gap: int, *, judged: bool) -> str:
    if not judged:
        return (
            f"Slices are judged by the first of the {count} sections. The Euler number is not: "
            "that takes labels, sections with room for parts, a volume longer than the gap, and a "
            "gap that nothing contradicts."
        )
    return (
        f"The Euler number of the solid is judged by {count} sections that are {gap} voxels from "
        "one to the next, slices by the first of them. The volume is measured from slices as far "
        "apart: both miss what is thinner."
    )


def _volume_notes(
    metrics: Mapping[str, Metric], joined: Mapping[str, Joined], details: Mapping[str, Any]
) -> Iterable[str]:
    yield (
        f"The exemplar is a picture: at most {SLICES} slices a plane are judged by it. Figures in "
        "3-D are judged where slices imply them; the others are reported and not judged."
    )
    yield from implied_notes(joined, metrics)
    if f"percolates_{VOLUME}" in metrics:
        yield from span_note(metrics[f"percolates_{VOLUME}"])
    yield from physics_notes(details)

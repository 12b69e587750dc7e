"""What to know before believing the figures of a certificate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.correlation import decay_length
from trabecula.measure.physics import physics_notes
from trabecula.report.band import LEAST_PART
from trabecula.report.metric import Metric
from trabecula.report.reference import Reference
from trabecula.report.sticks import Measured

LONG_RANGE = 6
"""An exemplar shorter than this many correlation lengths holds too little of its material to judge by."""


def exemplar_notes(reference: Reference, *, what: str = "The exemplar") -> Iterable[str]:
    """Of an exemplar: its size, the range of its correlation, bare margins."""
    exemplar = reference.exemplar
    yield from _part_notes(reference, what)
    if exemplar.kind == "labels":
        yield from _range_note(exemplar, reference.own, what)
    if reference.own.details and reference.parts:
        yield (
            f"Transport and stiffness of the parts are those of boxes of at most {_size(reference.parts[0])} voxels: cut "
            "struts bear nothing, so the band of stiffness lies low."
        )
    bare = [
        f"{end} {axis}"
        for n, axis in enumerate("zyx"[3 - exemplar.ndim :])
        for end, at in (("first", 0), ("last", -1))
        if np.ptp(exemplar.values.take(at, axis=n)) == 0
    ]
    if bare:
        yield (
            f"The outermost slices of {what[0].lower()}{what[1:]} hold one phase alone ({', '.join(bare)}): a margin of the "
            "scan? Crop them, or they count as material and hide percolation."
        )


def _part_notes(reference: Reference, what: str) -> Iterable[str]:
    count = len(reference.parts)
    if count == 0:
        yield (
            f"{what} ({_size(reference.exemplar)}) is too small for parts of {LEAST_PART} voxels a side: no band says what "
            "real material differs by, so nothing is judged."
        )
    elif count < 4:
        yield (
            f"The band comes from {count} parts of {what[0].lower()}{what[1:]} only: it is narrower than the material's own "
            "spread."
        )


def _range_note(exemplar: Image, own: Measured, what: str) -> Iterable[str]:
    length = decay_length(own.curves["two_point"])
    shortest = min(np.array(exemplar.shape) * np.array(exemplar.spacing)) / min(exemplar.spacing)
    if shortest < LONG_RANGE * length:
        reach = f"over {length:.0f} voxels" if np.isfinite(length) else "further than the curves run"
        yield (
            f"{what} is correlated {reach}, its shortest side is {shortest:.0f}: it holds too little of the "
            "material to say what is typical; bands are wide, and a larger scan may differ from all of this."
        )


def image_notes(exemplar: Image, image: Image, metrics: Mapping[str, Metric], measured: Measured) -> Iterable[str]:
    """Of an image that is judged: its size, specks, what does not span it, solvers."""
    if np.prod(image.shape) < np.prod(exemplar.shape) / 8:
        yield "The image is smaller than an eighth of the exemplar: it may leave the band by chance."
    if exemplar.kind != "labels":
        return
    floating = metrics["floating"]
    if floating.exemplar > 10 and floating.value < floating.exemplar / 10:
        yield (
            f"The exemplar has {floating.exemplar:.0f} floating parts in this volume, the image {floating.value}. "
            "Specks change mean curvature, Euler number and pore size: to leave them out, verify against "
            "finish.connect(exemplar, reach=0)."
        )
    yield from span_note(metrics["percolates"])
    yield from physics_notes(measured.details)


def span_note(percolates: Metric) -> Iterable[str]:
    """Along which axes no solid spans."""
    broken: Sequence[str] = [axis for axis, holds in percolates.value.items() if not holds]
    if broken:
        yield f"The solid does not span the image along {', '.join(broken)}."


def _size(image: Image | Measured) -> str:
    return " x ".join(map(str, image.shape))

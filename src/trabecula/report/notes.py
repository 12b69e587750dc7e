"""Notes to a certificate: facts to know before believing its figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.margins import margin_note
from trabecula.measure.effective_properties import physics_notes
from trabecula.report.band import CONFIDENCE
from trabecula.report.descriptors import Measurements
from trabecula.report.evenness import windows_note
from trabecula.report.metrics import Metric
from trabecula.report.reference import Reference


def exemplar_notes(reference: Reference, *, what: str = "The exemplar") -> Iterable[str]:
    """Yield the notes on an exemplar: its parts, the windows, bare margins."""
    exemplar = reference.exemplar
    if reference.parts:
        yield (
            f"Bands come from {len(reference.parts)} parts of {_size(reference.parts[0])} voxels, "
            f"extrapolated to the size of the image: {CONFIDENCE:.0%} of other samples of the "
            "material lie inside each."
        )
    if reference.own.evenness:
        yield windows_note(reference.own.evenness, exemplar.unit)
    if reference.own.details and reference.parts:
        yield (
            "Transport and stiffness of the parts are those of boxes of at most "
            f"{_size(reference.parts[0])} voxels: cut struts bear nothing, so the band of "
            "stiffness "
            "lies low."
        )
    margin = margin_note(exemplar)
    if margin:
        yield f"{what}: {margin}"


def image_notes(
    exemplar: Image, image: Image, metrics: Mapping[str, Metric], measured: Measurements
) -> Iterable[str]:
    """Yield the notes on an image that is judged: its size, specks, percolation, solvers."""
    if np.prod(image.shape) < np.prod(exemplar.shape) / 8:
        yield (
            "The image is smaller than an eighth of the exemplar: it may leave the band by chance."
        )
    if exemplar.kind != "labels":
        return
    floating = metrics["floating"]
    if floating.exemplar > 10 and floating.value < floating.exemplar / 10:
        yield (
            f"The exemplar has {floating.exemplar:.0f} floating parts in this volume, the image "
            f"{floating.value}. Specks change mean curvature, Euler number and pore size: to leave "
            "them out, verify against finish.connect(exemplar, reach=0)."
        )
    yield from span_note(metrics["percolates"])
    yield from physics_notes(measured.details)


def span_note(percolates: Metric) -> Iterable[str]:
    """Yield a note on the axes along which no solid spans the image."""
    broken: Sequence[str] = [axis for axis, holds in percolates.value.items() if not holds]
    if broken:
        yield f"The solid does not span the image along {', '.join(broken)}."


def _size(image: Image | Measurements) -> str:
    return " x ".join(map(str, image.shape))

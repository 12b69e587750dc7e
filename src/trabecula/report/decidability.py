"""Decidability: what a certificate will be able to decide, said before anything is made, and why
one decides nothing even where no figure fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.correlation import decay_length
from trabecula.report.band import LEAST_COUNT, LEAST_PART, LONG_RANGE, part_boxes
from trabecula.report.metrics import Metric
from trabecula.report.reference import Reference
from trabecula.report.stationarity import Stationarity, find_trends
from trabecula.report.structure import lengths_along_axes
from trabecula.report.trend_text import trend_advice, trend_text


@dataclass(frozen=True)
class Decidable:
    """The scope of a certificate.

    Attributes
    ----------
    parts : int
        Of the exemplar, that give the bands; 1 where it cannot be cut, so that nothing can be
        decided.
    part : tuple of int
        Voxels of a part.
    figures : str
        What is judged by the bands.
    limits : tuple of str
        What is not decided, a sentence each.
    """

    parts: int
    part: tuple[int, ...]
    figures: str
    limits: tuple[str, ...]

    @property
    def anything(self) -> bool:
        """Return whether there are bands."""
        return self.parts > 1

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        return {
            "anything": self.anything,
            "parts": self.parts,
            "part": list(self.part),
            "figures": self.figures,
            "limits": list(self.limits),
        }


def find_decidable(image: Image, lengths: Sequence[float], stationarity: Stationarity) -> Decidable:
    """Find the scope of a certificate for an exemplar, as it is learnt from.

    Parameters
    ----------
    image : Image
    lengths : sequence of float
        Correlation length along every axis, voxels.
    stationarity : Stationarity
    """
    boxes = part_boxes(image.shape)
    if not boxes:
        size = " x ".join(map(str, image.shape))
        reason = (
            f"{size} is too small for parts of {LEAST_PART} voxels a side, so no band says what "
            f"real material differs by: a side of {2 * LEAST_PART} is the least"
        )
        return Decidable(1, image.shape, "nothing", (reason,))
    figures = "fractions, correlations, sizes and connectivity"
    figures = figures if image.kind == "labels" else "textures"
    part = tuple(each.stop - each.start for each in boxes[0])
    limits = tuple(_limits(image, lengths, stationarity, len(boxes)))
    return Decidable(len(boxes), part, figures + (" in slices" if image.ndim == 2 else ""), limits)


def _limits(
    image: Image, lengths: Sequence[float], stationarity: Stationarity, parts: int
) -> list[str]:
    found = []
    if parts < LEAST_COUNT:
        found.append(
            f"how much real material differs from itself: {parts} parts are too few to know it"
        )
    sizes = [
        side / length if length > 0 else np.inf
        for side, length in zip(image.shape, lengths, strict=True)
    ]
    short = ["zyx"[n + 3 - image.ndim] for n, size in enumerate(sizes) if size < LONG_RANGE]
    if short:
        found.append(
            f"what is typical along {', '.join(short)}: the side has fewer than {LONG_RANGE} "
            "correlation lengths, bands are wide"
        )
    if stationarity.stationary is None:
        found.append("whether the scan is the same all over: too few independent windows")
    elif not stationarity.stationary:
        field = "" if image.ndim == 2 else ", or make it with a target field"
        found.append(
            "a pass: the scan has a trend itself, so that it is no sample of one material; crop an "
            f"even part{field}"
        )
    if image.ndim == 2:
        found.append(
            "what no slice shows: whether components are joined in space, transport, stiffness"
        )
    return found


def exemplar_reasons(reference: Reference, *, what: str = "the exemplar") -> Iterator[str]:
    """Yield the reasons why an exemplar cannot decide: too few parts, too few correlation lengths,
    a trend of its own.
    """
    exemplar = reference.exemplar
    count = len(reference.parts)
    if count < LEAST_COUNT:
        size = " x ".join(map(str, exemplar.shape))
        yield (
            f"{what} ({size}) is too small to say what real material differs by: it holds {count} "
            f"parts of {LEAST_PART} voxels a side, {LEAST_COUNT} are needed"
        )
    if exemplar.kind == "labels":
        length = decay_length(reference.own.curves["two_point"])
        shortest = min(np.array(exemplar.shape) * np.array(exemplar.spacing)) / min(
            exemplar.spacing
        )
        if shortest < LONG_RANGE * length:
            known = np.isfinite(length)
            reach = f"over {length:.0f} voxels" if known else "further than the curves run"
            yield (
                f"{what} is correlated {reach} and only {shortest:.0f} wide: it may be no typical "
                "part of its material"
            )
    yield from trend_reasons(exemplar, what=what)


def trend_reasons(exemplar: Image, *, what: str = "the exemplar") -> Iterator[str]:
    """Yield a reason for the surest trend of every quantity that has one."""
    for trend in find_trends(exemplar, lengths_along_axes(exemplar)).surest:
        yield (
            f"{what} is not stationary, its {trend_text(trend)}: one part of it is no sample of "
            f"another; {trend_advice(trend, exemplar.ndim)}"
        )


def picture_reason() -> str:
    """Return the reason why no picture decides on connections."""
    return (
        "connections in space cannot be seen in a picture: figures in 3-D are judged only where "
        "slices imply them"
    )


def level_reasons(
    reference: Reference,
    level: str,
    baseline: Mapping[str, Metric] | None,
    metrics: Mapping[str, Metric],
) -> Iterator[str]:
    """Yield the reasons that follow from the level: not examined, or examined in vain."""
    if reference.exemplar.kind != "labels":
        yield (
            "sizes, connections and copying of grey and colour images are not examined: segment "
            "them to judge those"
        )
    elif level == "quick":
        yield (
            'at level "quick" neither copying nor a baseline is examined: a copy or noise may pass '
            "as well"
        )
    if baseline is not None and all(metric.passed is not False for metric in baseline.values()):
        yield (
            "a thresholded Gaussian field with the exemplar's fractions and two-point function "
            "passes every figure as well: they cannot tell this material from noise"
        )
    coherence = metrics.get("coherence")
    if coherence is not None and coherence.passed is None:
        yield "copying could not be examined: the images are too small or too plain for it"

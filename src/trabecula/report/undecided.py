"""Why a certificate decides nothing even where no figure fails."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from trabecula.measure.correlation import decay_length
from trabecula.report.band import LEAST_COUNT, LEAST_PART, LONG_RANGE
from trabecula.report.verdict import Metric
from trabecula.report.reference import Reference
from trabecula.report.stationarity import find_trends
from trabecula.report.structure import structure_of

_ALONG = {
    "z": "along z",
    "y": "along y",
    "x": "along x",
    "centre to rim": "from its centre to its rim",
}


def exemplar_reasons(reference: Reference, *, what: str = "the exemplar") -> Iterator[str]:
    """Yield what an exemplar cannot decide: too few parts, too few correlation lengths, a trend of
    its own.
    """
    exemplar = reference.exemplar
    count = len(reference.parts)
    if count < LEAST_COUNT:
        size = " x ".join(map(str, exemplar.shape))
        yield (
            f"{what} ({size}) is too small to say what real material differs by: it holds {count} parts of {LEAST_PART} voxels a "
            f"side, {LEAST_COUNT} are needed"
        )
    if exemplar.kind == "labels":
        length = decay_length(reference.own.curves["two_point"])
        shortest = min(np.array(exemplar.shape) * np.array(exemplar.spacing)) / min(
            exemplar.spacing
        )
        if shortest < LONG_RANGE * length:
            reach = (
                f"over {length:.0f} voxels"
                if np.isfinite(length)
                else "further than the curves run"
            )
            yield f"{what} is correlated {reach} and only {shortest:.0f} wide: it may be no typical piece of its material"
    named = exemplar.kind != "labels" or "void" in exemplar.phases
    for trend in find_trends(exemplar, structure_of(exemplar).lengths).trends if named else ():
        if trend.found:
            what_changes = "fraction of solid" if exemplar.kind == "labels" else "mean value"
            yield (
                f"{what} is not stationary, its {what_changes} runs from {trend.start:.3g} to {trend.end:.3g} "
                f"{_ALONG[trend.name]}: one part of it is no sample of another (crop it, or give the trend as a --target)"
            )


def picture_reason() -> str:
    """Return what no picture decides."""
    return "connections in space cannot be seen in a picture: figures in 3-D are reported and not judged"


def level_reasons(
    reference: Reference,
    level: str,
    baseline: Mapping[str, Metric] | None,
    metrics: Mapping[str, Metric],
) -> Iterator[str]:
    """Yield what was not examined, or examined in vain."""
    if reference.exemplar.kind != "labels":
        yield "sizes, connections and copying of grey and colour images are not examined: segment them to judge those"
    elif level == "quick":
        yield 'at level "quick" neither copying nor a baseline is examined: a copy or noise may pass as well'
    if baseline is not None and all(metric.passed is not False for metric in baseline.values()):
        yield (
            "a thresholded Gaussian field with the exemplar's fractions and two-point function passes every figure as well: "
            "they cannot tell this material from noise"
        )
    coherence = metrics.get("coherence")
    if coherence is not None and coherence.passed is None:
        yield "copying could not be examined: the images are too small or too plain for it"

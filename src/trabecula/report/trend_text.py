"""Trends in words: what changes where, and what can be done about it."""

from __future__ import annotations

from trabecula.core.image import Image, with_values
from trabecula.exemplar.margins import crop_margins
from trabecula.measure.centre_crop import centre_box
from trabecula.report.stationarity import Trend, find_trends
from trabecula.report.structure import lengths_along_axes

_ALONG = {
    "z": "along z",
    "y": "along y",
    "x": "along x",
    "centre to rim": "from its centre to its rim",
}

NOTE_BOX = {2: 4096, 3: 256}
"""Edge of the centre box, voxels, that a note looks at."""


def trend_text(trend: Trend) -> str:
    """Return what changes, between which numbers, and where."""
    ends = f"{_number(trend.start)} to {_number(trend.end)}"
    where = _ALONG[trend.name]
    if trend.what == "direction":
        return (
            f"direction changes {where} (the share of the surface that faces one way runs from "
            f"{ends})"
        )
    if trend.what == "size":
        return f"size changes {where} (mean chord of the solid at equal fraction: {ends} voxels)"
    return f"{trend.what} runs from {ends} {where}"


def trend_advice(trend: Trend, ndim: int) -> str:
    """Return what a trend leaves to do."""
    if ndim == 2 or trend.what in ("direction", "mean value"):
        return "crop an even part (--crop)"
    if trend.what == "size":
        return (
            "crop an even part (--crop), or give the local surface as a target (trabecula field "
            "measure --name surface, tb.fields.measure)"
        )
    name = (
        "" if trend.what == "fraction of solid" else f":{trend.what.removeprefix('fraction of ')}"
    )
    option = f" --name volume_fraction{name}" if name else ""
    return (
        "crop an even part (--crop), or give the trend as a target (trabecula field "
        f"measure{option}, tb.fields.measure)"
    )


def trend_note(image: Image) -> str | None:
    """Say in a line that an image is not stationary, by its surest trend; None where no trend is
    found.

    It takes a fraction of a second: larger images are judged by their centre.
    """
    inner = crop_margins(image)
    side = NOTE_BOX[inner.ndim]
    if max(inner.shape) > side:
        values = centre_box(inner.values, side)
        inner = with_values(inner, values)
    if min(inner.shape) < 4:
        return None
    found = find_trends(inner, lengths_along_axes(inner)).surest
    if not found:
        return None
    surest = found[0]
    return (
        f"not stationary: its {trend_text(surest)}, {surest.errors:.1f} standard errors; one part "
        f"of it is no sample of another: {trend_advice(surest, inner.ndim)}"
    )


def _number(value: float) -> str:
    return f"{value:.3g}"

"""The page of scan sizes: intervals of a material's descriptors, and their spread over windows."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from trabecula.core.image import Image
from trabecula.measure.confidence import Interval, WindowSpread, local_fields, window_spread
from trabecula.measure.registry import DESCRIPTORS
from trabecula.report.page import document
from trabecula.report.plot import curve_plot, key
from trabecula.report.summary_text import number

WIDTHS = (0.1, 0.05, 0.02, 0.01)
"""Relative half-widths of which the page says the size of a scan."""

_SKIPPED = 2
"""First windows of a curve: their spread would flatten all others."""

_LINES = ("by the integral range", "windows of this image")


def size_page(image: Image, intervals: Mapping[str, Interval], *, level: str = "default") -> str:
    """Build one self-contained page of intervals and of the spread over windows.

    Parameters
    ----------
    image : Image of labels
    intervals : mapping of name to Interval
        As `confidence` returns them.
    level : str
        Of the intervals.

    Returns
    -------
    html : str
    """
    figures = [
        _figure(name, local.value, window_spread(image, local), image.unit)
        for name, local in local_fields(image, level=level)
        if intervals[name].half_width is not None and local is not None and local.value
    ]
    extent = " x ".join(
        f"{side * edge:.4g}" for side, edge in zip(image.shape, image.spacing, strict=True)
    )
    return document(
        "How large a scan?",
        [
            "<h1>How large a scan?</h1>",
            f'<p class="about">Image of {extent} {escape(image.unit)}</p>',
            _table(intervals, image.unit),
            f"<h2>Spread over windows</h2>{key(_LINES, band=None)}",
            f'<div class="figures">{"".join(figures)}</div>',
            _reading(),
        ],
    )


def _figure(name: str, value: float, spread: WindowSpread, unit: str) -> str:
    curves = {_LINES[0]: spread.expected, _LINES[1]: spread.measured}
    plot = curve_plot(
        {line: curve[_SKIPPED:] / abs(value) for line, curve in curves.items()},
        title=title_of(name),
        x_label=f"side of the window ({unit})",
        first=(_SKIPPED + 1) * spread.step,
        step=spread.step,
    )
    return f"<figure>{plot}</figure>"


def _table(intervals: Mapping[str, Interval], unit: str) -> str:
    heads = ("value", "from", "to", "half-width", *(f"{width:.0%}" for width in WIDTHS))
    head = "".join(f'<th class="n">{text}</th>' for text in heads)
    rows = []
    for name, interval in intervals.items():
        numbers = (interval.value, interval.low, interval.high)
        relative = "" if interval.relative is None else f"{interval.relative:.1%}"
        sides = [number(interval.side_for(width)) for width in WIDTHS]
        cells = "".join(
            f'<td class="n">{text}</td>' for text in (*map(number, numbers), relative, *sides)
        )
        note = f'<br><span class="soft">{escape(interval.note)}</span>' if interval.note else ""
        rows.append(f"<tr><td>{escape(title_of(name))}{note}</td>{cells}</tr>")
    share = next(iter(intervals.values())).coverage
    return (
        f"<h2>Intervals of {share:.0%}, and the side of a cube ({escape(unit)}) that gives a "
        f"half-width of</h2><table><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def title_of(name: str) -> str:
    """Return the title of an interval by its name, with the phase or axis."""
    stem = next(one for one in (name, *_stems(name)) if one in DESCRIPTORS)
    rest = name[len(stem) :].lstrip("_")
    return DESCRIPTORS[stem].title + (f", {rest}" if rest else "")


def _stems(name: str) -> list[str]:
    words = name.split("_")
    return ["_".join(words[:count]) for count in range(len(words) - 1, 0, -1)]


def _reading() -> str:
    return (
        "<h2>How to read this</h2><p>The material's own value lies in the interval as often as "
        "the heading says, if the material is alike all over the image. A curve is the standard "
        "deviation over windows of one side, over the image's value: the full line from the "
        "covariance of the local field (Matheron's integral range), the dashed line between the "
        "windows that lie side by side in this image. Where the two part, the material varies over "
        "longer distances than the image shows.</p>"
    )

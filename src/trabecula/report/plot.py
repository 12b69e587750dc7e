"""Small SVG figures: curves with a band, and the place of a number in its range. Lines differ by
dashes and not by colour alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike

_WIDTH, _HEIGHT = 380, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 12, 26, 38
IMAGE_LINES = 4
"""Ways to draw the line of an image; more images take them again."""


def curve_plot(
    curves: Mapping[str, ArrayLike],
    *,
    title: str,
    x_label: str,
    band: tuple[ArrayLike, ArrayLike] | None = None,
    first: float = 0.0,
    step: float = 1.0,
    baseline: str | None = None,
) -> str:
    """Draw curves over r = first, first + step, ...: the first full, the others dashed each in its
    way; the band hatched.

    Parameters
    ----------
    curves : mapping of name to array (n,)
    title, x_label : str
    band : (low, high), arrays (n,), optional
    first, step : float
        Place of the first point and distance between points, in the unit of `x_label`.
    baseline : str, optional
        The curve of that name is drawn as the baseline: thin and grey.

    Returns
    -------
    svg : str
        Needs the pattern of `hatching` in the same page.
    """
    lines = {name: np.asarray(curve, np.float64) for name, curve in curves.items()}
    low, high = (
        (np.asarray(edge, np.float64) for edge in band) if band else (np.empty(0), np.empty(0))
    )
    everything = np.concatenate([*lines.values(), low, high])
    bottom, top = min(0.0, everything.min()), max(everything.max(), 1e-12)
    left = min(0.0, first)
    right = first + step * max(1, max(len(line) for line in lines.values()) - 1)
    scale = (_WIDTH - _LEFT - _RIGHT) / (right - left)
    across = np.array([_LEFT - scale * left, scale])
    up = np.array([_HEIGHT - _BOTTOM, -(_HEIGHT - _TOP - _BOTTOM) / (top - bottom)])

    def points(curve: np.ndarray) -> list[str]:
        x = across[0] + across[1] * (first + step * np.arange(len(curve)))
        return [
            f"{a:.1f},{b:.1f}" for a, b in zip(x, up[0] + up[1] * (curve - bottom), strict=True)
        ]

    body = [f'<text class="title" x="{_LEFT}" y="16">{escape(title)}</text>']
    for tick in ticks(bottom, top):
        y = up[0] + up[1] * (tick - bottom)
        body.append(
            f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
        body.append(
            f'<text class="tick" x="{_LEFT - 6}" y="{y + 3.5:.1f}" '
            f'text-anchor="end">{tick:g}</text>'
        )
    for tick in ticks(left, right):
        x = across[0] + across[1] * tick
        body.append(
            f'<text class="tick" x="{x:.1f}" y="{_HEIGHT - 22}" '
            f'text-anchor="middle">{tick:g}</text>'
        )
    body.append(
        f'<text class="tick" x="{_WIDTH - _RIGHT}" y="{_HEIGHT - 6}" '
        f'text-anchor="end">{escape(x_label)}</text>'
    )
    if band:
        body.append(
            f'<polygon class="band" points="{" ".join(points(low) + points(high)[::-1])}"/>'
        )
    for style, line in zip(_styles(list(lines), baseline), lines.values(), strict=True):
        body.append(f'<polyline class="{style}" points="{" ".join(points(line))}"/>')
    return svg(_WIDTH, _HEIGHT, title, body)


def _styles(names: Sequence[str], baseline: str | None) -> list[str]:
    """Return classes of lines: the exemplar's, then one for each image, and the baseline's."""
    images = 0
    styles = ["line0"]
    for name in names[1:]:
        images += name != baseline
        styles.append("baseline" if name == baseline else f"line{1 + (images - 1) % IMAGE_LINES}")
    return styles


def place_plot(values: Sequence[float | None], band: tuple[float, float], own: float | None) -> str:
    """Draw the places of numbers: dots (numbered where several), the band as a hatched bar, the
    exemplar's own number as a tick. An arrow: beyond the figure.
    """
    width, height = 150, 18
    spread = max(band[1] - band[0], 1e-9 * abs(band[1]), 1e-12)
    start, end = band[0] - spread, band[1] + spread

    def x(number: float) -> float:
        return 8 + (width - 16) * (number - start) / (end - start)

    body = [
        f'<line class="grid" x1="0" x2="{width}" y1="9" y2="9"/>',
        f'<rect class="band" x="{x(band[0]):.1f}" y="4" width="{x(band[1]) - x(band[0]):.1f}" '
        'height="10"/>',
    ]
    if own is not None:
        body.append(f'<line class="own" x1="{x(own):.1f}" x2="{x(own):.1f}" y1="1" y2="17"/>')
    for place, value in enumerate(values, start=1):
        if value is not None:
            body.append(_dot(min(max(x(value), 0.0), width), value < start, value > end, width))
            if len(values) > 1:
                at = min(max(x(value), 6.0), width - 6.0)
                body.append(
                    f'<text class="mark" x="{at:.1f}" y="12.3" text-anchor="middle">{place}</text>'
                )
    return svg(width, height, "place in the band", body)


def _dot(at: float, below: bool, above: bool, width: int) -> str:
    if below:
        return '<polygon class="dot" points="0,9 11,3 11,15"/>'
    if above:
        return f'<polygon class="dot" points="{width},9 {width - 11},3 {width - 11},15"/>'
    return f'<circle class="dot" cx="{at:.1f}" cy="9" r="5"/>'


def hatching() -> str:
    """Return the pattern that bands are filled with: once a page."""
    return (
        '<svg width="0" height="0" aria-hidden="true" style="position:absolute"><defs><pattern '
        'id="hatch" width="5" '
        'height="5" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><rect width="5" '
        'height="5" '
        'fill="#eceae4"/><line x1="0" y1="0" x2="0" y2="5" stroke="#b9b4a6" '
        'stroke-width="1.6"/></pattern></defs></svg>'
    )


def key(names: Sequence[str], *, band: str | None, baseline: str | None = None) -> str:
    """Draw the key of the lines, once for all figures of a page."""
    parts = []
    for style, name in zip(_styles(names, baseline), names, strict=True):
        line = f'<line class="{style}" x1="0" x2="36" y1="7" y2="7"/>'
        parts.append(f"<span>{svg(36, 14, name, [line], fixed=True)} {escape(name)}</span>")
    if band:
        swatch = '<rect class="band" x="0" y="1" width="36" height="12"/>'
        parts.append(f"<span>{svg(36, 14, band, [swatch], fixed=True)} {escape(band)}</span>")
    return f'<p class="key">{" ".join(parts)}</p>'


def density_map(values: ArrayLike, *, low: float, high: float, side: float) -> str:
    """Draw a plane of numbers as squares from white (`low`) to dark (`high`).

    Parameters
    ----------
    values : array, (Y, X)
    low, high : float
        Ends of the scale.
    side : float
        Of the longer edge of the drawing, pixels.

    Returns
    -------
    svg : str
    """
    plane = np.asarray(values, np.float64)
    step = max(1, -(-max(plane.shape) // 64))  # coarser than 64 squares a side no eye misses
    plane = plane[::step, ::step]
    rows, columns = plane.shape
    shares = (plane - low) / max(high - low, 1e-12)
    squares = []
    for y in range(rows):
        for x in range(columns):
            red, green, blue = (round(255 - (255 - end) * shares[y, x]) for end in (20, 60, 105))
            squares.append(
                f'<rect x="{x}" y="{y}" width="1.02" height="1.02" '
                f'fill="#{red:02x}{green:02x}{blue:02x}"/>'
            )
    scale = side / max(rows, columns)
    return (
        f'<svg width="{columns * scale:.0f}" height="{rows * scale:.0f}" viewBox="0 0 {columns} '
        f'{rows}" role="img">'
        f"{''.join(squares)}</svg>"
    )


def ticks(low: float, high: float, *, count: int = 5) -> list[float]:
    """Return about `count` round numbers from low to high."""
    if not high > low:
        return [low]
    raw = (high - low) / count
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(size * factor for factor in (1, 2, 2.5, 5, 10) if size * factor >= raw)
    first = math.ceil(low / step - 1e-9)
    return [round(n * step, 12) for n in range(first, math.floor(high / step + 1e-9) + 1)]


def svg(width: int, height: int, label: str, body: Sequence[str], *, fixed: bool = False) -> str:
    """Wrap what is drawn as an SVG figure; small and fixed ones keep their size in pixels."""
    size = f' width="{width}" height="{height}"' if fixed or width < 200 else ""
    return (
        f'<svg viewBox="0 0 {width} {height}"{size} role="img" '
        f'aria-label="{escape(label)}">{"".join(body)}</svg>'
    )

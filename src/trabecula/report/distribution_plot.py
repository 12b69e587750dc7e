"""Small SVG figures of two distributions: their empirical distribution functions, and every value
as a mark below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from statistics import NormalDist

import numpy as np

from trabecula.report.plot import svg, ticks

_WIDTH, _HEIGHT = 380, 264
_LEFT, _RIGHT, _TOP, _BASE = 66, 16, 42, 172
_ROWS = {"real": 194, "members": 216}
"""Heights of the rows of marks, below the distribution functions."""
_REACH = 2.5
"""Real standard deviations about the real mean that are always shown."""

Place = Callable[[float], float]


def distribution_plot(
    members: Sequence[float],
    parts: Sequence[float],
    *,
    band: tuple[float, float],
    real: tuple[float, float],
    title: str,
    verdict: str,
) -> str:
    """Draw the distribution of members beside that of real parts.

    Parameters
    ----------
    members, parts : sequence of float
        Values; where there are no parts, the normal distribution of `real` is drawn.
    band : (low, high)
        Of single real parts; hatched.
    real : (mean, standard deviation)
    title, verdict : str

    Returns
    -------
    svg : str
        Needs the pattern of `hatching` in the same page.
    """
    far = _REACH * real[1]
    low = min(*members, *parts, real[0] - far)
    high = max(*members, *parts, real[0] + far)
    pad = 0.04 * (high - low) or max(abs(low), 1e-12) / 10
    low, high = low - pad, high + pad
    scale = (_WIDTH - _LEFT - _RIGHT) / (high - low)

    def across(value: float) -> float:
        return _LEFT + scale * (value - low)

    start, end = (across(min(max(edge, low), high)) for edge in band)
    body = [
        f'<text class="title" x="8" y="16">{escape(title)}</text>',
        f'<text class="tick" x="{_WIDTH - _RIGHT}" y="34" text-anchor="end">{verdict}</text>',
        f'<rect class="band" x="{start:.1f}" y="{_TOP}" width="{end - start:.1f}" '
        f'height="{_BASE - _TOP}"/>',
        *(_level(share) for share in (0.0, 0.5, 1.0)),
        _line("line0", _steps(parts, low, high) if parts else _normal(real, low, high), across),
        _line("line1", _steps(members, low, high), across),
        *_marks("real", parts, across),
        *_marks("members", members, across),
    ]
    body += [
        f'<text class="tick" x="{across(tick):.1f}" y="{_HEIGHT - 20}" '
        f'text-anchor="middle">{tick:g}</text>'
        for tick in ticks(low, high, count=4)
    ]
    return svg(_WIDTH, _HEIGHT, f"{title}: {verdict}", body)


def _level(share: float) -> str:
    """Draw a line of the grid, and its share."""
    y = _up(share)
    return (
        f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        f'<text class="tick" x="{_LEFT - 8}" y="{y + 3.5:.1f}" text-anchor="end">{share:g}</text>'
    )


def _up(share: float) -> float:
    return _BASE - (_BASE - _TOP) * share


def _line(style: str, points: Sequence[tuple[float, float]], across: Place) -> str:
    text = " ".join(f"{across(value):.1f},{_up(share):.1f}" for value, share in points)
    return f'<polyline class="{style}" points="{text}"/>'


def _steps(values: Sequence[float], low: float, high: float) -> list[tuple[float, float]]:
    """Return the corners of an empirical distribution function."""
    found, count = [(low, 0.0)], len(values)
    for n, value in enumerate(sorted(values)):
        found += [(value, n / count), (value, (n + 1) / count)]
    return [*found, (high, 1.0)]


def _normal(real: tuple[float, float], low: float, high: float) -> list[tuple[float, float]]:
    """Return points of a normal distribution function."""
    if real[1] <= 0:
        return _steps([real[0]], low, high)
    law = NormalDist(*real)
    return [(float(value), law.cdf(value)) for value in np.linspace(low, high, 60)]


def _marks(row: str, values: Sequence[float], across: Place) -> list[str]:
    """Draw a row of marks, one a value."""
    if not values:
        return []
    y = _ROWS[row]
    style = "own" if row == "real" else "made"
    name = f'<text class="tick" x="{_LEFT - 8}" y="{y + 3.5}" text-anchor="end">{row}</text>'
    return [
        name,
        *(
            f'<line class="{style}" x1="{across(value):.1f}" x2="{across(value):.1f}" '
            f'y1="{y - 7}" y2="{y + 7}"/>'
            for value in values
        ),
    ]

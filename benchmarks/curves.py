"""Curves of several volumes in one picture: axes from 0, a name at each end, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw

from trabecula.view.picture import font

WIDE, TALL, LEFT, BELOW, RIGHT = 760, 360, 56, 40, 190
COLOURS = ("#000000", "#1f5fa8", "#c2512b", "#3b8a4e", "#8a4fa3")
COLOURS += ("#b58a1c", "#3aa0a8", "#888888", "#d18fb0", "#7a5230")
SCALE = 2
"""Drawn twice as large, so that lines are smooth once it is halved."""


def draw_curves(curves: Mapping[str, np.ndarray], path: Path, *, along: str, up: str) -> None:
    """Draw curves over 0, 1, 2, ..., the first of them thick."""
    sheet = Pillow.new("RGB", (WIDE * SCALE, TALL * SCALE), "white")
    pen, letters = ImageDraw.Draw(sheet), font(13 * SCALE)
    most = max(float(curve.max()) for curve in curves.values())
    reach = max(len(curve) for curve in curves.values()) - 1

    def place(x: float, y: float) -> tuple[float, float]:
        across = LEFT + x / reach * (WIDE - LEFT - RIGHT)
        return across * SCALE, (TALL - BELOW - y / most * (TALL - BELOW - 16)) * SCALE

    pen.line([place(0, most), place(0, 0), place(reach, 0)], fill="#666666", width=SCALE)
    for x in range(0, reach + 1, 10):
        pen.text(place(x, 0), str(x), fill="#444444", font=letters, anchor="ma")
    for y in (0.0, most / 2, most):
        pen.text((place(0, y)[0] - 8, place(0, y)[1]), f"{y:.2f}", "#444444", letters, anchor="rm")
    pen.text(place(reach, 0), f"  {along}", fill="#444444", font=letters, anchor="ls")
    pen.text(place(0, most), f"  {up}", fill="#444444", font=letters, anchor="la")
    for number, (name, curve) in enumerate(curves.items()):
        colour = COLOURS[number % len(COLOURS)]
        points = [place(x, y) for x, y in enumerate(curve)]
        pen.line(points, fill=colour, width=(4 if number == 0 else 2) * SCALE, joint="curve")
        at = ((WIDE - RIGHT + 14) * SCALE, (20 + 20 * number) * SCALE)
        pen.text(at, name, fill=colour, font=letters, anchor="lm")
    sheet.resize((WIDE, TALL), Pillow.Resampling.LANCZOS).save(path)

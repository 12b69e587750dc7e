"""What a training leaves behind in its folder: metrics.csv, a slice at every look, and the curve
with slices along it.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw

from trabecula.engine.files import replacing

_WIDTH, _HEIGHT, _MARGIN, _SLICE = 960, 300, 30, 150  # of the plot, pixels
_SHOWN = 6  # slices along the curve
_COLOURS = {
    "maker": (31, 119, 180),
    "judge": (214, 39, 40),
    "sliced": (44, 160, 44),
    "two_point": (120, 60, 160),
}


class TrainingLog:
    """The folder of a run.

    Parameters
    ----------
    path : str
        Nothing is written where it is empty.
    """

    def __init__(self, path: str) -> None:
        self.path = Path(path) if path else None
        self.rows: list[dict[str, float]] = []
        self.slices: list[np.ndarray] = []

    def continued(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Go on after the looks of a run that was interrupted."""
        self.rows = [dict(row) for row in rows]
        self.slices = (
            [np.asarray(Picture.open(self._slice(row))) for row in rows] if self.path else []
        )

    def _slice(self, row: Mapping[str, float]) -> Path:
        return (self.path or Path()) / f"slice-{int(row['iteration']):06d}.png"

    def add(self, row: Mapping[str, float], middle: np.ndarray) -> None:
        """A look: its figures, and a slice (Y, X) of what was made."""
        self.rows.append(dict(row))
        self.slices.append(as_bytes(middle))
        if self.path is None:
            return
        names = list(dict.fromkeys(name for one in self.rows for name in one))
        with (
            replacing(self.path / "metrics.csv") as temporary,
            temporary.open("w", newline="") as stream,
        ):
            writer = csv.DictWriter(stream, names)
            writer.writeheader()
            writer.writerows(self.rows)
        with replacing(self._slice(row)) as temporary:
            Picture.fromarray(self.slices[-1]).save(temporary)
        with replacing(self.path / "training.png") as temporary:
            plotted(self.rows, self.slices).save(temporary)


def as_bytes(middle: np.ndarray) -> np.ndarray:
    """A slice of labels or grey as uint8, black to white."""
    low, high = float(middle.min()), float(middle.max())
    return np.rint((middle - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)


def plotted(rows: Sequence[Mapping[str, float]], slices: Sequence[np.ndarray]) -> Picture.Image:
    """The losses over the iterations with slices of what was made above them (figure 5 of the
    paper).
    """
    canvas = Picture.new("RGB", (_WIDTH, _HEIGHT + _SLICE + 2 * _MARGIN), "white")
    draw = ImageDraw.Draw(canvas)
    last = max(row["iteration"] for row in rows)
    places = sorted({round(i * (len(rows) - 1) / (_SHOWN - 1)) for i in range(_SHOWN)})
    for column, place in enumerate(places):
        left = column * _WIDTH // _SHOWN
        canvas.paste(
            Picture.fromarray(slices[place]).resize((_SLICE, _SLICE), Picture.Resampling.NEAREST),
            (left, 0),
        )
        x = _across(rows[place]["iteration"], last)
        draw.line([(left + _SLICE // 2, _SLICE), (x, _SLICE + _MARGIN)], fill=(150, 150, 150))
    draw.rectangle(
        [_MARGIN, _SLICE + _MARGIN, _WIDTH - _MARGIN, _SLICE + _MARGIN + _HEIGHT], outline="black"
    )
    for number, (name, colour) in enumerate(_COLOURS.items()):
        points = [
            (row["iteration"], row[name]) for row in rows if np.isfinite(row.get(name, np.nan))
        ]
        if not points:
            continue
        top = max(value for _, value in points) or 1.0
        line = [
            (_across(at, last), _SLICE + _MARGIN + round(_HEIGHT * (1 - max(value, 0) / top)))
            for at, value in points
        ]
        draw.line(line if len(line) > 1 else line * 2, fill=colour, width=2)
        draw.text(
            (_MARGIN + 8 + 180 * number, _SLICE + _MARGIN + _HEIGHT + 8),
            f"{name} (0 .. {top:.3g})",
            fill=colour,
        )
    draw.text(
        (_WIDTH - 190, _SLICE + _MARGIN + _HEIGHT + 8), f"{int(last)} iterations", fill="black"
    )
    return canvas


def _across(iteration: float, last: float) -> int:
    return _MARGIN + round((_WIDTH - 2 * _MARGIN) * iteration / max(last, 1))

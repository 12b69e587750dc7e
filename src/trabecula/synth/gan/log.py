"""The folder of a training: metrics, a slice at every evaluation, the curve of losses with slices
along it, and a checkpoint (arrays and plain JSON in one file, nothing pickled).
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw

from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.core.progress import notify
from trabecula.core.recipe import digest
from trabecula.engine.files import UNREADABLE, replacing
from trabecula.synth.gan.config import GanConfig

_CHECKPOINT, _ABOUT, _FORMAT = "training.npz", "about", 3

_FREE = ("run", "minutes", "looks", "patience", "checkpoint", "storage", "batch")
"""Settings that another run may have and still resume; the batch is checked by itself."""

_WIDTH, _HEIGHT, _MARGIN, _SLICE = 960, 300, 30, 150  # of the plot, pixels
_SHOWN = 6  # slices along the curve
_COLOURS = {
    "generator": (31, 119, 180),
    "discriminator": (214, 39, 40),
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

    def restore(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Continue after the evaluations of an interrupted run."""
        self.rows = [dict(row) for row in rows]
        self.slices = (
            [np.asarray(Picture.open(self._slice_path(row))) for row in rows] if self.path else []
        )

    def _slice_path(self, row: Mapping[str, float]) -> Path:
        return (self.path or Path()) / f"slice-{int(row['iteration']):06d}.png"

    def add(self, row: Mapping[str, float], middle: np.ndarray) -> None:
        """Add the figures of an evaluation and a slice (Y, X) of what was generated."""
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
        with replacing(self._slice_path(row)) as temporary:
            Picture.fromarray(self.slices[-1]).save(temporary)
        with replacing(self.path / "training.png") as temporary:
            plot_losses(self.rows, self.slices).save(temporary)


def as_bytes(middle: np.ndarray) -> np.ndarray:
    """Convert a slice of labels or grey to uint8, black to white."""
    low, high = float(middle.min()), float(middle.max())
    return np.rint((middle - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)


def plot_losses(rows: Sequence[Mapping[str, float]], slices: Sequence[np.ndarray]) -> Picture.Image:
    """Plot the losses over the iterations, with generated slices above (figure 5 of the paper)."""
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
        x = _column(rows[place]["iteration"], last)
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
            (_column(at, last), _SLICE + _MARGIN + round(_HEIGHT * (1 - max(value, 0) / top)))
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


def _column(iteration: float, last: float) -> int:
    return _MARGIN + round((_WIDTH - 2 * _MARGIN) * iteration / max(last, 1))


@dataclass(frozen=True)
class TrainingCheckpoint:
    """A training that can be resumed: tensors by name, and plain JSON."""

    tensors: dict[str, Any]
    plain: dict[str, Any]


def save_checkpoint(
    config: GanConfig, images: Sequence[Image], tensors: Mapping[str, Any], plain: Mapping[str, Any]
) -> None:
    """Write a checkpoint into the folder of the run, if there is one: a cut leaves the last whole
    one.
    """
    if not config.run:
        return
    words = {"identity": _identity(config, images), "batch": config.batch, **plain}
    about = json.dumps(words).encode()
    with replacing(Path(config.run) / _CHECKPOINT) as temporary, temporary.open("wb") as stream:
        arrays = {f"state.{name}": tensor.cpu().numpy() for name, tensor in tensors.items()}
        arrays[_ABOUT] = np.frombuffer(about, np.uint8)
        np.savez(stream, **arrays)


def load_checkpoint(config: GanConfig, images: Sequence[Image]) -> TrainingCheckpoint | None:
    """Read the checkpoint of the same run; None where there is none.

    One of a run that ended for want of memory is that of a smaller batch, too.
    """
    path = Path(config.run or ".") / _CHECKPOINT
    if not config.run or not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            about = json.loads(bytes(stored[_ABOUT]))
            arrays = {
                name.removeprefix("state."): stored[name] for name in stored.files if name != _ABOUT
            }
    except UNREADABLE as error:
        notify(f"{path.name} is damaged ({error}): starting from the beginning")
        return None
    fits = about.get("batch") == config.batch or (
        about.get("out_of_memory") and config.batch < about.get("batch", 0)
    )
    if about.pop("identity", None) != _identity(config, images) or not fits:
        notify(f"{path.name} was left by another training: starting from the beginning")
        return None
    torch = need("torch", extra="learn", purpose="method 'gan'")
    return TrainingCheckpoint(
        {name: torch.from_numpy(array) for name, array in arrays.items()}, about
    )


def checkpoint_words(folder: Path) -> dict[str, Any]:
    """Return the plain part of the checkpoint in a folder, whatever training left it; empty where
    there is none.
    """
    try:
        with np.load(folder / _CHECKPOINT, allow_pickle=False) as stored:
            found: dict[str, Any] = json.loads(bytes(stored[_ABOUT]))
            return found
    except UNREADABLE:
        return {}


def _identity(config: GanConfig, images: Sequence[Image]) -> str:
    """Return the SHA-256 of all that the training depends on but its batch; its length may
    change.
    """
    settings = {name: value for name, value in asdict(config).items() if name not in _FREE}
    torch = need("torch", extra="learn", purpose="method 'gan'")
    parts = {
        "format": _FORMAT,
        "settings": settings,
        "exemplar": [digest(image.values) for image in images],
        "torch": str(torch.__version__),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

"""What happened at every place, and its sum for the recipe: (N, D)-compatibility as it came out
(section 3.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.synth.quilt.windows import Frame

_WORST = 5

REASONS = ("", "connectivity", "feature size")
"""What no piece could keep; `Trace.gave_way` has the position."""


class Trace:
    """What happened at every place.

    Attributes
    ----------
    frame : Frame
        Where places are: entry (k, j, i) is the k-th along z, and so on.
    mismatch : float array, one entry per place along z, y, x
        Share of the overlap's voxels that differ from the piece chosen: d_N, 0 .. 1; NaN without an
        overlap.
    difference : float array, the same
        Weighted difference of the piece's descriptors from the target, each over its range in the
        exemplars: d_D; NaN where nothing is asked for.
    tried : int32 array, the same
        Pieces that were laid down and judged; 0 where nothing was to be made.
    strut : int32 array, the same
        Voxels of struts, that were laid where no piece could keep what is to hang together.
    gave_way : uint8 array, the same
        What no piece could keep, as its position in `REASONS`.
    taken_back : int
        Pieces that were laid and taken back.
    painted : int
        Voxels of islands that were painted over in the end.
    """

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.mismatch = memmap.empty(frame.counts, np.float64)
        self.difference = memmap.empty(frame.counts, np.float64)
        self.tried = memmap.zeros(frame.counts, np.int32)
        self.strut = memmap.zeros(frame.counts, np.int32)
        self.gave_way = memmap.zeros(frame.counts, np.uint8)
        for values in (self.mismatch, self.difference):
            for layer in _layers(values):
                layer[...] = np.nan
        self.taken_back = self.painted = 0

    def add(
        self, number: int, mismatch: float, difference: float, tried: int, strut: int, gave_way: str
    ) -> None:
        """What happened at a place."""
        at = np.unravel_index(number, self.frame.counts)
        self.mismatch[at], self.difference[at] = mismatch, difference
        self.tried[at], self.strut[at], self.gave_way[at] = tried, strut, REASONS.index(gave_way)

    def drop(self, number: int) -> None:
        """Forget a place: its piece is taken back."""
        self.add(number, math.nan, math.nan, 0, 0, "")
        self.taken_back += 1

    def told(self) -> dict[str, Any]:
        """Means and maxima, and where it had to give way, as plain JSON."""
        told: dict[str, Any] = {
            "places": _count(self.tried),
            "taken_back": self.taken_back,
            "painted": self.painted,
            **{name: summed for name, summed in self._distances() if summed},
            "struts": _count(self.strut),
            "strut_voxels": sum(int(layer.sum(dtype=np.int64)) for layer in _layers(self.strut)),
            "gave_way": _count(self.gave_way),
        }
        if told["gave_way"]:
            told["gave_way_at"] = list(self._first_given())
        return told

    def _distances(self) -> tuple[tuple[str, dict[str, float]], ...]:
        return (("mismatch", _summed(self.mismatch)), ("descriptors", _summed(self.difference)))

    def _first_given(self) -> Iterator[dict[str, Any]]:
        """The first places that gave way."""
        left = _WORST
        for z, layer in enumerate(_layers(self.gave_way)):
            for at in np.argwhere(layer)[:left]:
                number = int(np.ravel_multi_index((z, *at), self.frame.counts))
                yield {"voxel": list(self.frame.corner(number)), "in": REASONS[layer[tuple(at)]]}
                left -= 1
            if not left:
                return

    def arrays(self) -> dict[str, np.ndarray]:
        """All of it, for a checkpoint."""
        held = {
            name: getattr(self, name)
            for name in ("mismatch", "difference", "tried", "strut", "gave_way")
        }
        return {**held, "taken_back": np.array(self.taken_back)}

    def take_over(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take what `arrays` gave."""
        for name in ("mismatch", "difference", "tried", "strut", "gave_way"):
            setattr(self, name, arrays[name])
        self.taken_back = int(arrays["taken_back"])


def _layers(values: np.ndarray) -> Iterator[np.ndarray]:
    """Layer by layer, so that not all is in memory at once."""
    for layer in values:
        yield layer
        memmap.release_pages()


def _count(values: np.ndarray) -> int:
    """Entries that are not 0."""
    return sum(int(np.count_nonzero(layer)) for layer in _layers(values))


def _summed(values: np.ndarray) -> dict[str, float]:
    """Mean and maximum of what is known; empty where nothing is."""
    sums, most, count = [], -math.inf, 0
    for layer in _layers(values):
        known = layer[~np.isnan(layer)]
        sums.append(float(known.sum()))
        most = max(most, float(known.max(initial=-math.inf)))
        count += len(known)
    return {"mean": _short(math.fsum(sums) / count), "max": _short(most)} if count else {}


def _short(value: float) -> float:
    return round(float(value), 6)

"""What happened at every place, and its sum for the recipe: (N, D)-compatibility as it came out (section 3.4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

_WORST = 5


@dataclass
class Trace:
    """One entry per place, in the order of places.

    Attributes
    ----------
    corner : list of three ints
        First voxel of its box.
    mismatch : list of float
        Share of the overlap's voxels that differ from the piece chosen: d_N, 0 .. 1; NaN without an overlap.
    difference : list of float
        Weighted difference of the piece's descriptors from the target, each over its range in the exemplars: d_D; NaN where
        nothing is asked for.
    tried : list of int
        Pieces that were laid down and judged.
    strut : list of int
        Voxels of struts, that were laid where no piece could keep what is to hang together.
    gave_way : list of str
        "" or what no piece could keep: "connectivity" or "feature size".
    taken_back : int
        Pieces that were laid and taken back.
    painted : int
        Voxels of islands that were painted over in the end.
    """

    corner: list[tuple[int, ...]] = field(default_factory=list)
    mismatch: list[float] = field(default_factory=list)
    difference: list[float] = field(default_factory=list)
    tried: list[int] = field(default_factory=list)
    strut: list[int] = field(default_factory=list)
    gave_way: list[str] = field(default_factory=list)
    taken_back: int = 0
    painted: int = 0

    def add(
        self, corner: tuple[int, ...], mismatch: float, difference: float, tried: int, strut: int, gave_way: str
    ) -> None:
        """One more place."""
        self.corner.append(corner)
        self.mismatch.append(mismatch)
        self.difference.append(difference)
        self.tried.append(tried)
        self.strut.append(strut)
        self.gave_way.append(gave_way)

    def drop(self) -> None:
        """Forget the last place: it is taken back."""
        for entries in (self.corner, self.mismatch, self.difference, self.tried, self.strut, self.gave_way):
            entries.pop()
        self.taken_back += 1

    def told(self) -> dict[str, Any]:
        """Means and maxima, and where it had to give way, as plain JSON."""
        told: dict[str, Any] = {"places": len(self.corner), "taken_back": self.taken_back, "painted": self.painted}
        for name, values in (("mismatch", self.mismatch), ("descriptors", self.difference)):
            known = np.array([value for value in values if value == value])
            if len(known):
                told[name] = {"mean": _short(known.mean()), "max": _short(known.max())}
        told["struts"] = sum(1 for voxels in self.strut if voxels)
        told["strut_voxels"] = sum(self.strut)
        given = [(corner, why) for corner, why in zip(self.corner, self.gave_way, strict=True) if why]
        told["gave_way"] = len(given)
        if given:
            told["gave_way_at"] = [{"voxel": list(corner), "in": why} for corner, why in given[:_WORST]]
        return told

    def arrays(self) -> dict[str, np.ndarray]:
        """The entries as arrays, for a checkpoint."""
        return {
            "corner": np.array(self.corner, np.int64).reshape(-1, 3),
            "mismatch": np.array(self.mismatch),
            "difference": np.array(self.difference),
            "tried": np.array(self.tried, np.int64),
            "strut": np.array(self.strut, np.int64),
            "gave_way": np.array([_REASONS.index(why) for why in self.gave_way], np.int64),
            "taken_back": np.array(self.taken_back),
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Trace:
        """What `arrays` gave."""
        return cls(
            [tuple(int(side) for side in corner) for corner in arrays["corner"]],
            [float(value) for value in arrays["mismatch"]],
            [float(value) for value in arrays["difference"]],
            [int(count) for count in arrays["tried"]],
            [int(count) for count in arrays["strut"]],
            [_REASONS[int(why)] for why in arrays["gave_way"]],
            int(arrays["taken_back"]),
        )


_REASONS = ["", "connectivity", "feature size"]


def _short(value: float) -> float:
    return round(float(value), 6)

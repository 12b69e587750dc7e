"""What rounds of search and vote on planes start from, and how an interrupted run gets it back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.checkpoint import due, offer
from trabecula.engine.parallel import for_slabs


@dataclass
class SolidState:
    """The output at one resolution; rounds put new arrays in place of the old.

    Attributes
    ----------
    matches : list of (sz, sy, sx) int32
        One a view.
    votes : (C, Z, Y, X) int16
        256 times what was voted.
    field : (C, Z, Y, X) int8
    sources : (Z, Y, X) int32, optional
        Where every voxel was taken from.
    debt : (C, bins), optional
        What steps owe the two-point function.
    """

    matches: list[np.ndarray]
    votes: np.ndarray
    field: np.ndarray
    sources: np.ndarray | None = None
    debt: np.ndarray | None = None

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray]) -> SolidState:
        """From what was offered."""
        count = sum(name.startswith("match") for name in arrays)
        matches = [arrays[f"match{place}"] for place in range(count)]
        return cls(
            matches, arrays["votes"], arrays["field"], arrays.get("sources"), arrays.get("debt")
        )

    def offer(self, stage: str, number: int) -> None:
        """Offer it to who keeps states, after `number` rounds of `stage`."""
        if not due():
            return
        arrays = {f"match{place}": match for place, match in enumerate(self.matches)}
        arrays |= {"votes": self.votes, "field": self.field}
        arrays |= {} if self.sources is None else {"sources": self.sources}
        arrays |= {} if self.debt is None else {"debt": self.debt}
        offer(stage, number, **arrays)


def equal_weights(active: np.ndarray) -> np.ndarray:
    """The weights int32 of sites (sz, sy, sx) that vote alike: 1, and 0 where they are not active."""
    weights = memmap.empty(active.shape, np.int32)

    def work(start: int, stop: int) -> None:
        weights[start:stop] = active[start:stop]

    for_slabs(work, len(active))
    return weights

"""Faces of voxels around the regions of a phase that was cut at its necks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.measure.partition import Partition


@dataclass(frozen=True, eq=False)
class BodyFaces:
    """Faces of voxels around N regions, sorted by region; n faces.

    Attributes
    ----------
    starts : (N + 1,) int64
        Where the faces of every region begin.
    places : (n, 3) float64
        Edges, with voxel centres at whole numbers of steps.
    contact : (n,) bool
        Whether another region is beyond, or a voxel that is not seen.
    cut : (n,) bool
        Whether a voxel that is not seen is beyond.
    ways : (n, 3) int8
        From the region outwards.
    """

    starts: np.ndarray
    places: np.ndarray
    contact: np.ndarray
    cut: np.ndarray
    ways: np.ndarray

    @classmethod
    def of(cls, regions: Partition, unseen: np.ndarray | None = None) -> BodyFaces:
        """Collect the faces of regions inside the array."""
        owners, places, contacts, cuts, ways = [], [], [], [], []
        for axis in range(3):
            lower, upper = (
                tuple(cut if other == axis else slice(None) for other in range(3))
                for cut in (slice(None, -1), slice(1, None))
            )
            low, high = regions.labels[lower], regions.labels[upper]
            at = np.nonzero(low != high)
            place = np.stack(at, axis=1).astype(np.float64)
            place[:, axis] += 0.5
            contact = (low[at] > 0) & (high[at] > 0)
            for side, other, sign in ((low[at], upper, 1), (high[at], lower, -1)):
                own = side > 0
                cut = np.zeros(own.sum(), bool) if unseen is None else unseen[other][at][own]
                way = np.zeros((len(cut), 3), np.int8)
                way[:, axis] = sign
                owners.append(side[own] - 1)
                places.append(place[own] * regions.steps)
                contacts.append(contact[own] | cut)
                cuts.append(cut)
                ways.append(way)
        owner = np.concatenate(owners)
        order = np.argsort(owner, kind="stable")
        starts = np.searchsorted(owner[order], np.arange(regions.count + 1))
        sorted_ = (np.concatenate(part)[order] for part in (places, contacts, cuts, ways))
        return cls(starts, *sorted_)

    def of_region(self, number: int) -> slice:
        """Return where the faces of a region are."""
        return slice(self.starts[number], self.starts[number + 1])

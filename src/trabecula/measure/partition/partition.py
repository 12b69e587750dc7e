"""Watershed of the distance map: every voxel of a phase goes to the peak that it drains to.

Regions grow from the peaks (`peaks.find_peaks`) over the distance map from the highest voxels down:
a priority flood (Barnes et al. 2014, doi:10.1016/j.cageo.2013.04.024), first in, first out among
voxels of one distance, so that plateaus are halved. A region is connected by faces of voxels, and
the way by which a voxel was reached is a widest path to its peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.measure.partition.peaks import find_peaks
from trabecula.measure.phases import as_periodic, check_sides
from trabecula.measure.spheres import inscribed_spheres

SMOOTHING, REACH = 0.4, 4.0
"""Of the distance map and of a peak, in smallest voxel edges: Gostick 2017."""

STEPS = np.array([(-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, 1, 0), (1, 0, 0)])
"""Neighbours of a voxel; step k and step 5 - k are opposite."""

PEAK = 6
"""The way of a peak: nowhere."""

_MIDDLE = 13  # of offset codes: 9 z + 3 y + x, each 0 .. 2 for one period back, none, one ahead


@dataclass(frozen=True, eq=False)
class Partition:
    """A phase cut into regions; N regions. Lengths are in units of the smallest voxel edge."""

    labels: np.ndarray
    """(Z, Y, X) int32: 0 outside, then 1 .. N, by falling height of their peaks."""
    peaks: np.ndarray
    """(N, 3) int64 voxels."""
    distance: np.ndarray
    """(Z, Y, X) float32 distance to the rest."""
    ways: np.ndarray
    """(Z, Y, X) uint8: the step of `STEPS` from a voxel towards its peak; `PEAK` at one."""
    crossed: np.ndarray
    """(Z, Y, X) int8 codes: the periods that lie between the peak and the voxel; one voxel where
    nothing repeats."""
    steps: np.ndarray
    """(3,) edges of a voxel."""
    wraps: tuple[bool, ...]

    @property
    def count(self) -> int:
        """Return the number of regions."""
        return len(self.peaks)

    def periods(self, voxels: np.ndarray) -> np.ndarray:
        """Return by how many periods flat voxels lie beyond their peaks, (n, 3) int64."""
        if self.crossed.size == 1:
            return np.zeros((len(voxels), 3), np.int64)
        code = self.crossed.ravel()[voxels].astype(np.int64)
        return np.stack([code // 9, code // 3 % 3, code % 3], axis=1) - 1


def cut_phase(
    image: Image,
    inside: np.ndarray,
    periodic: bool | Sequence[bool],
    *,
    smoothing: float,
    reach: float | None,
    name: str,
) -> Partition:
    """Check what a partition is given, and cut the phase; `name` says of what, for messages."""
    if image.ndim != 3:
        raise InputError(f"{name} is of a volume: the image is 2-D")
    check_sides(image.shape, what=f"has no room for {name}")
    if not inside.any():
        raise InputError("the phase is empty: there is nothing to cut; choose another one")
    if inside.all():
        raise InputError("the phase fills the whole image: it has no necks; choose another one")
    steps = np.array(image.spacing) / min(image.spacing)
    return partition(
        np.ascontiguousarray(inside),
        steps,
        as_periodic(periodic, 3),
        smoothing=as_number(smoothing, name="smoothing", low=0, high=10),
        reach=None if reach is None else as_number(reach, name="reach", low=1, high=50),
    )


def partition(
    inside: np.ndarray,
    steps: np.ndarray,
    wraps: tuple[bool, ...],
    *,
    smoothing: float,
    reach: float | None,
    unseen: np.ndarray | None = None,
) -> Partition:
    """Cut a phase into regions, one for each peak of its distance map.

    Parameters
    ----------
    inside : bool array, (Z, Y, X)
        Neither empty nor full.
    steps : float64 array, (3,)
        Edges of a voxel in units of the smallest.
    wraps : three bool
        Axes that repeat.
    smoothing, reach : float
        As for `peaks.find_peaks`.
    unseen : bool array, (Z, Y, X), optional
        Voxels of no known phase, none of them inside: they bound nothing, as the faces of the array
        do not.
    """
    spheres = inscribed_spheres(inside if unseen is None else inside | unseen, steps, wraps)
    if unseen is not None:
        spheres.radius[unseen] = 0
    peaks = find_peaks(spheres.radius, steps, wraps, smoothing=smoothing, reach=reach)
    rank = spheres.rank(spheres.radius)
    rank[~inside] = 0
    labels = np.zeros(inside.shape, np.int32)
    ways = np.zeros(inside.shape, np.uint8)
    crossed = np.zeros(inside.shape if any(wraps) else (1, 1, 1), np.int8)
    ends = np.full((2, spheres.top + 1), -1, np.int64)
    following = np.empty(rank.size, np.int32 if rank.size < 2**31 else np.int64)
    _flood(rank, peaks, STEPS, np.array(wraps), ends, following, labels, ways, crossed)
    return Partition(labels, peaks, spheres.radius, ways, crossed, steps, wraps)


def grow(inside: np.ndarray, seeds: np.ndarray, wraps: tuple[bool, ...]) -> np.ndarray:
    """Return for every voxel of a phase the nearest seed by steps across faces, from 1, int32; 0
    outside, and where no way leads to.

    Parameters
    ----------
    inside : bool array, (Z, Y, X)
    seeds : int64 array, (N, 3)
        Voxels of the phase; the first of those equally near is taken.
    wraps : three bool
        Steps lead through the faces of these axes.
    """
    labels = np.zeros(inside.shape, np.int32)
    ways, crossed = np.zeros(inside.shape, np.uint8), np.zeros((1, 1, 1), np.int8)
    ends = np.full((2, 2), -1, np.int64)
    following = np.empty(inside.size, np.int32 if inside.size < 2**31 else np.int64)
    rank = inside.astype(np.int32)
    _flood(rank, seeds, STEPS, np.array(wraps), ends, following, labels, ways, crossed)
    return labels


@kernel
def _flood(rank, peaks, steps, wraps, ends, following, labels, ways, crossed):
    """Grow the regions from the highest rank down. `ends` (first and last) and `following` are a
    queue for every rank.
    """
    depth, height, width = rank.shape
    periodic = crossed.size > 1
    first, last = ends[0], ends[1]
    top = 0
    for k in range(len(peaks)):
        z, y, x = peaks[k]
        level = rank[z, y, x]
        top = max(top, level)
        labels[z, y, x] = k + 1
        ways[z, y, x] = PEAK
        if periodic:
            crossed[z, y, x] = _MIDDLE
        voxel = (z * height + y) * width + x
        following[voxel] = -1
        if first[level] < 0:
            first[level] = voxel
        else:
            following[last[level]] = voxel
        last[level] = voxel
    for level in range(top, 0, -1):
        voxel = first[level]
        while voxel >= 0:
            row = voxel // width
            x0 = voxel - row * width
            z0 = row // height
            y0 = row - z0 * height
            for step in range(6):
                z, y, x = z0 + steps[step, 0], y0 + steps[step, 1], x0 + steps[step, 2]
                over = 0
                if z < 0 or z >= depth:
                    if not wraps[0]:
                        continue
                    over = 9 if z > 0 else -9
                    z %= depth
                elif y < 0 or y >= height:
                    if not wraps[1]:
                        continue
                    over = 3 if y > 0 else -3
                    y %= height
                elif x < 0 or x >= width:
                    if not wraps[2]:
                        continue
                    over = 1 if x > 0 else -1
                    x %= width
                if rank[z, y, x] == 0 or labels[z, y, x] != 0:
                    continue
                labels[z, y, x] = labels[z0, y0, x0]
                ways[z, y, x] = 5 - step
                if periodic:
                    code = crossed[z0, y0, x0]
                    # a region more than a period long is cut off at that: it meets itself there
                    part = code // abs(over) % 3 + (1 if over > 0 else -1) if over != 0 else 1
                    crossed[z, y, x] = code + over if 0 <= part <= 2 else code
                to = min(rank[z, y, x], level)
                other = (z * height + y) * width + x
                following[other] = -1
                if first[to] < 0:
                    first[to] = other
                else:
                    following[last[to]] = other
                last[to] = other
            voxel = following[voxel]
        first[level] = -1

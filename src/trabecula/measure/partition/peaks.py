"""Peaks of a distance map: the seeds of a watershed that cuts a phase at its necks.

Gostick 2017 (SNOW, doi:10.1103/PhysRevE.96.023307):

1. the distance map is smoothed, so that single voxels of the wall make no peak of their own;
2. peaks are the voxels that nothing exceeds within a ball of `reach` voxels;
3. peaks on saddles go: those whose plateau touches anything higher;
4. of peaks nearer to each other than to the wall the lower goes.

Here only voxels of one connected component are compared, and a component keeps its highest voxel
where no peak of it is left, so that none is lost, however narrow.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.engine.rows import copy_row
from trabecula.measure.labelling import label_components
from trabecula.measure.neighbours import voxel_at
from trabecula.measure.smooth import gaussian, reach_of


def find_peaks(
    distance: np.ndarray,
    steps: np.ndarray,
    wraps: tuple[bool, ...],
    *,
    smoothing: float,
    reach: float | None,
) -> np.ndarray:
    """Return the peaks of a distance map, (N, 3) int64 voxels, the highest first.

    Parameters
    ----------
    distance : float32 array, (Z, Y, X)
        In units of the smallest voxel edge; 0 outside the phase.
    steps : float64 array, (3,)
        Edges of a voxel in units of the smallest.
    wraps : three bool
        Axes that repeat.
    smoothing : float
        Standard deviation of the Gaussian in smallest edges; 0 for none.
    reach : float
        Radius of the ball in smallest edges; None for one peak in every connected component.
    """
    components = label_components(distance > 0, periodic=wraps)[0]
    best = _highest_voxels(distance.ravel(), components.ravel(), int(components.max()))
    if reach is None:
        return _as_places(_falling(best, distance)[0], distance.shape)
    smooth = _smoothed(distance, smoothing / steps, wraps)
    candidate = np.zeros(distance.shape, bool)
    ball, turn = _ball(reach, steps), np.array(wraps)
    for_slabs(
        lambda a, b: _mark_highest(smooth, components, ball, turn, candidate, a, b), len(distance)
    )
    number, sizes = label_components(candidate, connectivity=26, periodic=wraps)
    places = np.flatnonzero(candidate)
    places = places[np.argsort(number.ravel()[places], kind="stable")]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    around = _ball(1.8, np.ones(3))
    seen = np.zeros(distance.shape, np.int32)
    found = _climb(distance, around, turn, places, starts, seen)
    peaks = found[found >= 0]
    has = np.zeros(len(best) + 1, bool)
    has[components.ravel()[peaks]] = True
    lone = best[~has[components.ravel()[best]]]
    chosen = _keep_apart(np.concatenate([peaks, lone]), distance, steps, wraps)
    return _as_places(chosen, distance.shape)


def _as_places(voxels: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.stack(np.unravel_index(voxels, shape), axis=1)


def _falling(peaks: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return peaks, the highest first, and their heights."""
    radius = distance.ravel()[peaks].astype(np.float64)
    order = np.lexsort((peaks, -radius))
    return peaks[order], radius[order]


def _smoothed(distance: np.ndarray, sigma: np.ndarray, wraps: tuple[bool, ...]) -> np.ndarray:
    if not sigma.any():
        return distance
    margins = [reach_of(float(s)) if wrap else 0 for s, wrap in zip(sigma, wraps, strict=True)]
    # A margin wider than the image would be cut by np.pad's own repeats: they are right as well.
    padded = np.pad(distance, [(m, m) for m in margins], mode="wrap")
    smooth = gaussian(padded, sigma)
    return np.ascontiguousarray(
        smooth[tuple(slice(m, m + side) for m, side in zip(margins, distance.shape, strict=True))]
    )


def _ball(radius: float, steps: np.ndarray) -> np.ndarray:
    """Return the offsets of a ball without its centre, nearest first, (K, 3) int64."""
    sides = [int(radius / step) for step in steps]
    offsets = np.stack(
        np.meshgrid(*[np.arange(-s, s + 1) for s in sides], indexing="ij"), axis=-1
    ).reshape(-1, 3)
    far = ((offsets * steps) ** 2).sum(axis=1)
    order = np.argsort(far, kind="stable")
    return offsets[order][(far[order] > 0) & (far[order] <= radius**2 * (1 + 1e-9))]


@kernel
def _mark_highest(smooth, components, ball, wraps, candidate, start, stop):
    """Mark the voxels that no voxel of the ball exceeds, of those in the same component."""
    _, height, width = smooth.shape
    heights, parts = smooth.ravel(), components.ravel()
    for z0 in range(start, stop):
        for y0 in range(height):
            for x0 in range(width):
                own = components[z0, y0, x0]
                if own == 0:
                    continue
                value = smooth[z0, y0, x0]
                highest = True
                for k in range(len(ball)):
                    z, y, x = z0 + ball[k, 0], y0 + ball[k, 1], x0 + ball[k, 2]
                    other = voxel_at(z, y, x, smooth.shape, wraps)
                    if other >= 0 and heights[other] > value and parts[other] == own:
                        highest = False
                        break
                candidate[z0, y0, x0] = highest


@kernel
def _climb(distance, around, wraps, places, starts, seen):
    """Return for every cluster of candidates the voxel nearest to the middle of its plateau in the
    unsmoothed map; -1 where that touches anything higher, or was found before.

    Smoothing moves a peak by a voxel at most, so the plateau is that of the highest voxel next to
    the cluster. `seen` holds the search that came to a voxel, from 1: a plateau that is left at its
    first higher neighbour is found again by another search, which then ends at that one's voxels.
    """
    depth, height, width = distance.shape
    size = depth * height * width
    flat = distance.ravel()
    marked = seen.ravel()
    found = np.full(len(starts) - 1, -1, np.int64)
    stack = np.empty(1024, np.int64)
    for cluster in range(len(starts) - 1):
        best = places[starts[cluster]]
        for k in range(starts[cluster], starts[cluster + 1]):
            v = places[k]
            if flat[v] > flat[best]:
                best = v
            z0, y0, x0 = v // (height * width), v // width % height, v % width
            for step in range(len(around)):
                z, y, x = z0 + around[step, 0], y0 + around[step, 1], x0 + around[step, 2]
                other = voxel_at(z, y, x, distance.shape, wraps)
                if other >= 0 and flat[other] > flat[best]:
                    best = other
        if marked[best] > 0:
            continue
        level, own = flat[best], np.int32(cluster + 1)
        count, top, saddle = 1, 0, False
        stack[0] = best
        marked[best] = own
        while top < count and not saddle:
            v = stack[top]
            top += 1
            z0, y0, x0 = v // (height * width), v // width % height, v % width
            for step in range(len(around)):
                z, y, x = z0 + around[step, 0], y0 + around[step, 1], x0 + around[step, 2]
                other = voxel_at(z, y, x, distance.shape, wraps)
                if other < 0:
                    continue
                if flat[other] > level or (flat[other] == level and 0 < marked[other] < own):
                    saddle = True
                    break
                if flat[other] == level and marked[other] == 0:
                    marked[other] = own
                    if count == len(stack):
                        more = np.empty(min(2 * len(stack), size), np.int64)
                        copy_row(more[:count], stack)
                        stack = more
                    stack[count] = other
                    count += 1
        if saddle:
            continue
        middle = np.zeros(3)
        for k in range(count):
            v = stack[k]
            middle[0] += v // (height * width)
            middle[1] += v // width % height
            middle[2] += v % width
        middle /= count
        nearest = np.inf
        for k in range(count):
            v = stack[k]
            off = (
                (v // (height * width) - middle[0]) ** 2
                + (v // width % height - middle[1]) ** 2
                + (v % width - middle[2]) ** 2
            )
            if off < nearest or (off == nearest and v < found[cluster]):
                nearest, found[cluster] = off, v
    return found


@kernel
def _highest_voxels(distance, components, count):
    """Return the first of the highest voxels of every component."""
    best = np.full(count, -1, np.int64)
    for v in range(len(distance)):
        c = components[v] - 1
        if c >= 0 and (best[c] < 0 or distance[v] > distance[best[c]]):
            best[c] = v
    return best


def _keep_apart(
    peaks: np.ndarray, distance: np.ndarray, steps: np.ndarray, wraps: tuple[bool, ...]
) -> np.ndarray:
    """Return the peaks, the highest first, without those inside the ball of a higher one."""
    peaks, radius = _falling(peaks, distance)
    at = _as_places(peaks, distance.shape) * steps
    period = np.where(wraps, np.array(distance.shape) * steps, np.inf)
    cell = max(4.0, 2 * float(np.median(radius)))
    keep = np.ones(len(peaks), bool)
    _drop_near(at, radius, period, cell, np.array(distance.shape) * steps, keep)
    return peaks[keep]


@kernel
def _drop_near(at, radius, period, cell, sides, keep):
    """Take peaks from the highest down: each drops the lower ones in its ball."""
    cells = np.empty(3, np.int64)
    for a in range(3):
        cells[a] = max(1, int(np.ceil(sides[a] / cell)))
    head = np.full(cells[0] * cells[1] * cells[2], -1, np.int64)
    following = np.empty(len(at), np.int64)
    for k in range(len(at) - 1, -1, -1):
        c = np.int64(0)
        for a in range(3):
            c = c * cells[a] + min(int(at[k, a] / cell), cells[a] - 1)
        following[k] = head[c]
        head[c] = k
    low, count = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(len(at)):
        if not keep[k]:
            continue
        for a in range(3):
            first = int(np.floor((at[k, a] - radius[k]) / cell))
            last = int(np.floor((at[k, a] + radius[k]) / cell))
            if period[a] < np.inf:
                # the last cell of a period may be a part of one: one more on both sides
                first, last = first - 1, last + 1
                if last - first + 1 > cells[a]:
                    first, last = 0, cells[a] - 1
            else:
                first, last = max(first, 0), min(last, cells[a] - 1)
            low[a], count[a] = first, last - first + 1
        for i in range(count[0]):
            for j in range(count[1]):
                for m in range(count[2]):
                    c = (low[0] + i) % cells[0]
                    c = c * cells[1] + (low[1] + j) % cells[1]
                    c = c * cells[2] + (low[2] + m) % cells[2]
                    other = head[c]
                    while other >= 0:
                        if other > k and keep[other]:
                            square = 0.0
                            for a in range(3):
                                step = abs(at[k, a] - at[other, a])
                                if period[a] < np.inf:
                                    step = min(step, period[a] - step)
                                square += step * step
                            if square < radius[k] ** 2:
                                keep[other] = False
                        other = following[other]

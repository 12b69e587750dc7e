"""Cells of a picture of boundaries: grains of an alloy, cells of a foam or of tissue, in a section.

Four steps:

1. the distance to the boundary is flooded from the highest pixel down; where two floods meet, the
   lower peak joins the higher one if the pass between them is nearly as wide as its own cell, and
   stays a cell of its own if it is a gap in a boundary (a watershed with relative dynamics; Meyer
   1994, doi:10.1016/0165-1684(94)90060-4);
2. every boundary pixel goes to the nearest cell, so that cells cover the picture;
3. cells that the picture's edge cuts are left out of sizes, and those inside are weighted by one
   over the share of places of the window in which they would not have been cut (Miles 1974 and
   Lantuejoul 1980; Ohser and Muecklich 2000, section 4.2), since large cells are cut more often;
4. points where three cells meet, and lines between cells, are counted (Crofton's formula in four
   directions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, phase_index
from trabecula.engine.compile import kernel
from trabecula.measure.distance import distance_transform

NECK = 0.75
"""Width of a gap over that of the narrower of two cells beside it, from which they are one cell."""

_STEP = 1.0  # pixels by which a pass lies lower than a peak, at least: less is the grid's
_FILLED = 0.3  # of the picture, that cells fill at least where no phase is named
_SPECK = 3  # pixels; smaller parts of the interior are noise of a boundary


@dataclass(frozen=True, eq=False)
class PlaneCells:
    """Cells of a picture; N cells. Lengths are in the picture's unit."""

    labels: np.ndarray
    """(Y, X) int32: the cell of every pixel, from 1; boundary pixels belong to the nearest."""
    area: np.ndarray
    """(N,) with its share of the boundary."""
    aspect: np.ndarray
    """(N,) longer over shorter axis of the ellipse with the same second moments."""
    neighbours: np.ndarray
    """(N,) int64: cells that share a line with it."""
    inside: np.ndarray
    """(N,) bool: cells that the picture's edge does not cut."""
    weights: np.ndarray
    """(N,) of every cell in means over cells; 0 for those that are cut."""
    triple_points: float
    """Points where three cells meet per area."""
    boundary_length: float
    """Length of the lines between cells per area."""
    picture_area: float
    unit: str

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.area)

    @property
    def density(self) -> float:
        """Return the number of cells per area."""
        return float(self.weights.sum() / self.picture_area)

    @property
    def mean_area(self) -> float:
        """Return the mean area of a cell."""
        return self.mean(self.area)

    @property
    def mean_neighbours(self) -> float:
        """Return the mean number of neighbours of a cell; near 6 where three cells meet in a point
        (Euler's formula).
        """
        return self.mean(self.neighbours)

    def mean(self, values: np.ndarray) -> float:
        """Return the mean over cells of values (N,)."""
        return float(np.average(values, weights=self.weights))

    def spread(self, values: np.ndarray) -> float:
        """Return the standard deviation over cells of values (N,)."""
        return float(np.sqrt(max(0.0, self.mean(values**2) - self.mean(values) ** 2)))

    def quantiles(self, values: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Return the values (N,) below which these shares of the cells lie."""
        order = np.argsort(values, kind="stable")
        weight = np.cumsum(self.weights[order]) - self.weights[order] / 2
        kept = self.weights[order] > 0
        found = np.interp(shares, weight[kept] / self.weights.sum(), values[order][kept])
        return np.asarray(found)


def plane_cells(
    image: Image | ArrayLike, *, boundary: str | int | None = None, neck: float = NECK
) -> PlaneCells:
    """Find the cells of a picture of boundaries, across gaps of the boundaries.

    Parameters
    ----------
    image : Image or array of labels, (Y, X)
    boundary : str or int, optional
        The phase of the boundaries. Default: the phase whose rest falls into most cells.
    neck : float
        Gaps of a boundary narrower than this share of the cells beside it do not join them,
        0.05 .. 1.

    Returns
    -------
    cells : PlaneCells

    Raises
    ------
    InputError
        Not a picture of labels; no cells; no cell that the edge does not cut; a cell that is larger
        than a third of the picture.

    Examples
    --------
    >>> walls = np.zeros((31, 31), np.uint8)
    >>> walls[::6] = walls[:, ::6] = 1
    >>> found = plane_cells(walls)
    >>> len(found), int(found.inside.sum()), float(np.median(found.area[found.inside]))
    (25, 9, 36.0)
    """
    image = as_image(image)
    check_labels(image)
    if image.ndim != 2:
        raise InputError(f"cells are those of a picture, got {image.shape}: take a slice")
    share = as_number(neck, name="neck", low=0.05, high=1)
    phase = boundary_phase(image) if boundary is None else phase_index(image, boundary, default="")
    interior = image.values != phase
    if interior.all() or not interior.any():
        raise InputError(
            "no cells found: the picture holds "
            + ("no boundary" if interior.all() else "boundary alone")
            + "; name another phase of the boundaries"
        )
    labels = cover(*_cells_of(interior, share))
    return _measure(image, labels)


def boundary_phase(*images: Image) -> int:
    """Return the label of the phase whose rest falls into most cells in a picture, or in several of
    one material; the rarer one of two alike.

    Raises
    ------
    InputError
        One phase alone.
    """
    values = np.concatenate([one.values.ravel() for one in images])
    counts = np.bincount(values, minlength=len(images[0].phases))
    present = [int(label) for label in np.flatnonzero(counts)]
    if len(present) < 2:
        raise InputError("no cells found: the picture holds one phase alone")
    cells = {
        label: sum(_whole(_cells_of(image.values != label, NECK)[1]) for image in images)
        for label in present
    }
    return max(present, key=lambda label: (cells[label], -counts[label]))


def _whole(labels: np.ndarray) -> int:
    """Return how many regions the edge does not cut, of those that hold much of the picture."""
    cut = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    area = np.bincount(labels.ravel())
    area[0] = 0
    area[np.unique(cut)] = 0
    # Islands of a material are no cells of it: cells fill what is left between the boundaries.
    if area.sum() < _FILLED * labels.size:
        return 0
    return int(np.count_nonzero(area))


def _cells_of(interior: np.ndarray, neck: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance to the interior (Y, X) float32, and the cells of the interior, int32."""
    height = distance_transform(interior)
    order = np.argsort(-height.ravel(), kind="stable")[: np.count_nonzero(interior)]
    labels = np.zeros(interior.shape, np.int32)
    if not np.isfinite(height).all():
        return distance_transform(~interior), labels
    flood(height, order, np.float64(neck), labels)
    sizes = np.bincount(labels.ravel())
    kept = sizes > _SPECK
    kept[0] = False
    labels = np.where(kept, np.cumsum(kept), 0).astype(np.int32)[labels]
    return distance_transform(labels == 0), labels


@kernel
def flood(height, order, neck, labels):
    """Label the cells of an interior (Y, X) from 1, given its pixels by falling distance.

    `labels` int32 is 0 where not inside.
    """
    rows, columns = height.shape
    parent = np.empty(len(order) + 1, np.int32)
    peak = np.empty(len(order) + 1)
    around = np.empty(4, np.int32)
    count = 0
    for place in order:
        y, x = place // columns, place % columns
        level = np.float64(height[y, x])
        found, best, nearest = 0, 0, -1.0
        for side in range(4):
            j = y + (side == 0) - (side == 1)
            i = x + (side == 2) - (side == 3)
            if j < 0 or i < 0 or j >= rows or i >= columns or labels[j, i] == 0:
                continue
            root = labels[j, i]
            while parent[root] != root:
                root = parent[root]
            around[found] = root
            found += 1
            if height[j, i] > nearest:
                nearest = height[j, i]
                best = root
        if found == 0:
            count += 1
            parent[count] = count
            peak[count] = level
            labels[y, x] = count
            continue
        labels[y, x] = best
        for one in range(found):
            first, second = around[one], best
            while parent[second] != second:
                second = parent[second]
            while parent[first] != first:
                first = parent[first]
            if first == second:
                continue
            if peak[first] > peak[second] or (peak[first] == peak[second] and first < second):
                first, second = second, first
            # `first` has the lower peak
            if level >= min(neck * peak[first], peak[first] - _STEP):
                parent[first] = second
    for place in order:
        y, x = place // columns, place % columns
        root = labels[y, x]
        while parent[root] != root:
            root = parent[root]
        labels[y, x] = root


def cover(distance: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return labels (Y, X) int32 where every pixel of none has the nearest label's.

    `distance` (Y, X) is that of every pixel to the nearest labelled one.
    """
    if not labels.any():
        return labels
    order = np.argsort(distance.ravel(), kind="stable")
    order = order[np.count_nonzero(labels) :]
    found = labels.copy()
    _spread(order, found, np.full((*labels.shape, 2), -1, np.int32))
    return found


@kernel
def _spread(order, labels, source):
    """Give pixels, by rising distance, the label of the nearest source among their neighbours'."""
    rows, columns = labels.shape
    for place in order:
        y, x = place // columns, place % columns
        best = np.int64(1) << 60
        for j in range(max(0, y - 1), min(rows, y + 2)):
            for i in range(max(0, x - 1), min(columns, x + 2)):
                if labels[j, i] == 0:
                    continue
                v, u = source[j, i, 0], source[j, i, 1]
                if v < 0:
                    v, u = np.int32(j), np.int32(i)
                far = np.int64(v - y) ** 2 + np.int64(u - x) ** 2
                if far < best:
                    best = far
                    labels[y, x] = labels[j, i]
                    source[y, x, 0], source[y, x, 1] = v, u


def _measure(image: Image, labels: np.ndarray) -> PlaneCells:
    """Measure cells that cover a picture."""
    count, sides = int(labels.max()), image.shape
    inside = np.ones(count, bool)
    for line in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        inside[line[line > 0] - 1] = False
    if count < 2 or not inside.any():
        raise InputError(
            f"no cells found: {count} in the picture, none of which lies wholly inside; give a "
            "picture with closed boundaries, or name their phase"
        )
    sums = np.zeros((count, 6), np.int64)
    boxes = np.empty((count, 4), np.int64)
    boxes[:, :2], boxes[:, 2:] = 1 << 40, -1
    _moments(labels, sums, boxes)
    pixels = sums[:, 0]
    if 3 * int(pixels.max()) > labels.size:
        raise InputError(
            f"a cell of {int(pixels.max())} pixels is larger than a third of the picture "
            f"{image.shape}: give a larger picture, or one whose boundaries have no wide gaps"
        )
    extent = boxes[:, 2:] - boxes[:, :2] + 1
    places = np.prod(np.maximum(np.array(sides) - extent, 0), axis=1)
    inside &= places > 0
    weights = np.where(inside, labels.size / np.maximum(places, 1), 0.0)
    edges = np.array(image.spacing)
    pairs = _pairs(labels)
    return PlaneCells(
        labels=labels,
        area=pixels * float(np.prod(edges)),
        aspect=_aspects(sums, edges),
        neighbours=np.bincount(pairs.ravel() - 1, minlength=count),
        inside=inside,
        weights=weights,
        triple_points=_triple_points(labels) / float(np.prod((np.array(sides) - 1) * edges)),
        boundary_length=_length(labels, edges),
        picture_area=float(labels.size * np.prod(edges)),
        unit=image.unit,
    )


@kernel
def _moments(labels, sums, boxes):
    """Add pixels, first and second moments of every cell to `sums` (N, 6): 1, y, x, yy, yx, xx;
    `boxes` (N, 4) are least y, x and greatest y, x.
    """
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            cell = labels[y, x] - 1
            sums[cell, 0] += 1
            sums[cell, 1] += y
            sums[cell, 2] += x
            sums[cell, 3] += y * y
            sums[cell, 4] += y * x
            sums[cell, 5] += x * x
            boxes[cell, 0] = min(boxes[cell, 0], y)
            boxes[cell, 1] = min(boxes[cell, 1], x)
            boxes[cell, 2] = max(boxes[cell, 2], y)
            boxes[cell, 3] = max(boxes[cell, 3], x)


def _aspects(sums: np.ndarray, edges: np.ndarray) -> np.ndarray:
    count, y, x, yy, yx, xx = sums.T.astype(np.float64)
    pixel = 1 / 12  # second moment of a pixel itself
    a = (yy / count - (y / count) ** 2 + pixel) * edges[0] ** 2
    b = (yx / count - y * x / count**2) * edges[0] * edges[1]
    c = (xx / count - (x / count) ** 2 + pixel) * edges[1] ** 2
    middle, half = (a + c) / 2, np.sqrt(((a - c) / 2) ** 2 + b**2)
    return np.asarray(np.sqrt((middle + half) / np.maximum(middle - half, 1e-30)))


def _pairs(labels: np.ndarray) -> np.ndarray:
    """Return the pairs of cells that share a line, each once, (P, 2)."""
    found = []
    for first, second in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        apart = first != second
        found.append(np.stack([first[apart], second[apart]], axis=1))
    pairs = np.sort(np.concatenate(found), axis=1)
    return np.unique(pairs, axis=0)


def _triple_points(labels: np.ndarray) -> int:
    """Count points where three cells meet; one where four meet counts twice."""
    corners = np.stack([labels[:-1, :-1], labels[:-1, 1:], labels[1:, :-1], labels[1:, 1:]])
    corners.sort(axis=0)
    kinds = 1 + np.count_nonzero(corners[1:] != corners[:-1], axis=0)
    return int(np.maximum(kinds - 2, 0).sum())


def _length(labels: np.ndarray, edges: np.ndarray) -> float:
    """Return the length of lines between cells per area, from their crossings along rows, columns
    and diagonals: pi / 2 times the crossings per length.
    """
    slant = float(np.hypot(*edges))
    ways = (
        (labels[1:], labels[:-1], float(edges[0])),
        (labels[:, 1:], labels[:, :-1], float(edges[1])),
        (labels[1:, 1:], labels[:-1, :-1], slant),
        (labels[1:, :-1], labels[:-1, 1:], slant),
    )
    crossings = [np.count_nonzero(a != b) / (a.size * step) for a, b, step in ways]
    return float(np.pi / 2 * np.mean(crossings))

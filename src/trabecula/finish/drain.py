"""Drain: straight holes from closed pores into the open, so that powder or resin gets out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.compile import kernel
from trabecula.finish.labels import background_of, check_present, with_step
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import indicator


def drain(
    image: Image | ArrayLike,
    *,
    width: float,
    phase: str | int | None = None,
    min_size: int = 1,
) -> Image:
    """Open every closed pore by a straight round hole, the shortest way into the open.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    width : float
        Diameter of the holes in the image's unit, above 0 and at most the longest side: what a
        printer can clear (`passage` of `print_check`).
    phase : str or int, optional
        The phase around the pores. Default: "solid", which is every phase but "void" taken
        together.
    min_size : int
        Pores of fewer voxels stay closed.

    Returns
    -------
    image : Image
        The recipe's step holds a `report`: `holes`, `removed` (voxels of the phase), `longest`
        (length of the longest hole, in the image's unit), `left` (closed pores that stay),
        `components` (of the phase, before and after: a hole may cut a strut).

    Raises
    ------
    InputError
        Not 3-D, an empty phase, a width out of range; the void of an image of several phases.

    Notes
    -----
    A hole leads to void that reaches a face of the image, or to the face itself. Holes do not know
    each other: close pores may get one each where one hole through both would do.

    Examples
    --------
    >>> box = np.ones((9, 9, 9), int); box[3:6, 3:6, 3:6] = 0
    >>> report = drain(box, width=1).recipe.steps[-1]["report"]
    >>> report["holes"], report["removed"], report["left"]
    (1, 3, 0)
    """
    image = as_image(image)
    background = background_of(image, phase)
    image, inside = indicator(image, phase)
    if image.ndim != 3:
        raise InputError(f"holes need a volume, the image has shape {image.shape}: give 3 axes")
    check_present(bool(inside.any()), phase, "to drain")
    extent = max(side * edge for side, edge in zip(image.shape, image.spacing, strict=True))
    wide = as_number(width, name="width", low=0, high=extent)
    if wide == 0:
        raise InputError("width=0 makes no hole: give the diameter, above 0")
    least = int(as_number(min_size, name="min_size", low=1, high=2**62, whole=True))
    values = np.array(image.values, order="C")
    report = _drain(values, inside, background, image.spacing, wide / 2, least)
    report["components"] = [
        len(label_components(one)[1]) for one in (inside, inside & (values != background))
    ]
    settings: dict[str, Any] = {"width": width, "phase": phase, "min_size": min_size}
    return with_step(image, values, "drain", settings, report)


def _drain(
    values: np.ndarray,
    inside: np.ndarray,
    background: int,
    spacing: tuple[float, ...],
    radius: float,
    least: int,
) -> dict[str, Any]:
    """Open the pores of `values` in place."""
    # a layer of void around the image is the open as well
    labels, sizes = label_components(np.pad(values == background, 1, constant_values=True))
    open_ = labels == labels[0, 0, 0]
    closed = [n for n in range(1, len(sizes) + 1) if n != labels[0, 0, 0] and sizes[n - 1] >= least]
    report: dict[str, Any] = {"holes": len(closed), "removed": 0, "longest": 0.0}
    report["left"] = len(sizes) - 1
    if not closed:
        return report
    edges = np.array(spacing, np.float64)
    distance = distance_transform(~open_, spacing=spacing)
    starts = _nearest_voxels(labels, distance, closed)
    cut = np.zeros(values.shape, np.bool_)
    for start in starts:
        end = _open_voxel(open_, start, float(distance[tuple(start)]), edges)
        report["longest"] = max(report["longest"], float(np.linalg.norm((end - start) * edges)))
        _dig(cut, (start - 1) * edges, (end - 1) * edges, edges, max(radius, 0.01 * edges.min()))
    removed = cut & inside
    values[removed] = background
    report["removed"] = int(removed.sum())
    # holes may have opened others on their way
    report["left"] = (
        len(label_components(np.pad(values == background, 1, constant_values=True))[1]) - 1
    )
    return report


def _nearest_voxels(
    labels: np.ndarray, distance: np.ndarray, closed: list[int]
) -> list[np.ndarray]:
    """Return the voxel of each pore that is nearest to the open, of several the one nearest to the
    pore's centre.
    """
    places = np.flatnonzero(np.isin(labels, closed))
    numbers, away = labels.ravel()[places], distance.ravel()[places]
    points = np.stack(np.unravel_index(places, labels.shape), axis=1)
    sizes = np.maximum(np.bincount(numbers), 1)
    centres = np.stack([np.bincount(numbers, weights=column) for column in points.T], axis=1)
    aside = ((points - (centres / sizes[:, None])[numbers]) ** 2).sum(axis=1)
    order = np.lexsort((places, aside, away, numbers))
    first = np.unique(numbers[order], return_index=True)[1]
    return list(points[order][first])


def _open_voxel(
    open_: np.ndarray, start: np.ndarray, distance: float, edges: np.ndarray
) -> np.ndarray:
    """Return the open voxel nearest to a place, whose distance is known."""
    reach = np.ceil(distance / edges).astype(int) + 1
    low = np.maximum(start - reach, 0)
    box = tuple(slice(a, b) for a, b in zip(low, start + reach + 1, strict=True))
    found = np.argwhere(open_[box]) + low
    return np.asarray(found[(((found - start) * edges) ** 2).sum(axis=1).argmin()])


@kernel
def _dig(cut, one, other, edges, radius):
    """Mark the voxels whose centres lie within `radius` of a line, and a chain of voxels along it
    that share faces, however thin it is.
    """
    steps = 1
    for axis in range(3):
        steps = max(steps, int(np.ceil(2 * abs(other[axis] - one[axis]) / edges[axis])))
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    centre = np.empty(3)
    at = np.empty(3, np.int64)
    for axis in range(3):
        at[axis] = int(np.rint(one[axis] / edges[axis]))
    for n in range(steps + 1):
        for axis in range(3):
            centre[axis] = one[axis] + (other[axis] - one[axis]) * n / steps
            low[axis] = max(0, int(np.ceil((centre[axis] - radius) / edges[axis])))
            high[axis] = min(
                cut.shape[axis] - 1, int(np.floor((centre[axis] + radius) / edges[axis]))
            )
            nearest = int(np.rint(centre[axis] / edges[axis]))
            while True:
                here = True
                for k in range(3):
                    here = here and 0 <= at[k] < cut.shape[k]
                if here:
                    cut[at[0], at[1], at[2]] = True
                if at[axis] == nearest:
                    break
                at[axis] += 1 if nearest > at[axis] else -1
        for z in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                for x in range(low[2], high[2] + 1):
                    away = (
                        (z * edges[0] - centre[0]) ** 2
                        + (y * edges[1] - centre[1]) ** 2
                        + (x * edges[2] - centre[2]) ** 2
                    )
                    if away <= radius * radius:
                        cut[z, y, x] = True

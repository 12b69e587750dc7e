"""Evenness of a material in space: local fraction, surface and direction over windows, and trends.

A mean, a two-point function and a pore size can all be right in a volume that is hollow, graded or
made of two halves. What shows it is how much the means of *windows* differ. The variance of these
means falls with the window's volume as the material's covariance says (Lantuejoul 1991,
doi:10.1111/j.1365-2818.1991.tb03111.x, "ergodicity and integral range"), so windows are compared at
equal size, and sizes count in correlation lengths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, phase_index
from trabecula.measure.correlation.length import correlation_length
from trabecula.measure.grey import autocorrelation
from trabecula.measure.streaming.cells import CELL, CellMeans, cells_of

SMALLEST, WIDEST = 3.0, 20.0
"""Edges of the smallest and of the largest window in correlation lengths; the middle one is their
geometric mean.
"""

LARGEST = 0.4
"""Largest edge of a window, of the shortest side: fewer than two and a half windows a side tell no
spread.
"""

QUANTILES = 41
"""Of the windows of one size."""

AXES = ("z", "y", "x")


@dataclass(frozen=True)
class Spread:
    """Differences between windows of one size, in their mean."""

    edge: float
    """Of the window, in the image's unit."""
    mean: float
    deviation: float
    """Standard deviation over the windows."""
    lowest: float
    highest: float
    kurtosis: float
    """Fourth moment over the squared variance; 3 where window means are normally distributed."""
    quantiles: tuple[float, ...] = ()
    """At 0, 1 / 40, ..., 1 of the windows; empty of the direction."""
    blocks: tuple[float, ...] = ()
    """Variance over the windows of each half of the image along every axis (octants of a volume);
    empty where a half holds fewer than two windows beside each other."""


@dataclass(frozen=True)
class Evenness:
    """Local figures of an image, by window size, and trends through the whole of it."""

    fraction: tuple[Spread, ...]
    """Volume fraction of the phase; of a grey or colour image the mean value."""
    surface: tuple[Spread, ...]
    """Interface area per volume (on voxel faces, so the figures compare with each other only), over
    its mean.
    """
    direction: tuple[Spread, ...]
    """Share of the interface that faces each axis: `deviation` is the root of the variances' sum
    over the axes, `lowest` and `highest` the smallest and largest share of any axis."""
    trend: dict[str, float]
    """Change of the local fraction (or value) from one face to the other of a straight line fitted
    along "z", "y", "x", and from the faces to the centre ("centre")."""
    surface_trend: dict[str, float]
    """The same of the interface area per volume, over its mean."""
    extents: tuple[float, ...]
    """Lengths along the axes that were measured, in the image's unit."""
    images: int = 1
    """How many images these figures are of: slices of a volume may be taken together."""


def evenness(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    windows: Sequence[float] | None = None,
) -> Evenness:
    """Measure how local fraction, surface and direction vary over windows and along the image.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Grey and colour images are measured by their values (of colour the luminance).
    phase : str or int, optional
        Of labels. Default: "solid", every phase but "void".
    windows : sequence of float, optional
        Edges of the windows in the image's unit, rounded to whole cells of 4 voxels. Default: 3 and
        20 correlation lengths and their geometric mean, at most 0.4 of the shortest side.

    Returns
    -------
    evenness : Evenness

    Raises
    ------
    InputError
        An image with a side of fewer than 8 voxels, a phase that does not exist, windows that do
        not fit.

    Examples
    --------
    >>> halves = np.zeros((32, 32, 32), np.uint8)
    >>> halves[16:] = np.random.default_rng(0).integers(0, 2, (16, 32, 32))
    >>> found = evenness(halves, windows=[8])
    >>> round(found.fraction[0].deviation, 1)
    0.2
    >>> round(found.trend["z"], 1), abs(round(found.trend["x"], 1))
    (0.8, 0.0)
    """
    image = as_image(image)
    cells = cells_of(image, cell=cell_for(image.shape))
    try:
        given = windows_for(image) if windows is None else list(windows)
    except TypeError:
        raise InputError(f"windows {quote(windows)} is no list: give their edges") from None
    edges = [as_number(edge, name="window", low=0, high=math.inf) for edge in given]
    return evenness_of(cells, window_counts(cells, edges), labels=labels_of(image, phase))


def cell_for(shape: Sequence[int]) -> int:
    """Return the voxels a side of a cell: `CELL`, or half of it in small images."""
    if min(shape) < 8:
        raise InputError(
            f"an image of {tuple(shape)} voxels is too small for windows: at least 8 voxels along "
            "every axis"
        )
    return CELL if min(shape) >= 48 else CELL // 2


def windows_for(image: Image, *, shortest: float | None = None) -> list[float]:
    """Return the edges of three windows in the image's unit, smallest first; fewer where they fall
    together.

    Parameters
    ----------
    image : Image
    shortest : float, optional
        Shortest side of everything that is to be compared, in the image's unit. Default: the
        image's own.
    """
    own = min(side * step for side, step in zip(image.shape, image.spacing, strict=True))
    most = LARGEST * min(own, own if shortest is None else shortest)
    length = _correlation_length(image)
    least = 2 * cell_for(image.shape) * max(image.spacing)
    small = max(least, SMALLEST * length)
    if not small < most / 2:  # little room: as wide apart as there is
        return sorted({min(most, max(least, most * share)) for share in (0.25, 0.5, 1.0)})
    large = min(most, max(WIDEST * length, 4 * small))
    return [small, math.sqrt(small * large), large]


def labels_of(image: Any, phase: str | int | None) -> list[int]:
    """Return the rows of `CellMeans.shares` that make up a phase of an Image or Slabs; of grey and
    colour images the only one.
    """
    if image.kind != "labels":
        return [0]
    if phase is None and "void" in image.phases:
        return [label for label, name in enumerate(image.phases) if name != "void"]
    return [phase_index(image, phase, default="solid")]


def window_counts(cells: CellMeans, edges: Sequence[float]) -> list[tuple[int, int, int]]:
    """Return the cells that a window of each edge has along z, y and x; sizes that round to the
    same stand once.

    Raises
    ------
    InputError
        A window larger than the image.
    """
    found = []
    for edge in edges:
        steps = [e * s for e, s in zip(cells.edges, cells.spacing, strict=True)]
        counts = [max(1, round(edge / step)) for step in steps]
        if cells.edges[0] == 1 and cells.shape[0] == 1:
            counts[0] = 1
        if any(count > side for count, side in zip(counts, cells.shape, strict=True)):
            raise InputError(
                f"a window of {edge:g} does not fit into the image: give a smaller one"
            )
        found.append((counts[0], counts[1], counts[2]))
    return list(dict.fromkeys(found))


def evenness_of(
    cells: CellMeans, windows: Sequence[tuple[int, int, int]], *, labels: Sequence[int]
) -> Evenness:
    """Return the evenness of cells that are summed already; the parameters are those of the
    functions above.
    """
    share = cells.shares[list(labels)].sum(axis=0)
    area = cells.faces.sum(axis=0)
    mean_area = area.mean() or 1.0
    edges = [counts[2] * cells.edges[2] * cells.spacing[2] for counts in windows]
    sized = list(zip(edges, windows, strict=True))
    extents = tuple(
        length for length, count in zip(cells.extents, cells.shape, strict=True) if count > 1
    )
    return Evenness(
        tuple(_spread(edge, window_means(share, counts), counts) for edge, counts in sized),
        tuple(
            _spread(edge, window_means(area, counts) / mean_area, counts) for edge, counts in sized
        ),
        tuple(
            _direction(edge, [window_means(faces, counts) for faces in cells.faces], counts)
            for edge, counts in sized
        ),
        trends(share),
        trends(area / mean_area),
        extents,
    )


def window_means(values: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """Return the means of all windows of `counts` cells: (Z - k + 1, Y - k + 1, X - k + 1)."""
    sums = values
    for axis, count in enumerate(counts):
        running = np.cumsum(sums, axis=axis)
        head = running.take([count - 1], axis)
        rest = running.take(range(count, running.shape[axis]), axis)
        sums = np.concatenate(
            [head, rest - running.take(range(running.shape[axis] - count), axis)], axis
        )
    return sums / math.prod(counts)


def trends(share: np.ndarray) -> dict[str, float]:
    """Return the change of a straight line fitted along every axis of cells, and from the faces to
    the centre.
    """
    found = {}
    for axis, name in enumerate(AXES):
        count = share.shape[axis]
        if count > 1:
            place = (np.arange(count) + 0.5) / count
            found[name] = _slope(place, share.mean(axis=tuple(a for a in range(3) if a != axis)))
    found["centre"] = _slope(depth_of(share.shape).ravel(), share.ravel())
    return found


def depth_of(shape: Sequence[int]) -> np.ndarray:
    """Return the depth of every cell: 0 at the nearest face, 1 at the centre of the shortest
    axis.
    """
    depth = np.ones(tuple(shape))
    for axis, count in enumerate(shape):
        if count > 1:
            place = (np.arange(count) + 0.5) / count
            line = np.minimum(place, 1 - place) * 2
            depth = np.minimum(depth, line.reshape([-1 if a == axis else 1 for a in range(3)]))
    return depth


def _slope(place: np.ndarray, values: np.ndarray) -> float:
    away = place - place.mean()
    return float((away * values).sum() / max((away**2).sum(), 1e-300))


def _spread(edge: float, means: np.ndarray, counts: Sequence[int]) -> Spread:
    mean, variance = float(means.mean()), float(means.var())
    fourth = float(((means - mean) ** 4).mean())
    kurtosis = fourth / variance**2 if variance > 0 else 3.0
    quantiles = np.quantile(means, np.linspace(0, 1, QUANTILES))
    ends = float(quantiles[0]), float(quantiles[-1])
    blocks = tuple(float(block.var()) for block in _octants(means, counts))
    return Spread(
        edge, mean, math.sqrt(variance), *ends, kurtosis, tuple(quantiles.tolist()), blocks
    )


def _octants(means: np.ndarray, counts: Sequence[int]) -> list[np.ndarray]:
    """Return the means of those windows that lie in one half of the image along every axis."""
    halves = []
    for windows, count in zip(means.shape, counts, strict=True):
        if windows == 1:  # the one plane of a picture
            halves.append([slice(None)])
            continue
        inside = (windows + count - 1) // 2 - count + 1
        if inside <= count:
            return []
        halves.append([slice(0, inside), slice(windows - inside, windows)])
    return [means[box] for box in product(*halves)]


def _direction(edge: float, faces: Sequence[np.ndarray], counts: Sequence[int]) -> Spread:
    total = np.sum(faces, axis=0)
    held = total > 0  # a window without any interface has no direction
    if not held.any():
        return Spread(edge, 0.0, 0.0, 0.0, 0.0, 3.0)
    shares = [each[held] / total[held] for each in faces]
    variance = sum(float(each.var()) for each in shares)
    known = [each for each in shares if each.any()]
    blocks: list[float] = []
    if held.all():
        parts = [_octants(each / total, counts) for each in faces]
        blocks = [sum(float(each.var()) for each in block) for block in zip(*parts, strict=True)]
    return Spread(
        edge,
        1 / max(1, len(known)),
        math.sqrt(variance),
        min(float(each.min()) for each in known),
        max(float(each.max()) for each in known),
        3.0,
        blocks=tuple(blocks),
    )


def _correlation_length(image: Image) -> float:
    """Return the `correlation_length` of labels; of other images the largest lag at which the
    autocorrelation is 1/e or more.
    """
    if image.kind == "labels":
        named = "void" in image.phases
        return correlation_length(image, phase=None if named else 0)
    rho = autocorrelation(image, lags=max(1, min(image.shape) // 2))
    centre = tuple(side // 2 for side in rho.shape)
    longest = 0.0
    for axis, step in enumerate(image.spacing):
        line = np.moveaxis(rho, axis, 0)[
            (slice(centre[axis], None), *(c for a, c in enumerate(centre) if a != axis))
        ]
        longest = max(longest, float(np.flatnonzero(np.abs(line) >= math.exp(-1))[-1]) * step)
    return longest

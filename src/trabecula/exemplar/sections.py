"""Parallel sections of a material: whether they can be as far apart as they are said to be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.grey import grey_values

_APART = 0.15
"""Difference of correlations above which a gap is contradicted: no pair of five scans that are
alike from all sides reaches it (`trabecula bench sections`)."""

_SURE = 3.0  # standard errors that it has to be at least
_BLOCKS = 3  # along a side, whose scatter says the standard error
_FARTHER = 4  # times the gap, up to which the gap that fits is looked for
_NEAR = 0.08  # by which the correlation of the gap that fits may differ
_FADED = 0.2  # a correlation below this is that of no distance in particular


def gap_contradiction(sections: Sequence[Image], gap: int) -> str | None:
    """Return what speaks against parallel sections of a material that is alike from all sides; None
    where nothing is sure.

    In such a material points correlate by their distance alone: from section to section as within
    one. A gap that is far off and sections that are not registered show; a direction of the
    material only where it differs from the mean of rows and columns.

    Parameters
    ----------
    sections : two or more Images, (Y, X), of one shape
    gap : int
        Pixels from one to the next, less than a side.
    """
    worst, text = 0.0, None
    for values in _fields(sections):
        spread = float(values.var())
        if not spread > 0:
            continue
        values = (values - values.mean()) / np.float32(spread**0.5)
        across, within = _across(values), _within(values, gap)
        apart = [_across(block) - _within(block, gap) for block in _blocks(values, gap)]
        error = float(np.std(apart, ddof=1)) / len(apart) ** 0.5 if len(apart) > 1 else 0.0
        if abs(across - within) > max(worst, _APART, _SURE * error):
            worst = abs(across - within)
            text = (
                f"points {gap} px apart correlate by {across:.2f} from section to section and "
                f"by {within:.2f} within one{_fitting(values, gap, across)}: check the gap, how "
                "the sections are registered, and whether the material is alike from all sides"
            )
    return text


def _fields(sections: Sequence[Image]) -> Iterator[np.ndarray]:
    """Yield what is correlated, (N, Y, X) each: grey values, or whether points are of a phase."""
    if sections[0].kind != "labels":
        yield np.stack([grey_values(each) for each in sections]).astype(np.float32)
        return
    names = sections[0].phases
    for name in names[1:] if len(names) == 2 else names:
        found = [each.values == each.phases.index(name) for each in sections]
        yield np.stack(found).astype(np.float32)


def _blocks(values: np.ndarray, gap: int) -> list[np.ndarray]:
    """Return parts of (N, Y, X) along rows and columns, each longer than the gap; all where there
    is no room.
    """
    edges = [side // _BLOCKS for side in values.shape[1:]]
    if min(edges) <= gap:
        return [values]
    return [
        values[:, y * edges[0] : (y + 1) * edges[0], x * edges[1] : (x + 1) * edges[1]]
        for y, x in product(range(_BLOCKS), repeat=2)
    ]


def _across(values: np.ndarray) -> float:
    """Return the mean product of points of a section and of the next, above each other."""
    return float(np.mean([(a * b).mean() for a, b in pairwise(values)]))


def _within(values: np.ndarray, lag: int) -> float:
    """Return the mean product of points of a section along rows and columns, `lag` apart."""
    side = values.shape[1] - lag
    down = (values[:, lag:] * values[:, :side]).mean()
    along = (values[:, :, lag:] * values[:, :, : values.shape[2] - lag]).mean()
    return float(down + along) / 2


def _fitting(values: np.ndarray, gap: int, across: float) -> str:
    """Return in words the distance at which points of a section correlate as those of two do."""
    farthest = min(_FARTHER * gap + 1, *(side // 2 for side in values.shape[1:]))
    within = np.array([_within(values, lag) for lag in range(farthest + 1)])
    near = int(np.argmin(np.abs(within - across)))
    if across < _FADED or abs(within[near] - across) > _NEAR:
        return ""
    return f", where {across:.2f} is that of {near} px"

"""Parallel sections of a material: whether they can be as far apart as they are said to be."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.grey import grey_values

_APART = 0.15
"""Difference of correlations that is said. Of pairs of five scans that are alike from all sides, 2
and 4 voxels apart, it is .12 at most; of bone, fibres and a weave up to .3 to .9."""


def sections_apart(sections: Sequence[Image], gap: int) -> str | None:
    """Return what speaks against parallel sections of a material that is alike from all sides; None
    where nothing does.

    In such a material points correlate by their distance alone: from section to section as within
    one. A wrong gap, sections that are not registered and a material with a direction show.

    Parameters
    ----------
    sections : two or more Images, (Y, X), of one shape
    gap : int
        Pixels from one to the next, less than a side.
    """
    worst, text = _APART, None
    for values in _fields(sections):
        spread = float(values.var())
        if not spread > 0:
            continue
        values = values - values.mean()
        across = float(np.mean([(a * b).mean() for a, b in pairwise(values)])) / spread
        lags = range(1, max(gap, min(values.shape[1:]) // 3) + 1)
        within = [_within(values, lag) / spread for lag in lags]
        if abs(across - within[gap - 1]) > worst:
            worst, same = abs(across - within[gap - 1]), within[gap - 1]
            near = 1 + int(np.argmin(np.abs(np.array(within) - across)))
            text = (
                f"points {gap} pixels apart correlate by {across:.2f} from section to section and "
                f"by {same:.2f} within one, where {across:.2f} is that of {near} pixels; "
                "check the gap, how the sections are registered, and whether the material is alike "
                "from all sides"
            )
    return text


def _fields(sections: Sequence[Image]) -> list[np.ndarray]:
    """Return what is correlated, (N, Y, X) each: grey values, or whether points are of a phase."""
    if sections[0].kind != "labels":
        return [np.stack([grey_values(each) for each in sections]).astype(np.float64)]
    labels = np.stack([each.values for each in sections])
    present = np.unique(labels)
    chosen = present[1:] if len(present) == 2 else present
    return [(labels == label).astype(np.float64) for label in chosen]


def _within(values: np.ndarray, lag: int) -> float:
    """Return the covariance of points of a section along rows and columns, `lag` apart."""
    down = (values[:, lag:] * values[:, :-lag]).mean()
    along = (values[:, :, lag:] * values[:, :, :-lag]).mean()
    return float(down + along) / 2

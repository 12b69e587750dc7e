"""What real material differs by: equal parts of the exemplar, and the band in which another sample of it would lie.

The spread between parts is that of small samples. The variance of a mean over a volume V falls as 1 / V once V is many
correlation lengths wide (Matheron 1971; Lantuejoul 1991, doi:10.1111/j.1365-2818.1991.tb03111.x), so the spread of
samples as large as the judged image follows from that of the parts. The exemplar is a sample as well, and its own
uncertainty is added.

Faces cut pores and struts, which moves the mean of small samples by a share that falls with their side. The parts and the
whole exemplar say how far; the same law gives the mean at the image's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from trabecula.core.image import Image
from trabecula.report.quantiles import student

LEAST_PART = 24
"""A part of fewer voxels a side says little about the material."""

LEAST_COUNT = 4
"""Fewer parts know no spread."""

CONFIDENCE = 0.99
"""Share of other samples of the material that lie inside the band of one figure. Some forty figures are judged, many of them
kin to each other: at 0.95 every second sample of the very same material would fail somewhere."""


def parts(exemplar: Image, *, shape: Sequence[int] | None = None) -> Iterator[Image]:
    """Yield halves of the exemplar along every axis whose halves are long enough; none where no axis is.

    Every part has the same shape: of an odd side the middle slice is left out.

    Parameters
    ----------
    exemplar : Image
    shape : sequence of int, optional
        Voxels of a part, where that is less than half of a side: then as many beside each other as fit, evenly spread.
    """
    choices = []
    for side, wanted in zip(exemplar.shape, exemplar.shape if shape is None else shape, strict=True):
        width = max(LEAST_PART, min(side // 2, wanted))
        count = side // width if side // 2 >= LEAST_PART else 1
        starts = [n * (side - width) // (count - 1) for n in range(count)] if count > 1 else []
        choices.append([slice(start, start + width) for start in starts] or [slice(0, side)])
    if all(len(choice) == 1 for choice in choices):
        return
    for box in product(*choices):
        yield Image(
            np.ascontiguousarray(exemplar.values[box]),
            exemplar.kind,
            spacing=exemplar.spacing,
            unit=exemplar.unit,
            phases=exemplar.phases,
        )


def expected_value(values: Sequence[float], own: float, sizes: tuple[float, float, float], ndim: int) -> float:
    """Return the mean of samples as large as the image, by the law that faces bias in proportion to 1 / side.

    Parameters
    ----------
    values : sequence of float
        Of the parts.
    own : float
        Of the whole exemplar.
    sizes : three floats
        Voxels of a part, of the exemplar, of the image.
    ndim : int
    """
    part, whole, image = (size ** (-1 / ndim) for size in sizes)
    share = (image - whole) / (part - whole)
    return own + (float(np.mean(values)) - own) * min(share, 1.0)


def value_band(
    values: Sequence[float], own: float, sizes: tuple[float, float, float], ndim: int
) -> tuple[float, float]:
    """Return where a figure of another sample of the image's size lies, 99 times in 100.

    Parameters
    ----------
    values, own, sizes, ndim
        As of `expected_value`; `LEAST_COUNT` values at least.

    Returns
    -------
    low, high : float
        The exemplar's own value lies between them. Not below 0 where no part is.
    """
    part, whole, image = sizes
    count = len(values)
    deviation = float(np.std(values, ddof=1))
    reach = student(count - 1, (1 + CONFIDENCE) / 2) * deviation * math.sqrt(part / image + part / whole)
    expected = expected_value(values, own, sizes, ndim)
    low, high = min(own, expected) - reach, max(own, expected) + reach
    # Quantities that cannot be negative stay so; a solver may leave a hair below 0 where nothing bears.
    positive = min(*values, own) >= -1e-6 * max(abs(value) for value in values)
    return (max(low, 0.0) if positive else low), high


def distance_limit(values: Sequence[float], sizes: tuple[float, float, float]) -> float:
    """Return how far from the exemplar another sample of the image's size lies at most, 99 times in 100.

    A part lies inside the exemplar, so that its squared distance to the whole is 1 / part - 1 / whole of the variance of a unit
    volume; that of an independent sample is 1 / image + 1 / whole.

    Parameters
    ----------
    values : sequence of float
        Distances of the parts to the whole, `LEAST_COUNT` at least.
    sizes : three floats
        Voxels of a part, of the exemplar, of the image.
    """
    part, whole, image = sizes
    count = len(values)
    # Some distances are of a single number, and scatter like a folded normal: the two-sided quantile covers them as well.
    further = student(count - 1, (1 + CONFIDENCE) / 2) * float(np.std(values, ddof=1)) * math.sqrt(1 + 1 / count)
    scale = math.sqrt((1 / image + 1 / whole) / (1 / part - 1 / whole))
    return scale * max(float(np.mean(values)) + further, float(np.max(values)))


def draw_limit(values: Sequence[float], noise: float) -> float:
    """Return what one more figure that no size changes stays below: three standard deviations above the mean of those known.

    Parameters
    ----------
    values : sequence of float
        Two at least as a rule, too few to know their own scatter.
    noise : float
        Standard deviation that measuring alone gives.
    """
    known = np.asarray(values, np.float64)
    deviation = max(noise, float(known.std(ddof=1)) if len(known) > 1 else 0.0)
    return max(float(known.mean()) + 3 * deviation, float(known.max()))

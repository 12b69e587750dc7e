"""Bands: equal parts of the exemplar, and the interval of another sample of its material.

The spread between parts is that of small samples. The variance of a mean over a volume V falls as 1
/ V once V is many correlation lengths wide (Matheron 1971; Lantuejoul 1991,
doi:10.1111/j.1365-2818.1991.tb03111.x), and more slowly, as V to the power -a, where density also
varies over long distances, as in bone (the exponent of Dirrenberger, Forest, Jeulin 2014,
doi:10.1016/j.ijsolstr.2014.06.006). The exemplar's own windows give a. So the spread of samples as
large as the judged image follows from that of the parts. The exemplar is a sample as well, and its
own uncertainty is added.

Faces cut pores and struts, which moves the mean of small samples by a share that falls with their
side. The parts and the whole exemplar say how far; the same law gives the mean at the image's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.core.image import Image
from trabecula.numerics.quantiles import student

LEAST_PART = 24
"""A part of fewer voxels a side says little about the material."""

LEAST_COUNT = 4
"""Fewer parts know no spread."""

LONG_RANGE = 6
"""An exemplar shorter than this many correlation lengths holds too little of its material to judge
by.
"""

CONFIDENCE = 0.99
"""Share of other samples of the material that lie inside the band of one figure. Some forty figures
are judged, many of them kin to each other: at 0.95 every second sample of the very same material
would fail somewhere."""


def parts(
    exemplar: Image, *, shape: Sequence[int] | None = None, share: int | None = None
) -> Iterator[Image]:
    """Yield the parts of `part_boxes` as images.

    Parameters
    ----------
    exemplar : Image
    shape : sequence of int, optional
        Largest part, voxels.
    share : int, optional
        Parts along a side. Default: as `part_boxes`.
    """
    for box in part_boxes(exemplar.shape, largest=shape, share=share):
        yield Image(
            np.ascontiguousarray(exemplar.values[box]),
            exemplar.kind,
            spacing=exemplar.spacing,
            unit=exemplar.unit,
            phases=exemplar.phases,
        )


def part_boxes(
    shape: Sequence[int], *, largest: Sequence[int] | None = None, share: int | None = None
) -> list[tuple[slice, ...]]:
    """Return boxes of halves of a volume, or of thirds of a picture, along every axis that is long
    enough.

    None where no axis is. All boxes have the same shape; what is left over of a side lies between
    them.

    Parameters
    ----------
    shape : sequence of int
        Voxels of the exemplar.
    largest : sequence of int, optional
        Voxels of a part, where that is less: then as many beside each other as fit, evenly spread.
    share : int, optional
        Parts along a side. Default: 2 of a volume; 3 of a picture with room for them, since four
        parts are too few to know a spread.
    """
    choices = []
    for side, wanted in zip(shape, shape if largest is None else largest, strict=True):
        along = share or (3 if len(shape) == 2 and side // 3 >= LEAST_PART else 2)
        width = max(LEAST_PART, min(side // along, wanted))
        count = side // width if side // 2 >= LEAST_PART else 1
        starts = [n * (side - width) // (count - 1) for n in range(count)] if count > 1 else []
        choices.append([slice(start, start + width) for start in starts] or [slice(0, side)])
    return [] if all(len(choice) == 1 for choice in choices) else list(product(*choices))


@dataclass(frozen=True)
class Sizes:
    """Sizes of the samples that a band is about."""

    part: float
    """Voxels of a part of the exemplar."""
    whole: float
    """Voxels of the exemplar."""
    image: float
    """Voxels of the image, or of all images that its figures are means of."""
    ndim: int = 3
    exponent: float = 1.0
    """By which the variance of a mean falls with the volume, 0 to 1."""

    def variance(self, voxels: float) -> float:
        """Return the variance of a mean over so many voxels, over that of a mean over a part."""
        return (self.part / voxels) ** self.exponent


def expected_value(values: Sequence[float], own: float, sizes: Sizes) -> float:
    """Return the mean of samples as large as the image, by the law that faces bias in proportion to
    1 / side.

    Parameters
    ----------
    values : sequence of float
        Of the parts.
    own : float
        Of the whole exemplar.
    sizes : Sizes
    """
    part, whole, image = (
        size ** (-1 / sizes.ndim) for size in (sizes.part, sizes.whole, sizes.image)
    )
    share = (image - whole) / (part - whole)
    return own + (float(np.mean(values)) - own) * min(share, 1.0)


def value_band(values: Sequence[float], own: float, sizes: Sizes) -> tuple[float, float]:
    """Return the band of a figure of another sample of the image's size, 99 times in 100.

    Parameters
    ----------
    values, own, sizes
        As of `expected_value`; `LEAST_COUNT` values at least.

    Returns
    -------
    low, high : float
        The exemplar's own value lies between them. Not below 0 where no part is.
    """
    reach = value_reach(values, sizes)
    expected = expected_value(values, own, sizes)
    low, high = min(own, expected) - reach, max(own, expected) + reach
    # Quantities that cannot be negative stay so; a solver may leave a hair below 0 where nothing
    # bears.
    positive = min(*values, own) >= -1e-6 * max(abs(value) for value in values)
    return (max(low, 0.0) if positive else low), high


def value_reach(values: Sequence[float], sizes: Sizes) -> float:
    """Return how far a figure of another sample of the image's size lies from the exemplar's, 99
    times in 100, where faces bias neither; the parameters are those of `value_band`.
    """
    count = len(values)
    # Parts scatter around the mean of the exemplar that they lie in, not around that of the
    # material.
    seen = count / (count - 1) * (1 - sizes.variance(sizes.whole))
    deviation = float(np.std(values, ddof=1)) / math.sqrt(seen)
    further = math.sqrt(sizes.variance(sizes.image) + sizes.variance(sizes.whole))
    return student(count - 1, (1 + CONFIDENCE) / 2) * deviation * further


def distance_limit(values: Sequence[float], sizes: Sizes) -> float:
    """Return the largest distance of another sample of the image's size to the exemplar, 99 times
    in 100.

    A part lies inside the exemplar, so that its squared distance to the whole has the variance of a
    part less that of the whole; that of an independent sample has its own variance and that of the
    whole.

    Parameters
    ----------
    values : sequence of float
        Distances of the parts to the whole, `LEAST_COUNT` at least.
    sizes : Sizes
    """
    count = len(values)
    # Some distances are of a single number, and scatter like a folded normal: the two-sided
    # quantile covers them as well.
    further = _reach_of_draw(count, float(np.std(values, ddof=1)))
    whole = sizes.variance(sizes.whole)
    scale = math.sqrt((sizes.variance(sizes.image) + whole) / (1 - whole))
    return scale * max(float(np.mean(values)) + further, float(np.max(values)))


def excess_limit(values: Sequence[float], own: float, sizes: Sizes) -> float:
    """Return the limit of a figure that is 0 but for chance, such as a norm of differences, 99
    times in 100.

    Its chance falls as the standard deviation of a mean does; the exemplar's own value is no
    chance.

    Parameters
    ----------
    values, own, sizes
        As of `value_band`.
    """
    count = len(values)
    excess = np.abs(np.asarray(values) - own)
    further = _reach_of_draw(count, float(excess.std(ddof=1)))
    scale = math.sqrt(sizes.variance(sizes.image) + sizes.variance(sizes.whole))
    return own + scale * (float(excess.mean()) + further)


def _reach_of_draw(count: int, deviation: float) -> float:
    """Return how far one more draw lies from the mean of `count`, which have that deviation."""
    return student(count - 1, (1 + CONFIDENCE) / 2) * deviation * math.sqrt(1 + 1 / count)


def draw_limit(values: Sequence[float], noise: float) -> float:
    """Return the limit of one more draw of a figure that no size changes: three standard deviations
    above the mean of those known.

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

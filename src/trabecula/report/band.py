"""What real material differs by: equal parts of the exemplar, and the band in which one more of them would lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from trabecula.core.image import Image

LEAST_PART = 24
"""A part of fewer voxels a side says little about the material."""

DRAWS = 4000
CONFIDENCE = 0.95


def parts(exemplar: Image, *, shape: Sequence[int] | None = None) -> Iterator[Image]:
    """Halves of the exemplar along every axis whose halves are long enough; none where no axis is.

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


def prediction_band(values: Sequence[float], *, one_sided: bool = False) -> tuple[float, float]:
    """In which a figure of one more part would lie 19 times in 20, by bootstrap of the parts' own figures.

    A draw is the mean of resampled parts plus a deviation that one of the parts has from the mean, stretched by
    sqrt(n / (n - 1)) since the mean was fitted to the parts (Davison and Hinkley 1997, "Bootstrap Methods and their
    Application", doi:10.1017/CBO9780511802843, section 6.3.3). The draws are always the same. No figure of a part lies
    outside.

    Parameters
    ----------
    values : sequence of float
        One a part, two at least.
    one_sided : bool
        From 0 up: of distances.

    Returns
    -------
    low, high : float
    """
    known = np.asarray(values, np.float64)
    count = len(known)
    rng = np.random.default_rng(0)
    means = known[rng.integers(count, size=(DRAWS, count))].mean(axis=1)
    deviations = (known - known.mean()) * np.sqrt(count / max(count - 1, 1))
    draws = means + deviations[rng.integers(count, size=DRAWS)]
    if one_sided:
        return 0.0, float(max(np.quantile(draws, CONFIDENCE), known.max()))
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    low, high = min(low, known.min()), max(high, known.max())
    # Quantities that cannot be negative stay so; a solver may leave a hair below 0 where nothing bears.
    positive = known.min() >= -1e-6 * np.abs(known).max()
    return float(max(low, 0.0) if positive else low), float(high)

"""The Euler number of a volume, judged by parallel sections: what no single picture shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.disector import disector_along, disector_euler_density
from trabecula.report.band import LEAST_COUNT, Sizes, part_boxes, value_band
from trabecula.report.metrics import Metric

NAME = "disector_euler_density"
"""Of the figure."""


def judge_sections(sections: Sequence[Image], gap: int, image: Image) -> dict[str, Metric]:
    """Judge the Euler number per volume of the solid by parallel sections.

    Both are measured from pairs of sections as far apart, so that what is too small for the gap is
    missed in both. Parts of the sections say how much the estimate scatters.

    Parameters
    ----------
    sections : sequence of Image, (Y, X)
        Two or more, `gap` pixels from one to the next.
    gap : int
    image : Image, (Z, Y, X)
        Labels; pairs of its slices across all three axes are measured, where it has them.
    """
    axes = [axis for axis in range(3) if image.shape[axis] > gap]
    if image.kind != "labels" or not axes:
        return {}
    value = float(np.mean([disector_along(image, gap=gap, axis=axis) for axis in axes]))
    own = disector_euler_density(sections, gap=gap)
    boxes = part_boxes(sections[0].shape)
    if len(boxes) < LEAST_COUNT:
        return {NAME: Metric(value, None, None, own)}
    known = [
        disector_euler_density([_part(each, box) for each in sections], gap=gap) for box in boxes
    ]
    layers = gap * (len(sections) - 1)
    part = layers * float(np.prod([each.stop - each.start for each in boxes[0]]))
    sizes = Sizes(part, layers * float(np.prod(sections[0].shape)), float(np.prod(image.shape)))
    low, high = value_band(known, own, sizes)
    return {NAME: Metric(value, (low, high), low <= value <= high, own)}


def _part(section: Image, box: tuple[slice, ...]) -> Image:
    return replace(section, values=np.ascontiguousarray(section.values[box]))

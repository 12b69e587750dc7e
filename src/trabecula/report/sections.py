"""The Euler number of a volume, judged by parallel sections: what no single picture shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.disector import density_between, disector_along
from trabecula.measure.phases import indicator
from trabecula.report.band import LEAST_COUNT, Sizes, part_boxes, value_reach
from trabecula.report.metrics import Metric

FIGURE = "disector_euler_density"
"""What sections judge."""


def judge_sections(
    sections: Sequence[Image], gap: int, image: Image, *, trusted: bool = True
) -> dict[str, Metric]:
    """Judge the Euler number per volume of the solid by parallel sections.

    Both are measured from pairs of sections as far apart, so that what is too thin for the gap is
    missed in both. Parts of the sections say how much the estimate scatters.

    Parameters
    ----------
    sections : sequence of Image, (Y, X)
        Two or more, `gap` pixels from one to the next.
    gap : int
    image : Image, (Z, Y, X)
        Pairs of its slices across all three axes are measured, where it has them.
    trusted : bool
        Whether the sections may be as far apart as that; else the figures are shown alone.

    Returns
    -------
    metrics : dict
        Empty of images that are no labels, or have no side longer than the gap.
    """
    axes = [axis for axis in range(3) if image.shape[axis] > gap]
    if image.kind != "labels" or not axes:
        return {}
    value = float(np.mean([disector_along(image, gap=gap, axis=axis) for axis in axes]))
    edges, height = sections[0].spacing, gap * sections[0].spacing[0]
    inside = np.stack([indicator(each, None)[1] for each in sections])
    own = density_between(inside, edges, height=height)
    boxes = part_boxes(sections[0].shape)
    if len(boxes) < LEAST_COUNT or not trusted:
        return {FIGURE: Metric(value, None, None, own)}
    known = [density_between(inside[:, y, x], edges, height=height) for y, x in boxes]
    layers = gap * (len(sections) - 1)
    part = layers * float(np.prod([each.stop - each.start for each in boxes[0]]))
    sizes = Sizes(part, layers * float(np.prod(sections[0].shape)), float(np.prod(image.shape)))
    reach = value_reach(known, sizes)
    return {FIGURE: Metric(value, (own - reach, own + reach), abs(value - own) <= reach, own)}

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


class SectionJudge:
    """Parallel sections, measured once, that judge the Euler number per volume of the solid.

    Volumes are measured from pairs of slices as far apart, so that what is too thin for the gap is
    missed in both. Parts of the sections say how much the estimate scatters.

    Parameters
    ----------
    sections : sequence of Image, (Y, X)
        Two or more of labels, `gap` pixels from one to the next.
    gap : int
    trusted : bool
        Whether the sections may be as far apart as that; else figures are shown alone.
    """

    def __init__(self, sections: Sequence[Image], gap: int, *, trusted: bool = True) -> None:
        edges, boxes = sections[0].spacing, part_boxes(sections[0].shape)
        inside, height = np.stack([indicator(each, None)[1] for each in sections]), gap * edges[0]
        self.gap, self.own = gap, density_between(inside, edges, height=height)
        self.known: list[float] = []
        """Of the parts; none where nothing is judged."""
        if len(boxes) >= LEAST_COUNT and trusted:
            self.known = [density_between(inside[:, y, x], edges, height=height) for y, x in boxes]
            layers = gap * (len(sections) - 1)
            self._part = layers * float(np.prod([each.stop - each.start for each in boxes[0]]))
            self._whole = layers * float(np.prod(sections[0].shape))

    def judge(self, image: Image) -> dict[str, Metric]:
        """Judge a volume of labels by pairs of its slices across all axes that are longer than the
        gap; nothing where none is.
        """
        axes = [axis for axis in range(3) if image.shape[axis] > self.gap]
        if not axes:
            return {}
        value = float(np.mean([disector_along(image, gap=self.gap, axis=axis) for axis in axes]))
        if not self.known:
            return {FIGURE: Metric(value, None, None, self.own)}
        sizes = Sizes(self._part, self._whole, float(np.prod(image.shape)))
        reach = value_reach(self.known, sizes)
        low, high = self.own - reach, self.own + reach
        return {FIGURE: Metric(value, (low, high), low <= value <= high, self.own)}

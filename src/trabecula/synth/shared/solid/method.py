"""Learning from pictures for search and vote on planes, and its memory forecast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.synth.shared.coarse_to_fine import levels_that_fit
from trabecula.synth.shared.content.fields import channels_of
from trabecula.synth.shared.matching.principal_components import basis_bytes, grain_of
from trabecula.synth.shared.orient import symmetries
from trabecula.synth.shared.pictures import PictureMethod

PROCESS = 180 << 20
"""Bytes of the interpreter with NumPy, Numba and the kernels loaded."""


class Solid(PictureMethod):
    """A method that makes a volume of which planes look like pictures."""

    config: Any

    def _width(self) -> int:
        return int(self.config.neighbourhood)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the fields and neighbourhoods of the levels learnt so far, and the memory for
        learning the next one beside them.
        """
        exemplars = self._shown(exemplars)
        featured = bool(self.config.feature) and exemplars[0].kind != "labels"
        channels, width = channels_of(exemplars) + featured, self._width()
        turns = len(symmetries(self.config.orientations, ndim=2))
        size = channels * sum(int(np.prod(image.shape)) for image in exemplars)
        kept, peak = 0, 16 * size
        for index in range(
            levels_that_fit(
                min(min(image.shape) for image in exemplars), self.config.levels, width=width
            )
        ):
            smooth = grain_of(width, smooth=exemplars[0].kind == "labels" and index == 0) == 2
            length = channels * width**2 // (4 if smooth else 1)
            places = [[side // 2**index - width + 1 for side in image.shape] for image in exemplars]
            count = turns * sum(y * x for y, x in places)
            most = min(self.config.components, length)
            features = 2 * most * count
            # A sample of up to 8192 is held twice, of sums over blocks in float64 as well.
            basis = basis_bytes(length, count) + min(8192, count) * length * (12 if smooth else 4)
            rows = features + 8 * count + min(4096, count) * (4 * length + 16 * most)
            peak = max(peak, kept + max(basis, rows))
            kept += features + turns * size // 4**index
        return {"interpreter and kernels": PROCESS, "fields": 5 * size, "neighbourhoods": peak}

"""`chen`: the frame of `shared.solid` with voxels that are pixels, and with two histograms pushed towards even use.

The index histogram (how often a neighbourhood was chosen) makes distances longer in the search; the position histogram (of how
many voxels a pixel is the source) makes a pixel count less in the vote, and dearer as a source.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.exemplar.views import View
from trabecula.synth.chen import SPEC
from trabecula.synth.chen.config import ChenConfig
from trabecula.synth.shared.content import completed
from trabecula.synth.shared.matching.planes import Frame, chosen_planes, voted_planes
from trabecula.synth.shared.orient import oriented, symmetries
from trabecula.synth.shared.solid import Solid, SolidModel, State

_DEAREST = 64  # times: beyond it a pixel costs no more


class Chen(Solid):
    """Solid texture synthesis with position and index histograms."""

    spec = SPEC
    config_type = ChenConfig

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> ChenModel:
        return ChenModel(self.config, exemplars, views)


class ChenModel(SolidModel):
    """Pictures as pyramids of fields."""

    spec = SPEC
    config: ChenConfig

    def _voted(
        self, frame: Frame, state: State, matches: tuple[np.ndarray, ...], weights: Sequence[np.ndarray], trim: int
    ) -> State:
        excess = excess_of(state.sources, frame, self.config.position_penalty)
        factors = [np.maximum(np.rint(frame.full / over), 1).astype(np.int16) for over in excess]
        votes = voted_planes(frame, matches, weights, factors=factors, trim=trim)
        made = self._made(frame, matches, votes)
        if not self.config.discrete:
            return made
        aim = made.field.astype(np.int16) * np.int16(256) if self.config.histogram else votes
        dear = [np.minimum(np.rint(over * 4), 4 * _DEAREST).astype(np.int32) for over in excess]
        field, sources = chosen_planes(frame, matches, weights, aim, dear=dear, trim=trim)
        field = frame.region.bounded(field)
        return State(matches, field.astype(np.int16) * np.int16(256), field, sources)

    def _bytes(self, channels: int, request: Request) -> int:
        """Beside what a vote takes, the least distances and the sources."""
        return super()._bytes(channels, request) + 16

    def _delivered(self, state: State, request: Request) -> np.ndarray:
        """Grey values and colours are those of the pixels themselves: matching channel by channel would make new colours."""
        if self.content.distances or not self.config.discrete or state.sources is None:
            return super()._delivered(state, request)
        pixels = np.concatenate([self._pixels(place) for place in range(len(self.views))])
        inside = tuple(slice(side) for side in request.shape)
        return completed(pixels[state.sources[inside]], request, empty=0)

    def _pixels(self, place: int) -> np.ndarray:
        """The values of a view's pixels in the order of its sources on the finest level: (n,) or (n, 3)."""
        image, candidates = self.views[place].image, self.levels[0].views[place][1]
        numbers = np.arange(image.values[..., 0].size if image.kind == "colour" else image.values.size)
        order = np.zeros(candidates.stack.field.shape[1:], np.int64)
        turns = symmetries(self.config.orientations, ndim=2, spacing=image.spacing)
        for start, turn in zip(candidates.stack.starts, turns, strict=True):
            turned = oriented(numbers.reshape(1, *image.shape), turn)[0]
            order[start, : turned.shape[0], : turned.shape[1]] = turned
        return image.values.reshape(len(numbers), -1)[order.ravel()].reshape(-1, *image.values.shape[2:])


def excess_of(sources: np.ndarray | None, frame: Frame, strength: float) -> list[np.ndarray]:
    """1 + strength times (n - 1) for every pixel (z, y, x) of every view that is the source of n > 1 times its even share."""
    shapes = [plane.grid.candidates.stack.field.shape[1:] for plane in frame.planes]
    sizes = [int(np.prod(shape)) for shape in shapes]
    if sources is None or not strength:
        return [np.ones(shape) for shape in shapes]
    counts = np.bincount(sources[sources >= 0], minlength=sum(sizes))
    even = max(1, int(counts.sum())) / sum(sizes)
    over = 1 + strength * np.maximum(counts / even - 1, 0)
    parts = np.split(over, np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]

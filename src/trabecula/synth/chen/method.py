"""`chen`: the loop of `shared.solid` with voxels that are pixels, and with two histograms pushed
towards even use.

The index histogram (how often a neighbourhood was chosen) makes distances longer in the search; the
position histogram (of how many voxels a pixel is the source) makes a pixel count less in the vote,
and cost more as a source.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.exemplar.views import View
from trabecula.synth.chen import CAPABILITIES
from trabecula.synth.chen.config import ChenConfig
from trabecula.synth.chen.pixels import choose_pixels, position_excess
from trabecula.synth.shared.content.fields import votes_of
from trabecula.synth.shared.content.kinds import complete
from trabecula.synth.shared.matching.planes import cast_plane_votes
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.solid.method import Solid
from trabecula.synth.shared.solid.model import SolidModel
from trabecula.synth.shared.solid.run import SolidRounds, SolidStage

_LARGEST_COST = 64  # times that of a pixel used evenly


class Chen(Solid):
    """Solid texture synthesis with position and index histograms."""

    capabilities = CAPABILITIES
    config_type = ChenConfig

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> ChenModel:
        return ChenModel(self.config, exemplars, views)


class ChenRounds(SolidRounds):
    """A run in which voxels become pixels of the pictures, all of them used evenly."""

    config: ChenConfig

    def cast(self, stage: SolidStage, trim: int) -> None:
        """Cast the votes, and give every voxel the matched pixel that is nearest to their mean."""
        views = stage.views
        excess = position_excess(self.sources, views, self.config.position_penalty)
        factors = [np.maximum(np.rint(views.full / over), 1).astype(np.int16) for over in excess]
        votes = cast_plane_votes(views, self.matches, self.weights, factors=factors, trim=trim)
        self.use_votes(stage, votes)
        if self.config.discrete:
            aim = self.field if self.config.histogram else votes
            costs = [
                np.minimum(np.rint(over * 4), 4 * _LARGEST_COST).astype(np.int32) for over in excess
            ]
            field, self.sources = choose_pixels(
                views, self.matches, self.weights, aim, costs=costs, trim=trim
            )
            self.field = views.region.clip_to_bounds(field)
            self.votes = votes_of(self.field)
        self.weights = []


class ChenModel(SolidModel):
    """Pictures as pyramids of fields."""

    capabilities = CAPABILITIES
    rounds_type = ChenRounds
    config: ChenConfig

    @property
    def _chooses(self) -> bool:
        """Return whether voxels become pixels of the pictures."""
        return self.config.discrete

    def _to_values(self, rounds: SolidRounds, request: Request) -> np.ndarray:
        """Return the pixels' own grey values and colours: matching channel by channel would make
        new colours.
        """
        if self.content.distances or not self.config.discrete or rounds.sources is None:
            return super()._to_values(rounds, request)
        sources = rounds.sources
        pixels = np.concatenate([self._pixels(place) for place in range(len(self.views))])
        depth, height, across = request.shape
        values = memmap.empty((*request.shape, *pixels.shape[1:]), pixels.dtype)

        def work(start: int, stop: int) -> None:
            for z in range(start, stop):
                values[z] = pixels[sources[z, :height, :across]]

        for_slabs(work, depth)
        return complete(values, request, empty=0)

    def _pixels(self, place: int) -> np.ndarray:
        """Return the values of a view's pixels in the order of its sources on the finest level:
        (n,) or (n, 3).
        """
        image, candidates = self.views[place].image, self.levels[0].views[place][1]
        numbers = np.arange(
            image.values[..., 0].size if image.kind == "colour" else image.values.size
        )
        order = np.zeros(candidates.stack.field.shape[1:], np.int64)
        turns = symmetries(self.config.orientations, ndim=2, spacing=image.spacing)
        for start, turn in zip(candidates.stack.starts, turns, strict=True):
            turned = apply_symmetry(numbers.reshape(1, *image.shape), turn)[0]
            order[start, : turned.shape[0], : turned.shape[1]] = turned
        return image.values.reshape(len(numbers), -1)[order.ravel()].reshape(
            -1, *image.values.shape[2:]
        )

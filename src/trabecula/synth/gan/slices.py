"""Volumes from pictures: slices of what is generated are judged as the pictures are, along every
axis that a picture is seen across (Kench and Cooper 2021, SliceGAN, Nature Machine Intelligence 3).

The generator is the one that learns from volumes. Each picture has a discriminator of its own, one
picture in all planes has one for all of them. Crops of pictures and slices of generated crops are
tensors (N, V, K, Y, X): V views, in the order of the axes that they are seen across. Of parallel
sections pairs are judged, with the channels of both: two near sections say how a material
continues across a plane (the disector of stereology, see `measure.disector`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from trabecula.core.seeds import generator, key
from trabecula.exemplar.views import View
from trabecula.synth.gan import losses
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.local_fractions import CELL, LocalFractions
from trabecula.synth.gan.networks import HALO, TwoScales
from trabecula.synth.gan.orientations import Turn, oriented

STEP = 4
"""Every so many slices of a generated crop are judged; the first moves on by one an iteration."""


@dataclass(frozen=True)
class PictureFields:
    """The fields of pictures, the views in which they are seen, and their orientations.

    Parameters
    ----------
    pictures : tuple of (K, Y, X) float32 tensor
        As the values of `TrainingFields`; with a gap the sections, in their order.
    views : tuple of (int, int)
        Axis of the volume that a plane is seen across, and the number of its picture.
    turns : tuple
        The orientations of a picture that count as alike.
    crop : int
        Edge of a crop, pixels.
    local : LocalFractions, optional
        Fractions around cells in space, as the pictures have them.
    gap : int
        Pixels from one to the next where the pictures are parallel sections; 0 where they are not.
    """

    pictures: tuple[Tensor, ...]
    views: tuple[tuple[int, int], ...]
    turns: tuple[Turn, ...]
    crop: int
    local: LocalFractions | None = None
    gap: int = 0

    @property
    def channels(self) -> int:
        """Return the number of channels of a picture."""
        return len(self.pictures[0])

    @property
    def device(self) -> torch.device:
        """Return the device of the pictures."""
        return self.pictures[0].device

    def crops(self, count: int, seed: int, iteration: int) -> Tensor:
        """Return as many crops for each view as `count` generated crops have slices, (N, V, K,
        crop, crop), random in place and orientation: a function of seed and iteration alone.
        """
        random = generator(seed, "gan/crops", iteration)
        number = count * len(_places(self.crop, self.gap, iteration))
        found = []
        for _, picture in self.views:
            values, c = self.pictures[picture], self.crop
            if self.gap:
                lower = int(random.integers(0, len(self.pictures) - 1))
                pair = self.pictures[lower : lower + 2]
                # No side is up in a material that is alike from all sides.
                values = torch.cat(pair if random.integers(0, 2) else pair[::-1])
            starts = random.integers(0, np.asarray(values.shape[1:]) - c + 1, (number, 2)).tolist()
            turns = random.integers(0, len(self.turns), number).tolist()
            parts = [
                oriented(values[:, y : y + c, x : x + c], self.turns[turn])
                for (y, x), turn in zip(starts, turns, strict=True)
            ]
            found.append(torch.stack(parts))
        return torch.stack(found, 1)

    def given(self, count: int, seed: int, iteration: int) -> Tensor | None:
        """Return fractions around the cells of `count` generated crops and of the generator's halo,
        in deviations from the mean, (count, K, z, y, x): no picture knows those of its
        surroundings, so they are drawn. None where it is given none.
        """
        if self.local is None:
            return None
        drawn = key(seed, f"gan/given/{iteration}")
        sides = (self.crop // CELL + 2 * HALO,) * 3
        apart = 4 * max(sides)
        crops = [self.local.draw(drawn, (apart * n, 0, 0), sides, (0, 0, 0)) for n in range(count)]
        return torch.from_numpy(np.stack(crops)).to(self.device)

    def on(self, device: torch.device) -> PictureFields:
        """Return the same on a device."""
        return replace(self, pictures=tuple(picture.to(device) for picture in self.pictures))

    def distance(self, field: Tensor, random: torch.Generator) -> float:
        """Return the distance of neighbourhoods (`losses.sliced`) of the slices of a field (1, K,
        Z, Y, X) to those of the pictures, a mean over views.
        """
        total = 0.0
        for axis, picture in self.views:
            real = self.pictures[picture]
            sides = [side for a, side in enumerate(field.shape[2:]) if a != axis]
            y, x = (min(pair) for pair in zip(sides, real.shape[1:], strict=True))
            places = range(0, field.shape[2 + axis], 2 * STEP)
            slices = _across(field, axis, places)[..., :y, :x]
            same = real[None, :, :y, :x].expand(len(slices), -1, -1, -1)
            total += float(losses.sliced(slices, same, random))
        return total / len(self.views)


def take_slices(volumes: Tensor, axes: Sequence[int], iteration: int, *, gap: int = 0) -> Tensor:
    """Return every `STEP`-th slice of generated crops (B, K, c, c, c) across each of the axes, (B
    c / STEP, V, K, c, c); with a gap pairs of slices so far apart, (B n, V, 2 K, c, c).
    """
    places = _places(volumes.shape[2], gap, iteration)
    offsets = (0, gap) if gap else (0,)
    return torch.stack([_across(volumes, axis, places, offsets) for axis in axes], 1)


def _places(side: int, gap: int, iteration: int) -> range:
    """Return the slices of a generated crop that are judged, of pairs the first."""
    return range(iteration % STEP, side - gap, STEP)


def _across(
    volumes: Tensor, axis: int, places: Sequence[int], offsets: Sequence[int] = (0,)
) -> Tensor:
    """Return slices of (B, K, Z, Y, X) across an axis, (B n, K, rows, columns); with the channels
    of all that lie at the offsets from a place.
    """
    first = torch.tensor(places, device=volumes.device)
    parts = [volumes.index_select(2 + axis, first + offset) for offset in offsets]
    return torch.cat([part.movedim(2 + axis, 1) for part in parts], 2).flatten(0, 1)


class SliceScales(nn.Module):
    """A discriminator of two scales for each picture.

    Parameters
    ----------
    width, channels : int
    pictures : sequence of int
        Number of the picture of each view.
    """

    def __init__(self, width: int, channels: int, pictures: Sequence[int]) -> None:
        super().__init__()
        self.pictures = tuple(pictures)
        self.judges = nn.ModuleList(
            TwoScales(width, channels, axes=2) for _ in range(max(pictures) + 1)
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the verdicts (N, 1, ...) on (N, V, K, Y, X), those of each view in turn."""
        return [
            verdict
            for view, picture in enumerate(self.pictures)
            for verdict in self.judges[picture](x[:, view])
        ]


def numbered_views(views: Sequence[View]) -> tuple[tuple[View, ...], tuple[tuple[int, int], ...]]:
    """Return a view for each different picture, and (axis, number of its picture) of every view.

    A picture that is turned in one view counts as another.
    """
    different: list[View] = []
    found = []
    for view in views:
        known = [n for n, one in enumerate(different) if one.image is view.image]
        if not known:
            different.append(view)
        found.append((view.axis, known[0] if known else len(different) - 1))
    return tuple(different), tuple(found)


def new_slice_discriminator(
    config: GanConfig, channels: int, views: Sequence[tuple[int, int]]
) -> SliceScales:
    """Build the discriminator of pictures with new weights."""
    seen = judged_channels(config, channels)
    return SliceScales(config.width, seen, [picture for _, picture in views])


def judged_channels(config: GanConfig, channels: int) -> int:
    """Return the channels of what is judged: of pairs of sections those of both."""
    return 2 * channels if config.gap else channels

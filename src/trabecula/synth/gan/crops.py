"""What a training learns from: an exemplar or pictures as fields, and random crops of them.

Random numbers are functions of seed and iteration, so that a run resumes where it stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from trabecula.core.image import Image
from trabecula.core.seeds import generator
from trabecula.exemplar.views import views_of
from trabecula.synth.gan import losses
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.orientations import Turn, oriented, turns_of
from trabecula.synth.gan.slices import PictureFields, numbered_views
from trabecula.synth.shared.content.fields import phase_fields, phases_present

_TAIL = 0.001  # share of grey values beyond each end of the range that is stretched over -1 .. 1


@dataclass(frozen=True)
class TrainingFields:
    """The fields of an exemplar, and the orientations in which crops are taken.

    Parameters
    ----------
    values : (K, Z, Y, X) float32 tensor
        In -1 .. 1: one channel for two phases, rising into that of the higher label, and for grey;
        else one for each phase.
    turns : tuple
        The orientations that count as alike.
    crop : int
        Edge of a crop, voxels.
    """

    values: Tensor
    turns: tuple[Turn, ...]
    crop: int

    def crops(self, count: int, seed: int, iteration: int) -> Tensor:
        """Return (count, K, crop, crop, crop), random in place and orientation.

        They are a function of seed and iteration alone.
        """
        random = generator(seed, "gan/crops", iteration)
        c = self.crop
        starts = random.integers(0, np.asarray(self.values.shape[1:]) - c + 1, (count, 3)).tolist()
        turns = random.integers(0, len(self.turns), count).tolist()
        parts = []
        for (z, y, x), turn in zip(starts, turns, strict=True):
            part = self.values[:, z : z + c, y : y + c, x : x + c]
            parts.append(oriented(part, self.turns[turn]))
        return torch.stack(parts)

    @property
    def channels(self) -> int:
        """Return the number of channels."""
        return len(self.values)

    @property
    def device(self) -> torch.device:
        """Return the device of the values."""
        return self.values.device

    def on(self, device: torch.device) -> TrainingFields:
        """Return the same on a device."""
        return replace(self, values=self.values.to(device))

    def distance(self, field: Tensor, random: torch.Generator) -> float:
        """Return the distance of neighbourhoods (`losses.sliced`) of a field (1, K, Z, Y, X) to
        those of the exemplar, where both are.
        """
        pairs = zip(field.shape[2:], self.values.shape[1:], strict=True)
        common = [slice(min(sides)) for sides in pairs]
        mine = self.values[(None, slice(None), *common)]
        return float(losses.sliced(field[(..., *common)], mine, random))


def exemplar_fields(image: Image, config: GanConfig) -> TrainingFields:
    """Return the fields of an exemplar."""
    values = _values_of([image], config)[0]
    return TrainingFields(values, turns_of(config.orientations), config.crop)


def picture_fields(images: Sequence[Image], config: GanConfig) -> PictureFields:
    """Return the fields of pictures in the views of the config."""
    different, views = numbered_views(views_of(images, config.views))
    values = _values_of([view.image for view in different], config)
    return PictureFields(tuple(values), views, turns_of(config.orientations, axes=2), config.crop)


def fields_of(images: Sequence[Image], config: GanConfig) -> TrainingFields | PictureFields:
    """Return the fields of one volume, or of pictures."""
    if images[0].ndim == 3:
        return exemplar_fields(images[0], config)
    return picture_fields(images, config)


def _values_of(images: Sequence[Image], config: GanConfig) -> list[Tensor]:
    """Return the field (K, ...) of each of several images of one material."""
    found = []
    if images[0].kind == "grey":
        low, high = grey_range(np.concatenate([image.values.ravel() for image in images]))
        for image in images:
            stretched = (image.values.astype(np.float32) - low) * np.float32(2 / (high - low)) - 1
            found.append(np.clip(stretched, -1, 1)[None])
    else:
        present = phases_present(images)
        for image in images:
            values, _ = phase_fields(image, present)
            # A distance counts where an interface is near; tanh keeps it smooth where it
            # saturates.
            clipped = np.clip(values, -config.clip, config.clip)
            found.append(np.tanh(clipped / 2) if config.clip else np.sign(values))
    return [torch.from_numpy(np.ascontiguousarray(values, np.float32)) for values in found]


def grey_range(values: np.ndarray) -> tuple[float, float]:
    """Return the grey values at -1 and at 1."""
    low, high = np.quantile(values, [_TAIL, 1 - _TAIL])
    return float(low), float(high)

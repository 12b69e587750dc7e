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
from trabecula.synth.gan.local_fractions import CELL, REACH, LocalFractions
from trabecula.synth.gan.networks import HALO
from trabecula.synth.gan.orientations import Turn, oriented, turns_of
from trabecula.synth.gan.slices import PictureFields, numbered_views
from trabecula.synth.shared.content.fields import phase_fields, phases_present

_LEAST = 64  # voxels or pixels a side: four cells whose surroundings are known
_LEAST_CROP = CELL * (2 * REACH + 1)  # voxels: a cell and all that is around it
_MARGIN = CELL * (HALO + REACH)  # voxels beyond a crop: the generator's halo, and around it
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
    shares : (K, Z + 2 margin, ...) uint8 tensor, optional
        Voxels of the higher label, of more than two phases those of each; mirrored at the
        exemplar's faces.
    local : LocalFractions, optional
        Of the exemplar.
    """

    values: Tensor
    turns: tuple[Turn, ...]
    crop: int
    shares: Tensor | None = None
    local: LocalFractions | None = None

    def crops(self, count: int, seed: int, iteration: int) -> Tensor:
        """Return (count, K, crop, crop, crop), random in place and orientation.

        They are a function of seed and iteration alone.
        """
        return self._cut(self.values, self.crop, self._places(count, seed, iteration))

    def given(self, count: int, seed: int, iteration: int) -> Tensor | None:
        """Return the fractions around the cells of the same crops and of the generator's halo, in
        deviations from the mean: (count, K, z, y, x), or None where it is given none.
        """
        if self.shares is None or self.local is None:
            return None
        places = self._places(count, seed, iteration)
        parts = self._cut(self.shares, self.crop + 2 * _MARGIN, places)
        around = losses.fractions_around(parts.float())
        return losses.standardised(around, self.local)

    def _places(self, count: int, seed: int, iteration: int) -> list[tuple[list[int], Turn]]:
        """Return the first voxel of random crops, and their orientations."""
        random = generator(seed, "gan/crops", iteration)
        most = np.asarray(self.values.shape[1:]) - self.crop + 1
        starts = random.integers(0, most, (count, 3)).tolist()
        turns = random.integers(0, len(self.turns), count).tolist()
        return [(start, self.turns[turn]) for start, turn in zip(starts, turns, strict=True)]

    @staticmethod
    def _cut(values: Tensor, side: int, places: list[tuple[list[int], Turn]]) -> Tensor:
        """Return the crops of `side` voxels at the places."""
        parts = [
            oriented(values[:, z : z + side, y : y + side, x : x + side], turn)
            for (z, y, x), turn in places
        ]
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
        shares = None if self.shares is None else self.shares.to(device)
        return replace(self, values=self.values.to(device), shares=shares)

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
    config = effective_config(config, [image])
    values = _values_of([image], config)[0]
    found = TrainingFields(values, turns_of(config.orientations), config.crop)
    if not config.fractions:
        return found
    counted = _counted([image])
    shares = np.stack([image.values == label for label in counted]).astype(np.uint8)
    around = losses.fractions_around(torch.from_numpy(shares)[None].float())[0].numpy()
    beyond = np.pad(shares, [(0, 0), *[(_MARGIN, _MARGIN)] * 3], mode="symmetric")
    return replace(found, shares=torch.from_numpy(beyond), local=LocalFractions.of(around))


def effective_config(config: GanConfig, images: Sequence[Image]) -> GanConfig:
    """Return the config as its exemplars allow it: local fractions are those of labels, of the
    sub-pixel generator, and of crops that hold a cell and all around it; pictures have no
    distances; orientations are chosen.
    """
    if images[0].ndim == 2:
        config = replace(config, clip=0.0)
    if config.orientations == "auto":
        alike = images[0].ndim == 2 and (
            bool(config.gap) or (len(images) == 1 and len(views_of(images, config.views)) == 3)
        )
        config = replace(config, orientations="all" if alike else "inverted")
    able = (
        config.generator == "subpixel"
        and config.crop >= _LEAST_CROP
        and images[0].kind == "labels"
        and min(min(image.shape) for image in images) >= _LEAST
    )
    return config if able else replace(config, fractions=0.0)


def picture_fields(images: Sequence[Image], config: GanConfig) -> PictureFields:
    """Return the fields of pictures in the views of the config."""
    config = effective_config(config, images)
    different, views = numbered_views(views_of(images, config.views, gap=config.gap))
    shown = images if config.gap else [view.image for view in different]
    values = _values_of(shown, config)
    turns = turns_of(config.orientations, axes=2)
    found = PictureFields(tuple(values), views, turns, config.crop, gap=config.gap)
    if not config.fractions:
        return found
    counted = _counted(images)
    shares = [np.stack([image.values == label for label in counted]) for image in images]
    return replace(found, local=LocalFractions.of_pictures(shares))


def fields_of(images: Sequence[Image], config: GanConfig) -> TrainingFields | PictureFields:
    """Return the fields of one volume, or of pictures."""
    if images[0].ndim == 3:
        return exemplar_fields(images[0], config)
    return picture_fields(images, config)


def _counted(images: Sequence[Image]) -> Sequence[int]:
    """Return the labels whose fractions are given: of two the higher, of more all."""
    present = phases_present(images)
    return present[1:] if len(present) == 2 else present


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

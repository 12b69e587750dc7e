"""An exemplar as training data: fields in -1 .. 1, and random crops of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import torch
from torch import Tensor

from trabecula.core.image import Image
from trabecula.core.seeds import generator
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.shared.content.fields import phase_fields

_TAIL = 0.001  # share of grey values beyond each end of the range that is stretched over -1 .. 1

Turn = tuple[tuple[int, ...], tuple[int, ...]]
"""Order of the axes 1, 2, 3 of a field, and the axes that are then flipped."""


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
            order, flipped = self.turns[turn]
            part = self.values[:, z : z + c, y : y + c, x : x + c]
            parts.append(part.permute(0, *order).flip(flipped))
        return torch.stack(parts)

    def on(self, device: torch.device) -> TrainingFields:
        """Return the same on a device."""
        return replace(self, values=self.values.to(device))


def exemplar_fields(image: Image, config: GanConfig) -> TrainingFields:
    """Return the fields of an exemplar."""
    if image.kind == "grey":
        low, high = grey_range(image.values)
        values = np.clip(
            (image.values.astype(np.float32) - low) * np.float32(2 / (high - low)) - 1, -1, 1
        )[None]
    else:
        values, _ = phase_fields(image)
        # A distance counts where an interface is near; tanh keeps it smooth where it saturates.
        clipped = np.clip(values, -config.clip, config.clip)
        values = np.tanh(clipped / 2) if config.clip else np.sign(values)
    values = np.ascontiguousarray(values, np.float32)
    return TrainingFields(torch.from_numpy(values), turns_of(config.orientations), config.crop)


def grey_range(values: np.ndarray) -> tuple[float, float]:
    """Return the grey values at -1 and at 1."""
    low, high = np.quantile(values, [_TAIL, 1 - _TAIL])
    return float(low), float(high)


def turns_of(orientations: str) -> tuple[Turn, ...]:
    """List the orientations of a setting.

    Inverted through a point a material has the same two-point function along every direction;
    mirrored it has the same along the axes.
    """
    orders = list(permutations((1, 2, 3))) if orientations == "all" else [(1, 2, 3)]
    flips: list[tuple[int, ...]] = [()]
    if orientations == "inverted":
        flips.append((1, 2, 3))
    elif orientations in ("mirrors", "all"):
        flips = [
            tuple(axis for axis, on in zip((1, 2, 3), chosen, strict=True) if on)
            for chosen in product((0, 1), repeat=3)
        ]
    return tuple(product(orders, flips))

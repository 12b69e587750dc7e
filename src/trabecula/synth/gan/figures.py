"""What is measured of a generator while it trains: is it alive, and how near is it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from trabecula.core.image import Image
from trabecula.core.seeds import key
from trabecula.measure import euler_density, largest_fraction, two_point
from trabecula.synth.gan.calibrate import calibration_of
from trabecula.synth.gan.decode import decode
from trabecula.synth.gan.losses import sliced

SIDE = 96
"""Voxels along an edge of the volume that is looked at."""

_REACH = 30
# of the real crops' standard deviation: less, and far from the middle, is one phase
_LEAST_SPREAD = 0.2
_MIDDLE = 0.5  # a slow start is as narrow, but lies around 0
_DEAD = 0.02  # as the first, wherever it lies
_MOST_ALIKE = 0.95  # correlation of two made crops: more is one picture


def trouble_with(made: Tensor, real: Tensor, told: dict[str, float], *, grown: bool = True) -> str:
    """What is wrong with a batch of made crops (B, K, Z, Y, X), in words; empty where nothing is.

    A network that has hardly learnt yet (not `grown`) may make one phase, but numbers.
    """
    if not (
        all(np.isfinite(value) for value in told.values()) and bool(torch.isfinite(made).all())
    ):
        return "the loss is not a number any more"
    if not grown:
        return ""
    spread = float(made.std()) / max(float(real.std()), 1e-9)
    if spread < _DEAD or (spread < _LEAST_SPREAD and abs(float(made.mean())) > _MIDDLE):
        return "it makes one phase only"
    if len(made) > 1:
        a, b = (crop.flatten() - crop.mean() for crop in made[:2])
        if float(a @ b) > _MOST_ALIKE * float(a.norm() * b.norm()):
            return "it makes the same again and again"
    return ""


class Figures:
    """The exemplar's own figures, to hold a generator's against.

    Parameters
    ----------
    image : Image
        The exemplar.
    seed : int
        Of the training: every look is at the same latent.
    """

    def __init__(self, image: Image, seed: int) -> None:
        self.image, self.seed = image, seed
        self.reach = min(_REACH, min(image.shape) // 2)
        self.phases = (
            [int(label) for label in np.unique(image.values)] if image.kind == "labels" else []
        )
        self.curves = {
            label: two_point(image, r_max=self.reach, phase=label) for label in self.phases[1:]
        }

    def of(self, network: Any, fields: Tensor) -> tuple[dict[str, float], np.ndarray]:
        """Figures of a generator, and the middle slice of what it made (values).

        Parameters
        ----------
        network : generator
            Ready for use.
        fields : (K, Z, Y, X) tensor
            The exemplar's.
        """
        side = SIDE // network.cell + 2 * network.halo
        weight = next(network.parameters())
        draw = torch.Generator().manual_seed(int(key(self.seed, "gan/looks")) >> 1)
        with torch.inference_mode():
            z = torch.randn(1, network.latent, side, side, side, generator=draw).to(weight.dtype)
            field = network.cells(z.to(memory_format=torch.channels_last_3d)).float()
            common = [
                slice(min(sides)) for sides in zip(field.shape[2:], fields.shape[1:], strict=True)
            ]
            distance = float(
                sliced(field[(..., *common)], fields[(None, slice(None), *common)], draw)
            )
        calibration = calibration_of(
            network, self.image, self.seed, tiles=max(1, network.tiles // 64)
        )
        values = decode(field[0].numpy(), calibration)
        found = {"distance": distance}
        if self.curves:
            found |= self._of_labels(Image(values, "labels", phases=self.image.phases))
        return found, values[len(values) // 2]

    def _of_labels(self, made: Image) -> dict[str, float]:
        apart = []
        for label, curve in self.curves.items():
            other = two_point(made, r_max=self.reach, phase=label)
            apart.append(float(np.linalg.norm(other - curve) / np.linalg.norm(curve)))
        last = made.phases[self.phases[-1]]
        return {
            "two_point": float(np.mean(apart)),
            "largest": float(largest_fraction(made, phase=last)),
            "euler": float(euler_density(made, phase=last)),
        }

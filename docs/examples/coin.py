"""`coin`: every voxel on its own, with the exemplar's volume fractions."""

from dataclasses import dataclass

import numpy as np

from trabecula.core.seeds import generator
from trabecula.synth.api import Capabilities, Method, Model

CAPABILITIES = Capabilities(
    name="coin",
    summary="every voxel on its own, with the exemplar's volume fractions",
    paper="none",
    method="coin:Coin",
    learns_from=("volume",),
)


@dataclass(frozen=True)
class CoinConfig:
    """Settings of `coin`."""

    bias: float = 0.0
    """Added to the fraction of the last phase, -1 .. 1."""


class CoinModel(Model):
    """An exemplar, of which the fractions count."""

    capabilities = CAPABILITIES

    def make(self, request):
        """Draw every voxel."""
        bounds = np.cumsum(self.facts[0].shares[:-1]) - self.config.bias
        draw = generator(request.seed, "coin").random(request.shape)
        return np.searchsorted(bounds, draw).astype(np.uint8)


class Coin(Method):
    """Random voxels."""

    capabilities = CAPABILITIES
    config_type = CoinConfig
    model_type = CoinModel

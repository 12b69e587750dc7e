"""`dust`: random voxels from settings alone, without an exemplar."""

from dataclasses import dataclass

from trabecula.core.seeds import generator
from trabecula.synth.api import Capabilities, Method, Model

CAPABILITIES = Capabilities(
    name="dust",
    summary="random voxels of a porosity",
    paper="none",
    method="dust:Dust",
    learns_from=("settings",),
)


@dataclass(frozen=True)
class DustConfig:
    """Settings of `dust`."""

    porosity: float = 0.8
    """Volume fraction of the void, 0 .. 1."""


class DustModel(Model):
    """Settings."""

    capabilities = CAPABILITIES

    def make(self, request):
        """Draw every voxel."""
        draw = generator(request.seed, "dust").random(request.shape)
        return (draw >= self.config.porosity).astype("uint8")


class Dust(Method):
    """Random voxels."""

    capabilities = CAPABILITIES
    config_type = DustConfig
    model_type = DustModel

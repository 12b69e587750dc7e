"""`plates`: parallel plates, the same for every seed, of which any box is made alone."""

from dataclasses import dataclass

import numpy as np

from trabecula.synth.api import Capabilities, Method, WindowModel

CAPABILITIES = Capabilities(
    name="plates",
    summary="parallel plates",
    paper="none",
    method="plates:Plates",
    learns_from=("settings",),
    honours=frozenset({"mask"}),
    large="box",
    deterministic=True,
)


@dataclass(frozen=True)
class PlatesConfig:
    """Settings of `plates`."""

    distance: int = 8
    """From plate to plate along z, voxels, 2 or more."""

    thickness: int = 2
    """Of a plate, voxels."""


class PlatesModel(WindowModel):
    """Settings."""

    capabilities = CAPABILITIES

    def make_box(self, request, box):
        """Fill the plates of a box."""
        z = np.arange(*box[0]) % self.config.distance
        solid = (z < self.config.thickness).astype(np.uint8)
        shape = [stop - start for start, stop in box]
        return np.broadcast_to(solid[:, None, None], shape).copy()


class Plates(Method):
    """Parallel plates."""

    capabilities = CAPABILITIES
    config_type = PlatesConfig
    model_type = PlatesModel

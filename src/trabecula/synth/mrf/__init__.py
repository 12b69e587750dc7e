"""Maximum likelihood from one image (Urs, Da Costa, Germain 2014). See README.md in this folder."""

from trabecula.synth.api.method import Capabilities

CAPABILITIES = Capabilities(
    name="mrf",
    summary="a volume from a picture, voxel by voxel from the conditional density of its slices' neighbourhoods",
    paper="Urs, Da Costa, Germain (2014), Maximum-likelihood based synthesis of volumetric textures from a 2D sample",
    exemplar="2d",
    kinds=("labels", "grey", "colour"),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    several=True,
    presets=("fast", "best", "paper"),
    scaling="sweep",
    trial={"sweeps": (2, 3, 4)},
    target="trabecula.synth.mrf.method:Mrf",
)

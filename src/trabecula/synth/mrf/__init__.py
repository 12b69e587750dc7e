"""Maximum likelihood from one image (Urs, Da Costa, Germain 2014). See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="mrf",
    summary=(
        "a volume from a picture, voxel by voxel from the conditional density of its slices' "
        "neighbourhoods"
    ),
    paper=(
        "Urs, Da Costa, Germain (2014), Maximum-likelihood based synthesis of volumetric textures "
        "from a 2D sample"
    ),
    learns_from=("pictures",),
    kinds=("labels", "grey", "colour"),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    presets=("fast", "best", "paper"),
    large="memmap",
    trial={"sweeps": (2, 3, 4)},
    method="trabecula.synth.mrf.method:Mrf",
)

"""3-D exemplar optimisation (Zhang, Chen, Wang, Wang 2017). See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="texture",
    summary=(
        "a larger volume from a 3-D scan, by optimising every neighbourhood towards its nearest "
        "in the exemplar"
    ),
    paper=(
        "Zhang, Chen, Wang, Wang (2017), By example synthesis of three-dimensional porous materials"
    ),
    learns_from=("volumes",),
    kinds=("labels", "grey", "colour"),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    presets=("fast", "best", "paper"),
    large="memmap",
    trial={"first_rounds": 4, "rounds": (2, 2, 3)},
    targets=("porosity", "volume_fraction", "orientation", "size"),
    method="trabecula.synth.texture.method:Texture",
)

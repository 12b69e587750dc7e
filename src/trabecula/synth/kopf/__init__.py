"""Solid texture synthesis from 2-D exemplars (Kopf et al. 2007). See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="kopf",
    summary=(
        "a volume whose slices look like one picture or several, by optimising the squares in its "
        "planes together"
    ),
    paper=(
        "Kopf, Fu, Cohen-Or, Deussen, Lischinski, Wong (2007), Solid texture synthesis from 2D "
        "exemplars"
    ),
    learns_from=("pictures",),
    kinds=("labels", "grey", "colour"),
    honours=frozenset({"periodic", "mask", "fixed", "target", "coarse", "like"}),
    presets=("fast", "best", "paper"),
    large="memmap",
    trial={"first_rounds": 3, "rounds": (2, 3)},
    method="trabecula.synth.kopf.method:Kopf",
)

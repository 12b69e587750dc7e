"""Solid texture synthesis with position and index histograms (Chen and Wang 2010). See README.md in
this folder.
"""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="chen",
    summary=(
        "a volume from pictures as kopf makes it, of the pictures' own pixels, all of which are "
        "used evenly"
    ),
    paper=(
        "Chen, Wang (2010), High quality solid texture synthesis using position and index "
        "histogram matching"
    ),
    learns_from=("pictures",),
    kinds=("labels", "grey", "colour"),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    presets=("fast", "best", "paper"),
    large="memmap",
    trial={"first_rounds": 3, "rounds": (2, 3)},
    method="trabecula.synth.chen.method:Chen",
)

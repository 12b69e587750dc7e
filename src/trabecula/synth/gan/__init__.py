"""A generator learnt from one exemplar that then makes material of any size. See README.md in this
folder.
"""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="gan",
    summary="a generator learnt from one exemplar, or from pictures, in minutes, which then makes "
    "material without limit in a moment",
    paper="Zhang, Yang, Li, Wu, Wang (2021), ScaffoldGAN",
    learns_from=("volume", "pictures"),
    kinds=("labels", "grey"),
    honours=frozenset({"periodic", "mask", "target"}),
    large="box",
    stores_exemplar=False,
    trial={"iterations": 2, "minutes": 1000.0, "width": 2, "batch": 2, "crop": 64},
    method="trabecula.synth.gan.method:Gan",
    extras=("learn",),
    presets=("compact", "paper", "3dgan", "patchgan", "gram", "structural", "all"),
)

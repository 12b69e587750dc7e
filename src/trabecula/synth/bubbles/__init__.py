"""Growing bubbles (Baravalle et al. 2016). See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="bubbles",
    summary=(
        "bubbles that grow, keep a wall apart and follow a flow: foams, breads, sponges in any "
        "shape, from settings alone"
    ),
    paper=(
        "Baravalle, Scandolo, Delrieux, García Bauza, Eisemann (2016), Realistic modeling of "
        "porous materials"
    ),
    learns_from=("volume", "picture", "settings"),
    makes=("volume", "picture"),
    kinds=("labels",),
    large="box",
    method="trabecula.synth.bubbles.method:Bubbles",
    honours=frozenset({"periodic", "mask", "target"}),
    targets=("porosity", "volume_fraction", "orientation", "size"),
    presets=("bread", "baguette", "sponge", "cheese", "stone", "foam", "bone"),
    trial={"trials": 6},
)

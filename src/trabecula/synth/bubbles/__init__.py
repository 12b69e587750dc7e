"""Growing bubbles (Baravalle et al. 2016). See README.md in this folder."""

from trabecula.synth.api.method import Capabilities
from trabecula.synth.bubbles.flow.presets import PRESETS

CAPABILITIES = Capabilities(
    name="bubbles",
    summary="bubbles that grow, keep a wall apart and follow a flow: foams, breads, sponges in any shape, from settings alone",
    paper="Baravalle, Scandolo, Delrieux, García Bauza, Eisemann (2016), Realistic modeling of porous materials",
    exemplar="3d",
    kinds=("labels",),
    scaling="window",
    target="trabecula.synth.bubbles.method:Bubbles",
    honours=frozenset({"periodic", "mask", "target"}),
    presets=tuple(PRESETS),
    flat=True,
    alone=True,
    trial={"trials": 6},
)

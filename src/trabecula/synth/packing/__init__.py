"""Bodies of a scan - grains, beads, bubbles - packed anew. See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="packing",
    summary=(
        "bodies of a scan - grains, beads, bubbles - turned and packed anew: their shapes, sizes "
        "and contacts stay, no place is copied"
    ),
    paper=(
        "Garboczi (2002), Three-dimensional mathematical analysis of particle shape using X-ray "
        "tomography and spherical harmonics"
    ),
    method="trabecula.synth.packing.method:Packing",
    learns_from=("volume",),
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "target", "fixed"}),
    trial={"phase": "void", "separation": 0.9, "fillet": 0.5, "degree": 2},
    sample="cells",
)

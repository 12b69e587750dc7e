"""Long fibres of a scan, laid anew. See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="fibres",
    summary=(
        "long fibres with the directions and thicknesses of a scan's, laid anew and pushed apart: "
        "felts, papers, layers of fibres, bundles"
    ),
    paper=(
        "Altendorf, Jeulin (2011), Random-walk-based stochastic modeling of three-dimensional "
        "fiber systems"
    ),
    method="trabecula.synth.fibres.method:Fibres",
    learns_from=("volume",),
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "target"}),
    trial={"phase": "solid", "separation": 0.5, "fillet": 0.5, "bend": 0.1},
    sample="foam",
)

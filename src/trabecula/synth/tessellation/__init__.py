"""Closed grains and cells from a picture or a scan of boundaries. See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="tessellation",
    summary=(
        "closed cells or grains whose sections look like a picture or a scan of their boundaries: "
        "sizes, neighbours, thickness"
    ),
    paper=(
        "Bourne, Kok, Roper, Spanjer (2020), Laguerre tessellations and polycrystalline "
        "microstructures: a fast algorithm for generating grains of given volumes"
    ),
    method="trabecula.synth.tessellation.method:Tessellation",
    learns_from=("volume", "pictures"),
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "target"}),
    trial={"volume_spread": 0.3, "lloyd_steps": 2, "rounding": 0.0},
    sample="cells",
)

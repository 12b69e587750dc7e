"""Periodic cells: minimal surfaces and struts. See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="lattice",
    summary="periodic cells, of minimal surfaces (gyroid, Schwarz, I-WP, ...) or struts (octet, "
    "Kelvin, ...), graded by a field of porosity or by formulas of the cell",
    paper="Schoen (1970), Infinite periodic minimal surfaces without self-intersections",
    method="trabecula.synth.lattice.method:Lattice",
    learns_from=("settings",),
    honours=frozenset({"periodic", "mask", "target"}),
    targets=("porosity", "volume_fraction", "orientation", "size"),
    large="box",
    deterministic=True,
)

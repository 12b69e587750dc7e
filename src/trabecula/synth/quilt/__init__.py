"""Graded structures by graph-cut quilting (Liu and Shapiro 2016). See README.md in this folder."""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="quilt",
    summary=(
        "graded structures: patches of a scan or a section, chosen by target fields, joined along "
        "least seams, connected"
    ),
    paper="Liu, Shapiro (2016), Sample-based design of functionally graded material structures",
    learns_from=("volumes", "pictures"),
    makes=("volume", "picture"),
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "target", "fixed"}),
    presets=("fast", "paper"),
    large="memmap",
    method="trabecula.synth.quilt.method:Quilt",
    targets=(
        "porosity",
        "volume_fraction",
        "volume_fraction:",
        "surface",
        "mean_curvature",
        "perimeter",
        "euler",
        "two_point:",
        "apparent_conductivity",
        "apparent_diffusivity",
        "apparent_stiffness",
        "orientation",
        "size",
    ),
)

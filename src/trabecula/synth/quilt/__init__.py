"""Graded structures by graph-cut quilting (Liu and Shapiro 2016). See README.md in this folder."""

from trabecula.synth.api.method import Capabilities

CAPABILITIES = Capabilities(
    name="quilt",
    summary="graded structures: pieces of a scan or a section, chosen by target fields, joined along least seams, connected",
    paper="Liu, Shapiro (2016), Sample-based design of functionally graded material structures",
    exemplar="3d",
    flat=True,
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "target", "fixed"}),
    several=True,
    presets=("fast", "paper"),
    scaling="whole",
    target="trabecula.synth.quilt.method:Quilt",
    targets=(
        "porosity",
        "volume_fraction",
        "volume_fraction:",
        "surface",
        "mean_curvature",
        "perimeter",
        "euler",
    ),
)

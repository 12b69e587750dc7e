"""Volumes from pictures: laid out by sliced optimal transport, finished by search and vote. See
README.md in this folder.
"""

from trabecula.synth.api.method import Capabilities

CAPABILITIES = Capabilities(
    name="sliced",
    summary="a volume of labels from one picture or several, laid out by sliced transport, finished by search and vote",
    paper="Rabin, Peyré, Delon, Bernot (2011), Wasserstein barycenter and its application to texture mixing",
    exemplar="2d",
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    several=True,
    presets=("fast", "best"),
    scaling="whole",
    target="trabecula.synth.sliced.method:Sliced",
)

"""Volumes from pictures: laid out by sliced optimal transport, finished by search and vote. See
README.md in this folder.
"""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="sliced",
    summary=(
        "a volume of labels from one picture or several, laid out by sliced transport, finished "
        "by search and vote"
    ),
    paper=(
        "Rabin, Peyré, Delon, Bernot (2011), Wasserstein barycenter and its application to "
        "texture mixing"
    ),
    learns_from=("pictures",),
    kinds=("labels",),
    honours=frozenset({"periodic", "mask", "fixed", "target"}),
    presets=("fast", "best"),
    large="memmap",
    trial={"layout_rounds": 3, "rounds": (2, 2)},
    method="trabecula.synth.sliced.method:Sliced",
)

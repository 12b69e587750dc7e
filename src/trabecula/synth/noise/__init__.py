"""Procedural baselines: the thresholded Gaussian random field, and noises on a lattice.

See README.md in this folder.
"""

from trabecula.synth.api.capabilities import Capabilities

CAPABILITIES = Capabilities(
    name="noise",
    summary=(
        "procedural noise: a Gaussian field with the scan's two-point function (the baseline that "
        "others must beat), Perlin, Worley, Voronoi, white"
    ),
    paper=("Quiblier (1984), A new three-dimensional modeling technique for studying porous media"),
    learns_from=("volume", "picture", "settings"),
    makes=("volume", "picture"),
    kinds=("labels",),
    large="box",
    method="trabecula.synth.noise.method:Noise",
    honours=frozenset({"periodic", "mask", "target"}),
    targets=("porosity", "volume_fraction", "orientation", "size"),
)

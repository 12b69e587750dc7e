"""Procedural baselines: the thresholded Gaussian random field, and noises on a lattice. See
README.md in this folder.
"""

from trabecula.synth.api.method import Capabilities

CAPABILITIES = Capabilities(
    name="noise",
    summary="procedural noise: a Gaussian field with the scan's two-point function (the baseline that others must beat), "
    "Perlin, Worley, Voronoi, white",
    paper="Quiblier (1984), A new three-dimensional modeling technique for studying porous media",
    exemplar="3d",
    kinds=("labels",),
    scaling="window",
    target="trabecula.synth.noise.method:Noise",
    honours=frozenset({"periodic", "mask"}),
    flat=True,
    alone=True,
)

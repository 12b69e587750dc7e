"""Procedural baselines; today the thresholded Gaussian random field. See README.md in this folder."""

from trabecula.synth.base import Spec

SPEC = Spec(
    name="noise",
    summary="a thresholded Gaussian random field with the scan's two-point function: the baseline that others must beat",
    paper="Quiblier (1984), A new three-dimensional modeling technique for studying porous media",
    exemplar="3d",
    kinds=("labels",),
    scaling="window",
    target="trabecula.synth.noise.method:Noise",
    honours=frozenset({"periodic"}),
)

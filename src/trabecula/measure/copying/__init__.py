"""Copying: the share of an image that was taken from its exemplar in one piece, and the differences
between realisations.

Every voxel has a *source*: the voxel of the exemplar whose neighbourhood (9 x 9 x 9 voxels; 15 x 15
in 2-D) differs from its own in the fewest voxels. In copied material the source moves along when
the voxel moves; in independent material it jumps. Only voxels near an interface count, those with
more than one phase in the middle of their neighbourhood (5 x 5 x 5; 9 x 9 in 2-D): blank
surroundings have no source. So do only neighbourhoods that fit wholly into the image. Lengths are
voxels, whatever the spacing.
"""

from trabecula.measure.copying.coherence import coherence
from trabecula.measure.copying.diversity import Diversity, differences, diversity
from trabecula.measure.copying.sources import CoherentPatches, Sources, coherent_patches, sources
from trabecula.measure.copying.turned import TurnedCopies, turned_copies

__all__ = [
    "CoherentPatches",
    "Diversity",
    "Sources",
    "TurnedCopies",
    "coherence",
    "coherent_patches",
    "differences",
    "diversity",
    "sources",
    "turned_copies",
]

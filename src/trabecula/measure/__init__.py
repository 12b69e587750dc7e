"""Image -> numbers. Every measure is a pure function of an Image, or of an array of labels; see each one's
docstring."""

# Imported plainly, not lazily: several functions bear their module's name, and whichever of the two is set last wins.
from trabecula.measure.amount import porosity, specific_surface, volume_fractions
from trabecula.measure.components import (
    components,
    floating,
    floating_voxels,
    label_components,
    largest_fraction,
    percolates,
)
from trabecula.measure.correlation import covariance_form, lineal_path, two_point
from trabecula.measure.describe import describe
from trabecula.measure.distance import distance_transform, signed_distance
from trabecula.measure.minkowski import Minkowski, euler, euler_density, mean_curvature, minkowski
from trabecula.measure.thickness import chord_length, local_thickness, pore_size, thickness

__all__ = [
    "Minkowski",
    "chord_length",
    "components",
    "covariance_form",
    "describe",
    "distance_transform",
    "euler",
    "euler_density",
    "floating",
    "floating_voxels",
    "label_components",
    "largest_fraction",
    "lineal_path",
    "local_thickness",
    "mean_curvature",
    "minkowski",
    "percolates",
    "pore_size",
    "porosity",
    "signed_distance",
    "specific_surface",
    "thickness",
    "two_point",
    "volume_fractions",
]

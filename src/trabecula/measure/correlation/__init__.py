"""Correlation: probabilities that points some distance apart are in a phase, and in it together.

Torquato 2002, "Random Heterogeneous Materials", doi:10.1007/978-1-4757-6355-3, chapter 2. Every
probability here is the number of pairs (or segments) of voxels that meet the condition over the
number that fit into the image and its mask, counted offset by offset: nothing is lost to a border
of zeros, and near the border every pair counts alike.
"""

from trabecula.measure.correlation.axis_preference import axis_preference
from trabecula.measure.correlation.length import correlation_length, covariance_form, decay_length
from trabecula.measure.correlation.lineal_path import lineal_path
from trabecula.measure.correlation.two_point import cross_correlation, two_point, two_point_cluster

__all__ = [
    "axis_preference",
    "correlation_length",
    "covariance_form",
    "cross_correlation",
    "decay_length",
    "lineal_path",
    "two_point",
    "two_point_cluster",
]

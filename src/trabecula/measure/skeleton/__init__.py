"""The skeleton of a phase: thinned to lines one voxel wide, and read as a graph of joints and
branches.
"""

from trabecula.measure.skeleton.graph import SkeletonGraph, skeleton_graph
from trabecula.measure.skeleton.thinning import thin

__all__ = ["SkeletonGraph", "skeleton_graph", "thin"]

"""Elastic stiffness of a volume by finite elements on its voxels (`stiffness`)."""

from trabecula.measure.mechanics.homogenise import Stiffness, stiffness

__all__ = ["Stiffness", "stiffness"]

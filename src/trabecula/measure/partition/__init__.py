"""A phase cut into regions at its necks: what pores and grains have in common.

Peaks of the distance map, a watershed from them, the faces between its regions, and the shapes of
these.
"""

from trabecula.measure.partition.interfaces import Interfaces, find_interfaces
from trabecula.measure.partition.partition import REACH, SMOOTHING, Partition, cut_phase
from trabecula.measure.partition.shapes import Shapes, measure_shapes

__all__ = [
    "REACH",
    "SMOOTHING",
    "Interfaces",
    "Partition",
    "Shapes",
    "cut_phase",
    "find_interfaces",
    "measure_shapes",
]

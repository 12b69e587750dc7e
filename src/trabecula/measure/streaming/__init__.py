"""Measures of a volume in one pass over its planes: every figure is that of the whole, wherever it
is cut into slabs.

A *tally* takes whole planes along z, from the first to the last, and keeps what the next ones will
need: the last plane (cubes, crossings, components) or the last `r_max` planes (pairs, segments).
Kernels and formulas are those of the measures in memory, where the whole image is one slab.
"""

from trabecula.measure.streaming.components import ComponentSizes, ComponentTally, component_table
from trabecula.measure.streaming.cubes import ConfigurationCounts
from trabecula.measure.streaming.lines import CrossingTally, LineTally
from trabecula.measure.streaming.numbers import PhaseNumbers, SolidNumbers, phase_figures
from trabecula.measure.streaming.pairs import RadialPairTally

__all__ = [
    "ComponentSizes",
    "ComponentTally",
    "ConfigurationCounts",
    "CrossingTally",
    "LineTally",
    "PhaseNumbers",
    "RadialPairTally",
    "SolidNumbers",
    "component_table",
    "phase_figures",
]

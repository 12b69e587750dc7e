"""The measures of a volume whose planes go by once: every figure is that of the whole, wherever it
is cut into slabs.

A *tally* takes whole planes along z, from the first to the last, and keeps what the next ones will
need: the last plane (cubes, crossings, components) or the last `r_max` planes (pairs, segments).
Kernels and formulas are those of the measures in memory, where the whole image is one slab.
"""

from trabecula.measure.streaming.components import Pieces, PieceSizes, pieces_of
from trabecula.measure.streaming.cubes import Cubes
from trabecula.measure.streaming.lines import Crossings, Lines
from trabecula.measure.streaming.numbers import Numbers, PhaseNumbers, phase_figures
from trabecula.measure.streaming.pairs import RadialPairs

__all__ = [
    "Crossings",
    "Cubes",
    "Lines",
    "Numbers",
    "PhaseNumbers",
    "PieceSizes",
    "Pieces",
    "RadialPairs",
    "phase_figures",
    "pieces_of",
]

"""Transport along one axis: diffusion, conduction and flow, each with figures of how far it can be
trusted.
"""

from trabecula.measure.transport.conduction import conductivity, diffusivity, tortuosity
from trabecula.measure.transport.permeability import permeability
from trabecula.measure.transport.result import Effective
from trabecula.measure.transport.streamlines import streamlines

__all__ = [
    "Effective",
    "conductivity",
    "diffusivity",
    "permeability",
    "streamlines",
    "tortuosity",
]

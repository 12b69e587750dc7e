"""Flow that bubbles follow, and room in which they grow (section 3.4 of the paper).

It has dynamical systems, outlines and crusts.
"""

from trabecula.synth.bubbles.flow.config import FlowConfig
from trabecula.synth.bubbles.flow.field import Flow, flow_of

__all__ = ["Flow", "FlowConfig", "flow_of"]

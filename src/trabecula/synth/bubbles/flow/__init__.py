"""Flow that bubbles follow, and room in which they grow (section 3.4 of the paper).

It has dynamical systems, outlines and crusts. The names are loaded when they are used, since the
registry asks for the presets alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trabecula.synth.bubbles.flow.config import FlowConfig
    from trabecula.synth.bubbles.flow.field import Flow, flow_of

__all__ = ["Flow", "FlowConfig", "flow_of"]


def __getattr__(name: str) -> Any:
    """Load a name of this package when it is used."""
    if name == "FlowConfig":
        from trabecula.synth.bubbles.flow.config import FlowConfig

        return FlowConfig
    if name in ("Flow", "flow_of"):
        from trabecula.synth.bubbles.flow import field

        return getattr(field, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

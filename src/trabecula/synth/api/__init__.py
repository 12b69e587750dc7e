"""The door for methods: all that the folder of a method, here or in another package, builds on.

A folder holds `CAPABILITIES` in its `__init__.py`, a frozen dataclass of settings in `config.py`,
and in `method.py` a `Method` with a `Model` or `WindowModel`. Names are imported on first use, so
that `CAPABILITIES` stays light to import.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trabecula.synth.api.capabilities import Capabilities
    from trabecula.synth.api.exemplar_info import ExemplarInfo
    from trabecula.synth.api.method import Method
    from trabecula.synth.api.model import Model, ModelState
    from trabecula.synth.api.registry import methods, register
    from trabecula.synth.api.windows import WindowModel, field_in

__all__ = [
    "Capabilities",
    "ExemplarInfo",
    "Method",
    "Model",
    "ModelState",
    "WindowModel",
    "field_in",
    "methods",
    "register",
]

_MODULES = {
    "Capabilities": "capabilities",
    "ExemplarInfo": "exemplar_info",
    "Method": "method",
    "Model": "model",
    "ModelState": "model",
    "WindowModel": "windows",
    "field_in": "windows",
    "methods": "registry",
    "register": "registry",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)

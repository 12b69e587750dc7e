"""Methods are found by their folders: every package in `synth` with a `CAPABILITIES` is one."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any

import trabecula.synth
from trabecula.core.checks import check_name
from trabecula.synth.api.method import Capabilities, Method


def methods() -> dict[str, Capabilities]:
    """Every method's Spec by its name, without importing the methods themselves."""
    found = {}
    for module in pkgutil.iter_modules(trabecula.synth.__path__):
        if module.ispkg and module.name not in ("api", "shared"):
            spec = importlib.import_module(f"trabecula.synth.{module.name}").CAPABILITIES
            found[spec.name] = spec
    return dict(sorted(found.items()))


def method(name: str, /, *, preset: str | None = None, **settings: Any) -> Method:
    """A method by name, with settings.

    Parameters
    ----------
    name : str
        One of `methods()`.
    preset : str, optional
        Ready settings, changed by `settings`.
    **settings
        Fields of the method's config.

    Raises
    ------
    UnknownNameError
        No method, preset or setting of that name; the nearest is suggested.
    """
    specs = methods()
    check_name(name, specs, name="method")
    module, _, attribute = specs[name].target.partition(":")
    cls: type[Method] = getattr(importlib.import_module(module), attribute)
    return cls.configured(preset=preset, **settings)

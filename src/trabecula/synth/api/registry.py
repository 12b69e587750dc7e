"""The methods that are there: the folders of `synth`, and entry points of other distributions.

Every package in `synth` with a `CAPABILITIES` is a method, and so is every entry point of the group
`trabecula.methods`, which names a `Capabilities`:

    [project.entry-points."trabecula.methods"]
    coin = "coin_package:CAPABILITIES"
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import trabecula.synth
from trabecula.core.checks import check_name
from trabecula.core.errors import PluginError
from trabecula.core.progress import notify
from trabecula.synth.api.method import Capabilities, Method

GROUP = "trabecula.methods"
"""Group of the entry points of methods."""

_NO_METHODS = ("api", "shared")
_given: dict[str, type[Method]] = {}  # `register` for the time being


def methods() -> dict[str, Capabilities]:
    """Return every method's capabilities by its name, without importing the methods themselves.

    An entry point that cannot be loaded is reported (`tb.progress`) and left out.
    """
    found = {one.name: one for one in _own()}
    found |= {name: cls.capabilities for name, cls in _given.items()}
    for point in _points():
        try:
            known = _load(point)
            if known.name in found:
                raise PluginError(f"{_place(point)} is another method of that name: rename it")
            found[known.name] = known
        except PluginError as error:
            _notify_once(str(error))
    return dict(sorted(found.items()))


def method(name: str, /, *, preset: str | None = None, **settings: Any) -> Method:
    """Return a method by name, with settings.

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
    PluginError
        Another distribution announces the method, and it cannot be loaded.
    """
    known = methods()
    if not isinstance(name, str) or name not in known:
        for point in _points():
            if point.name == name:
                _load(point)  # which raises
    check_name(name, known, name="method")
    return method_class(known[name]).configure(preset=preset, **settings)


def recorded_method(name: str, settings: Mapping[str, Any]) -> Method:
    """Return a method with the settings of a recipe or a model, completed where these are older
    than some setting (`Method.config_type`).
    """
    made = method(name)
    return made.configure(**getattr(made.config_type, "recorded", dict)(settings))


def method_class(capabilities: Capabilities) -> type[Method]:
    """Import the class of a method.

    Raises
    ------
    PluginError
        Its module or class is not there, or the class is no `Method`.
    """
    if capabilities.name in _given:
        return _given[capabilities.name]
    module, _, attribute = capabilities.method.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ModuleNotFoundError, AttributeError) as error:
        raise PluginError(
            f"method {capabilities.name!r} is said to be {capabilities.method!r}, which cannot be "
            f"imported ({error}): correct `method` in its CAPABILITIES"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Method)):
        raise PluginError(
            f"method {capabilities.name!r}: {capabilities.method!r} is no Method: derive it from "
            "trabecula.synth.api.method.Method"
        )
    return found


@contextmanager
def register(cls: type[Method]) -> Iterator[None]:
    """Let the registry know a method's class while the block lasts, for tests."""
    _given[cls.capabilities.name] = cls
    try:
        yield
    finally:
        del _given[cls.capabilities.name]


def _own() -> Iterator[Capabilities]:
    """Yield the capabilities of the package's own methods."""
    for module in pkgutil.iter_modules(trabecula.synth.__path__):
        if module.ispkg and module.name not in _NO_METHODS:
            yield importlib.import_module(f"trabecula.synth.{module.name}").CAPABILITIES


@cache
def _points() -> list[EntryPoint]:
    """List the entry points of methods, by name and value."""
    return sorted(entry_points(group=GROUP), key=lambda point: (point.name, point.value))


def _load(point: EntryPoint) -> Capabilities:
    """Load the capabilities that an entry point names."""
    place = _place(point)
    try:
        found = point.load()
    except Exception as error:
        raise PluginError(
            f"{place} cannot be loaded ({type(error).__name__}: {error}): update or remove that "
            "package"
        ) from error
    if not isinstance(found, Capabilities):
        raise PluginError(
            f"{place} is a {type(found).__name__}: it should name the Capabilities of a method"
        )
    if found.name != point.name:
        raise PluginError(f"{place} describes a method {found.name!r}: give both the same name")
    return found


def _place(point: EntryPoint) -> str:
    """Return an entry point as messages call it."""
    package = "an unknown package" if point.dist is None else point.dist.name
    return f"the entry point {point.name} = {point.value!r} of {package}"


@cache
def _notify_once(text: str) -> None:
    """Report a text, once a process."""
    notify(text)

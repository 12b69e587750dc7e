"""The one place that imports packages which the base install does not bring."""

from __future__ import annotations

import importlib
from types import ModuleType

from trabecula.core.errors import MissingExtraError


def need(module: str, *, extra: str, purpose: str) -> ModuleType:
    """Import an optional module, or say which extra brings it.

    Raises
    ------
    MissingExtraError
        The module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"{purpose} needs {module}, which is not installed: pip install 'trabecula[{extra}]'"
        ) from error

"""Packages that are called as the function of their name: `tb.view(image)`, `tb.mesh(image)`."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package that passes a call on to one of its functions, which is imported then."""

    __function__: str

    def __call__(self, *args: Any, **options: Any) -> Any:
        home, _, name = self.__function__.partition(":")
        return getattr(importlib.import_module(home), name)(*args, **options)


def make_callable(package: str, function: str) -> None:
    """Let a package be called.

    Importing a module of the package sets `trabecula.NAME` to the package, where the function of
    the same name would be expected.

    Parameters
    ----------
    package : str
        Its `__name__`.
    function : str
        The function that the call goes to: "module:function".
    """
    module = sys.modules[package]
    module.__class__ = CallablePackage
    module.__function__ = function  # type: ignore[attr-defined]

"""`kernel`: the one decorator for compiled functions.

A kernel is a plain function on arrays: no checks, no files, no config. It is compiled at its first
call, cached on disk, and releases the GIL, so that tiles of work run in threads. `fastmath` stays
off: sums keep their order, and the same source gives the same bits on every x86-64 machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

from trabecula.core import progress

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function on arrays, once per machine."""
    _announce_once()
    return numba.njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function)


def inline(function: F) -> F:
    """Compile a few lines that LLVM should put into the caller."""
    return numba.njit(nogil=True, fastmath=False, error_model="numpy")(function)


class _Announcer(event.Listener):
    """Listener that says once that kernels are being compiled; Numba sends this event only where
    its cache has nothing.
    """

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: event.Event) -> None:
        if not self.said:
            self.said = True
            progress.notify(
                "compiling kernels (once on this machine; later runs load them from the cache)"
            )

    def on_end(self, event: event.Event) -> None:
        """Do nothing at the end."""


_announcer = _Announcer()
_installed = False


def _announce_once() -> None:
    global _installed
    if not _installed and not os.environ.get("NUMBA_DISABLE_JIT"):
        event.register("numba:compile", _announcer)
        _installed = True

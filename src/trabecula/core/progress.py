"""Progress of long work, sent to a listener.

Work calls `track` (a loop) or `notify` (a line); nobody passes a bar around. Without a listener
both cost nothing, so library code stays quiet and the command line shows a bar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

Listener = Callable[[str, float], None]
"""Called with a label and the fraction done, 0..1; a fraction of 1 ends the stage. A line of text
has fraction -1.
"""

_listener: ContextVar[Listener | None] = ContextVar("trabecula_progress", default=None)


@contextmanager
def listen(listener: Listener) -> Iterator[None]:
    """Send the progress of everything inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def track(items: Iterable[T], label: str, *, total: int | None = None) -> Iterator[T]:
    """Yield the items, reporting how many are done."""
    listener = _listener.get()
    if listener is None:
        yield from items
        return
    if total is None:
        items = list(items)
        total = len(items)
    listener(label, 0.0)
    for done, item in enumerate(items, start=1):
        yield item
        listener(label, min(done / max(total, 1), 1.0))


def notify(line: str) -> None:
    """Send a line to the listener, such as a notice that something takes longer once."""
    listener = _listener.get()
    if listener is not None:
        listener(line, -1.0)


def report(label: str, done: float) -> None:
    """Report the fraction done, 0..1, of work that is no loop over items; the label may change
    meanwhile.
    """
    listener = _listener.get()
    if listener is not None:
        listener(label, done)

"""Progress of long work, sent to a listener.

Work calls `track` (a loop) or `notify` (a line); nobody passes a bar around. Without a listener
both cost nothing, so library code stays quiet and the command line shows a bar.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple, TypeVar

T = TypeVar("T")

Listener = Callable[[str, float], None]
"""Called with a label and the fraction done, 0..1, which is a `Fraction` where items are counted; a
fraction of 1 ends the stage. A line of text has fraction -1.
"""


class Fraction(float):
    """A fraction done, 0..1, that knows its counts.

    Attributes
    ----------
    done, total : int
        Items.
    """

    done: int
    total: int

    def __new__(cls, done: int, total: int) -> Fraction:
        """Return `done / total`, and at most 1."""
        made = super().__new__(cls, min(done / max(total, 1), 1.0))
        made.done, made.total = done, total
        return made


class StageTime(NamedTuple):
    """How long a stage has run, and how long it will, in seconds; None where that is unknown."""

    seconds: float
    left: float | None


class StageClock:
    """The times of stages, from what a listener is called with."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._begun: dict[str, tuple[float, float]] = {}  # label -> time and fraction
        self._last = ("", 0.0)

    def update(self, label: str, fraction: float) -> StageTime:
        """Return the times of the stage that has come to `fraction`."""
        now = self._now()
        before, reached = self._last
        if fraction == 0:
            self._begun[label] = (now, 0.0)
        elif label not in self._begun and before in self._begun and fraction >= reached:
            self._begun[label] = self._begun.pop(before)  # the same stage in other words
        begun, first = self._begun.setdefault(label, (now, fraction))
        self._last = (label, fraction)
        if fraction >= 1:
            self._begun.pop(label, None)
        seconds, done = now - begun, fraction - first
        return StageTime(seconds, seconds * (1 - fraction) / done if done > 0 else None)


_listener: ContextVar[Listener | None] = ContextVar("trabecula_progress", default=None)


@contextmanager
def listen(listener: Listener) -> Iterator[None]:
    """Send the progress of everything inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def progress(listener: Listener | None = None) -> Iterator[None]:
    """Show the progress of everything inside the block.

    Parameters
    ----------
    listener : callable, optional
        Called as `listener(label, fraction)`: the stage's name, and the fraction of it that is
        done, 0 to 1; 1 ends the stage, and a negative fraction means that the label is a line of
        text. Without one a line on standard error is rewritten: stage, percent and time left, in a
        notebook as on a terminal. An error of a listener ends the work: so a run is cancelled.

    Raises
    ------
    InputError
        What is given cannot be called.

    Examples
    --------
    >>> import trabecula as tb
    >>> seen = []
    >>> with tb.progress(lambda label, fraction: seen.append(fraction)):
    ...     made = tb.method("noise").fit().generate(8, seed=1)
    """
    if listener is not None and not callable(listener):
        from trabecula.core.errors import InputError

        raise InputError(
            f"progress takes a function of a label and a fraction, not {listener!r}; leave it out "
            "for a line on standard error"
        )
    line = ProgressLine()
    try:
        with listen(listener if listener is not None else line):
            yield
    finally:
        line.end()


class ProgressLine:
    """A listener that rewrites one line on standard error: stage, percent, time left."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._clock = StageClock(now)
        self._now = now
        self._drawn = -math.inf
        self._length = 0

    def __call__(self, label: str, fraction: float) -> None:
        """Show how far a stage is, ten times a second at most; a line of text stays."""
        if fraction < 0:
            self._write(label)
            self.end(keep=True)
            return
        left = self._clock.update(label, fraction).left
        if fraction < 1 and self._now() - self._drawn < 0.1:
            return
        self._drawn = self._now()
        self._write(f"{label} {fraction:4.0%}" + ("" if not left else f", {left:.0f} s left"))

    def _write(self, text: str) -> None:
        sys.stderr.write("\r" + text.ljust(self._length))
        sys.stderr.flush()
        self._length = len(text)

    def end(self, *, keep: bool = False) -> None:
        """Clear the line, or `keep` it and begin another."""
        if self._length:
            sys.stderr.write("\n" if keep else "\r" + " " * self._length + "\r")
            sys.stderr.flush()
            self._length = 0


def track(items: Iterable[T], label: str, *, total: int | None = None) -> Iterator[T]:
    """Yield the items, reporting how many are done."""
    listener = _listener.get()
    if listener is None:
        yield from items
        return
    if total is None:
        items = list(items)
        total = len(items)
    listener(label, Fraction(0, total))
    for done, item in enumerate(items, start=1):
        yield item
        listener(label, Fraction(done, total))


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

"""Progress of long work, sent to a listener.

Work calls `track` (a loop) or `notify` (a line); nobody passes a bar around. Without a listener
both cost nothing, so library code stays quiet and the command line shows a bar.

A run of several stages is a `whole_run`: it says with `part` which part of it each stage is, by its
expected cost, and every loop inside a stage moves on from there. So one bar goes from 0 to 1 once.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
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
        Items; both 0 where nothing is counted.
    run : WholeRun, optional
        The run of which this stage is a part.
    """

    done: int
    total: int
    run: WholeRun | None

    def __new__(cls, done: int, total: int, run: WholeRun | None = None) -> Fraction:
        """Return `done / total`, and at most 1."""
        made = super().__new__(cls, min(done / max(total, 1), 1.0))
        made.done, made.total, made.run = done, total, run
        return made

    @classmethod
    def of(cls, fraction: float, run: WholeRun | None) -> Fraction:
        """Return a fraction that counts nothing."""
        made = super().__new__(cls, fraction)
        made.done, made.total, made.run = 0, 0, run
        return made


class WholeRun:
    """How far a run of several stages is, and how long it has taken.

    Attributes
    ----------
    reached : float
        Fraction done, 0..1; it never falls.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._begun = now()
        self.reached = 0.0

    def reach(self, fraction: float) -> None:
        """Move on to a fraction, where that is farther."""
        self.reached = min(max(self.reached, fraction), 1.0)

    def left(self) -> float | None:
        """Return the seconds that are left, at the speed so far; None before anything is done."""
        if not self.reached:
            return None
        return (self._now() - self._begun) * (1 - self.reached) / self.reached


class Span(NamedTuple):
    """The part of a run that the current work is, from `first` to `last`, 0..1."""

    run: WholeRun
    first: float
    last: float

    def within(self, begin: float, end: float) -> Span:
        """Return the part from `begin` to `end` of this one."""
        wide = self.last - self.first
        return Span(self.run, self.first + begin * wide, self.first + end * wide)


def run_of(fraction: float) -> WholeRun | None:
    """Return the run of which a stage is a part."""
    return fraction.run if isinstance(fraction, Fraction) else None


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
_span: ContextVar[Span | None] = ContextVar("trabecula_span", default=None)


@contextmanager
def whole_run(label: str = "starting") -> Iterator[None]:
    """Count all stages inside the block as parts of one run; inside such a block do nothing.

    Parameters
    ----------
    label : str
        What the run begins with.
    """
    if _listener.get() is None or _span.get() is not None:
        yield
        return
    token = _span.set(Span(WholeRun(), 0.0, 1.0))
    try:
        report(label, 0.0)
        yield
    finally:
        _span.reset(token)


def current_span() -> Span | None:
    """Return the part of a run that the current work is; None outside of a `whole_run`."""
    return _span.get()


@contextmanager
def part(begin: float, end: float, *, of: Span | None = None) -> Iterator[None]:
    """Count what runs inside the block as the part from `begin` to `end`, 0..1, of the part that
    the block is in, or of another; outside of a `whole_run` do nothing.
    """
    outer = _span.get()
    if outer is None:
        yield
        return
    here = (of or outer).within(begin, end)
    here.run.reach(here.first)
    token = _span.set(here)
    try:
        yield
        here.run.reach(here.last)
    finally:
        _span.reset(token)


@contextmanager
def part_of(costs: Sequence[float], place: int) -> Iterator[None]:
    """Count what runs inside the block as one of several parts, each as long as its cost."""
    total = sum(costs) or 1.0
    before = sum(costs[:place])
    with part(before / total, (before + costs[place]) / total):
        yield


@contextmanager
def listen(listener: Listener) -> Iterator[None]:
    """Send the progress of everything inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def silence() -> AbstractContextManager[None]:
    """Send the progress of everything inside the block, and its lines of text, to nobody."""
    return listen(lambda label, fraction: None)


@contextmanager
def progress(listener: Listener | None = None) -> Iterator[None]:
    """Show the progress of everything inside the block.

    Parameters
    ----------
    listener : callable, optional
        Called as `listener(label, fraction)`: the stage's name, and the fraction of it that is
        done, 0 to 1; 1 ends the stage, and a negative fraction means that the label is a line of
        text. While material is made `fraction.run.reached` is the fraction of the whole run, and
        `fraction.run.left()` the seconds left. Without a listener a line on standard error is
        rewritten: stage, percent of the run and time left, in a notebook as on a terminal. An error
        of a listener ends the work: so a run is cancelled.

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
        run = run_of(fraction)
        if run is not None:
            fraction, left = run.reached, run.left()
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
    span = _span.get()
    report_count(label, 0, total)
    done, source = 0, iter(items)
    try:
        while True:
            if span is not None:  # loops inside an item, or in making it, move on within it
                _span.set(
                    span.within(min(done / max(total, 1), 1), min((done + 1) / max(total, 1), 1))
                )
            try:
                item = next(source)
            except StopIteration:
                return
            yield item
            done += 1
            _span.set(span)
            report_count(label, done, total)
    finally:
        _span.set(span)


def notify(line: str) -> None:
    """Send a line to the listener, such as a notice that something takes longer once."""
    listener = _listener.get()
    if listener is not None:
        listener(line, -1.0)


def report_count(label: str, done: int, total: int) -> None:
    """Report how many of `total` items are done."""
    span = _span.get()
    if _listener.get() is not None:
        _send(label, Fraction(done, total, None if span is None else span.run))


def report(label: str, done: float) -> None:
    """Report the fraction done, 0..1, of work that is no loop over items; the label may change
    meanwhile.
    """
    span = _span.get()
    if _listener.get() is not None:
        _send(label, done if span is None else Fraction.of(done, span.run))


def _send(label: str, fraction: float) -> None:
    """Send the fraction to the listener, and move the run on."""
    span, listener = _span.get(), _listener.get()
    if span is not None:
        span.run.reach(span.first + float(fraction) * (span.last - span.first))
    if listener is not None:
        listener(label, fraction)

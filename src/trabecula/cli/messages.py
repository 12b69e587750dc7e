"""Lines and bars on standard error, and the same lines in a log: notices, progress, errors."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from trabecula.core.errors import FileError
from trabecula.core.progress import Fraction, StageClock, listen, run_of

_WIDTH = 20  # of a bar, characters
_LABEL = 36
_PAUSE = 30.0  # between lines of progress where no bar is seen, seconds


@dataclass
class Messages:
    """What is shown of a run: everything, errors alone, or the end of every stage as well."""

    quiet: bool = False
    verbose: bool = False
    log: TextIO | None = None
    clock: StageClock = field(default_factory=StageClock)
    drawn: float = 0.0
    length: int = 0
    written: float = field(default_factory=time.monotonic)
    """When the last line of progress was written."""

    def __post_init__(self) -> None:
        self.bars = not self.quiet and sys.stderr.isatty()

    def __call__(self, label: str, fraction: float) -> None:
        """Show the progress of a run or a stage, or a line where `fraction` is negative."""
        if fraction < 0:
            self.show(label)
            return
        stage = self.clock.update(label, fraction)
        now = time.monotonic()
        if fraction >= 1:
            self.clear()
            self.show(f"{label}: {brief_time(stage.seconds)}", shown=self.verbose)
            return
        run = run_of(fraction)
        seconds = stage.left if run is None else run.left()
        left = "" if seconds is None else f"{brief_time(seconds)} left"
        if self.bars and now - self.drawn >= 0.05:
            self.drawn = now
            self._draw(label, fraction if run is None else run.reached, left)
        if now - self.written >= _PAUSE:
            self.written = now
            whole = "" if run is None else f", {run.reached:.0%} of the run"
            line = f"{label} {_count(fraction)}{whole}" + (left and f", {left}")
            self.show(line, shown=not self.bars)

    def show(self, line: str, *, shown: bool = True, error: bool = False) -> None:
        """Print a line, with `quiet` an error alone, and write it to the log."""
        if error or (shown and not self.quiet):
            self.clear()
            print(f"trabecula: {line}", file=sys.stderr, flush=True)
        if self.log is not None:
            self.log.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n")
            self.log.flush()

    def _draw(self, label: str, fraction: float, left: str) -> None:
        done = round(_WIDTH * fraction)
        bar = f"[{'#' * done}{'.' * (_WIDTH - done)}]"
        line = f"{label[:_LABEL]:{_LABEL}s} {bar} {fraction:4.0%} {left:12s}"
        print("\r" + line.ljust(self.length), end="", file=sys.stderr, flush=True)
        self.length = len(line)

    def clear(self) -> None:
        """Clear the bar from its line."""
        if self.length:
            print("\r" + " " * self.length + "\r", end="", file=sys.stderr, flush=True)
            self.length = 0


_current: ContextVar[Messages | None] = ContextVar("trabecula_messages", default=None)


@contextmanager
def messages_shown(
    *, quiet: bool = False, verbose: bool = False, log: str | None = None
) -> Iterator[None]:
    """Show the progress and the lines of what runs inside the block, and append them to the log.

    Raises
    ------
    FileError
        The log cannot be written.
    """
    try:
        file = None if log is None else Path(log).open("a", encoding="utf-8")  # noqa: SIM115
    except OSError as error:
        raise FileError(f"--log {log}: {error.strerror}; name a file that can be written") from None
    messages = Messages(quiet, verbose, file)
    token = _current.set(messages)
    try:
        with listen(messages):
            yield
    except KeyboardInterrupt:
        if file is not None:
            messages.show("interrupted", shown=False)
        raise
    finally:
        messages.clear()
        _current.reset(token)
        if file is not None:
            file.close()


def fail(message: str) -> None:
    """Print one line on standard error."""
    (_current.get() or Messages()).show(" ".join(message.split()), error=True)


def note(line: str) -> None:
    """Print a line on standard error that is no error."""
    (_current.get() or Messages()).show(line)


def note_end(seconds: float) -> None:
    """Say how long all took, to the log and where every stage is shown."""
    messages = _current.get()
    if messages is not None:
        messages.show(f"done: {brief_time(seconds)}", shown=messages.verbose)


def brief_time(seconds: float) -> str:
    """Format seconds for a person."""
    if seconds < 90:
        return f"{seconds:.0f} s" if seconds >= 3 else f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _count(fraction: float) -> str:
    if isinstance(fraction, Fraction) and fraction.total:
        return f"{fraction.done} of {fraction.total}"
    return f"{fraction:.0%}"

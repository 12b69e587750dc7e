"""Output beside the results: progress and notices on standard error, errors in one line."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from trabecula.core.progress import listen

_WIDTH = 30


class Bar:
    """A progress bar on a terminal; elsewhere only lines of text are passed on."""

    def __init__(self) -> None:
        self.on_terminal = sys.stderr.isatty()
        self.shown = 0.0
        self.length = 0

    def __call__(self, label: str, fraction: float) -> None:
        """Show a stage's progress, or a line where `fraction` is negative."""
        if fraction < 0:
            self.clear()
            print(f"trabecula: {label}", file=sys.stderr, flush=True)
        elif self.on_terminal:
            self._draw(label, fraction)

    def _draw(self, label: str, fraction: float) -> None:
        now = time.monotonic()
        if now - self.shown < 0.05 and fraction < 1:
            return
        self.shown = now
        done = round(_WIDTH * fraction)
        line = f"{label[:40]:40s} [{'#' * done}{'.' * (_WIDTH - done)}] {fraction:4.0%}"
        print("\r" + line, end="", file=sys.stderr, flush=True)
        self.length = len(line)
        if fraction >= 1:
            self.clear()

    def clear(self) -> None:
        """Clear the bar from its line."""
        if self.length:
            print("\r" + " " * self.length + "\r", end="", file=sys.stderr, flush=True)
            self.length = 0


@contextmanager
def progress_shown() -> Iterator[None]:
    """Show the progress of what runs inside the block."""
    bar = Bar()
    try:
        with listen(bar):
            yield
    finally:
        bar.clear()


def fail(message: str) -> None:
    """Print one line on standard error."""
    print("trabecula: " + " ".join(message.split()), file=sys.stderr, flush=True)


def note(line: str) -> None:
    """Print a line on standard error that is no error."""
    print(f"trabecula: {line}", file=sys.stderr, flush=True)


def show_json(value: Any) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(value, indent=1, allow_nan=False))


def show_rows(rows: Sequence[Sequence[Any]]) -> None:
    """Print columns, as wide as they need to be."""
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in texts) for i in range(len(texts[0]))] if texts else []
    for row in texts:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )


def show_mapping(values: Mapping[str, Any]) -> None:
    """Print a name and a value per line; nested tables one a line, curves by their length alone."""
    show_rows([(name, brief(value)) for name, value in _flatten(values)])


def _flatten(values: Mapping[str, Any], *, inside: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and any(isinstance(part, Mapping) for part in value.values()):
            yield from _flatten(value, inside=f"{inside}{name}.")
        else:
            yield f"{inside}{name}", value


def brief(value: Any) -> str:
    """Return a value in a few words."""
    if value is None or value == []:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        if isinstance(value[0], str):
            return " ".join(value)
        if isinstance(value[0], list):
            return f"{len(value)} x {len(value[0])} values (--json prints them)"
        return f"{len(value)} values (--json prints them)" if len(value) > 4 else str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {brief(part)}" for key, part in value.items())
    return str(value)

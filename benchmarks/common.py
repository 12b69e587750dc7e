"""What the cases share: where scans are, clocks, and lines of a table."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SCANS = Path(__file__).resolve().parents[1].parent / "shared" / "data"

LEVEL = 0.002
"""Indicators of pictures that differ by less are level: where a histogram is matched exactly,
digits behind that are rounding.
"""


@dataclass
class Table:
    """What a case printed: the heads of a table, and its rows, all as strings."""

    heads: list[str]
    rows: list[list[str]] = field(default_factory=list)


_RECORD: ContextVar[list[Table] | None] = ContextVar("record", default=None)


@contextlib.contextmanager
def recorded() -> Iterator[list[Table]]:
    """Collect the tables that cases print within this block."""
    tables: list[Table] = []
    token = _RECORD.set(tables)
    try:
        yield tables
    finally:
        _RECORD.reset(token)


def pictures() -> Path | None:
    """The folder for pictures, where TRABECULA_BENCH_OUT names one."""
    named = os.environ.get("TRABECULA_BENCH_OUT")
    if not named:
        return None
    folder = Path(named)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def asked(name: str) -> list[str]:
    """The words that an option of `trabecula bench` gave, none where it was not given."""
    return [
        word.strip()
        for word in os.environ.get(f"TRABECULA_BENCH_{name}", "").split(";")
        if word.strip()
    ]


def unit() -> float:
    """Seconds of a fixed job: the real FFT of 128^3 in float32, best of five."""
    volume = np.random.default_rng(0).random((128, 128, 128), np.float32)
    return min(busy(lambda: np.fft.rfftn(volume))[0] for _ in range(5))


def timed(
    job: Callable[[], Any], *, clock: Callable[[], float] = time.perf_counter
) -> tuple[float, Any]:
    """Seconds by the clock on the wall, and what the job returned."""
    start = clock()
    result = job()
    return clock() - start, result


def busy(job: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor seconds of a job, and its result."""
    return timed(job, clock=time.process_time)


def tell(*cells: object) -> None:
    """A line of cells at least eight wide."""
    print(" | ".join(f"{cell!s:>8}" for cell in cells), flush=True)


def table(first: str, *heads: str, wide: int = 22) -> Callable[..., None]:
    """Print the heads of a table, and give what prints a row below them; the first column is
    `wide`.
    """
    widths = [max(12, len(head)) for head in heads]
    record, kept = _RECORD.get(), Table([first, *heads])

    def row(name: object, *cells: object) -> None:
        if record is not None:
            kept.rows.append([str(name), *(str(cell) for cell in cells)])
        right = (f"{cell!s:>{width}}" for cell, width in zip(cells, widths, strict=True))
        print(" | ".join([f"{name!s:<{wide}}", *right]).rstrip(), flush=True)

    row(first, *heads)
    kept.rows.clear()  # the heads
    if record is not None:
        record.append(kept)
    return row

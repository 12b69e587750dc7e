"""What the cases share: where scans are, clocks, and lines of a table."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

SCANS = Path(__file__).resolve().parents[1].parent / "shared" / "data"


def unit() -> float:
    """Seconds of a fixed job: the real FFT of 128^3 in float32, best of five."""
    volume = np.random.default_rng(0).random((128, 128, 128), np.float32)
    return min(timed(lambda: np.fft.rfftn(volume))[0] for _ in range(5))


def timed(job: Callable[[], object]) -> tuple[float, object]:
    start = time.perf_counter()
    result = job()
    return time.perf_counter() - start, result


def tell(*cells: object) -> None:
    print(" | ".join(f"{cell!s:>8}" for cell in cells), flush=True)

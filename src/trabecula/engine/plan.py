"""What a run will need, told before it starts: a run over its budget is refused, not killed."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from trabecula.core.errors import MemoryBudgetError

GIB = 1 << 30


@dataclass(frozen=True)
class Plan:
    """Forecast of a run: bytes by what they are for, of the result and of scratch files while it is
    made, and seconds.
    """

    memory: dict[str, int] = field(default_factory=dict)
    disk: int = 0
    scratch: int = 0
    seconds: float | None = None

    def __repr__(self) -> str:
        parts = [f"{format_bytes(self.peak)} of memory", f"{format_bytes(self.disk)} on disk"]
        parts += [f"{format_bytes(self.scratch)} of scratch files"] if self.scratch else []
        parts += [] if self.seconds is None else [f"about {self.seconds:.0f} s"]
        largest = sorted(self.memory.items(), key=lambda item: -item[1])[:3]
        most = ", ".join(f"{name} {format_bytes(count)}" for name, count in largest)
        return f"<Plan {', '.join(parts)}{f'; most memory: {most}' if most else ''}>"

    @property
    def peak(self) -> int:
        """Peak memory in bytes."""
        return sum(self.memory.values())

    def to_json(self) -> dict[str, Any]:
        """The forecast as plain JSON."""
        return {**asdict(self), "peak": self.peak}


def available_memory() -> int:
    """Bytes that this process may still take: the machine's available memory, or a control group's
    limit if lower.
    """
    candidates = [
        limit for limit in (_meminfo_available(), _cgroup_available()) if limit is not None
    ]
    if candidates:
        return min(candidates)
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 8 * GIB  # Windows without a better source; the budget can always be given


def check_budget(
    plan: Plan,
    *,
    budget: int | None = None,
    advice: str | Callable[[int], str] = "ask for a smaller --shape",
) -> None:
    """Raise `MemoryBudgetError` where the plan's peak exceeds the budget (default: what is
    available).

    Parameters
    ----------
    plan : Plan
    budget : int, optional
        Bytes.
    advice : str, or function of the bytes that may be used that gives one
        What the user can change, as an imperative.
    """
    limit = available_memory() if budget is None else budget
    if plan.peak > limit:
        raise MemoryBudgetError(
            f"this run needs about {format_bytes(plan.peak)} of memory, {format_bytes(limit)} may be used: "
            f"{advice if isinstance(advice, str) else advice(limit)}, or raise --memory"
        )


def largest_within(
    shape: Sequence[int], peak_of: Callable[[tuple[int, ...]], int], budget: int
) -> tuple[int, ...] | None:
    """The largest shape of the proportions of `shape`, and not above it, whose peak is within a
    budget; None for no such.

    Parameters
    ----------
    shape : sequence of int
    peak_of : shape -> bytes
        Never less for a larger shape. A ValueError says that a shape is too small to be made.
    budget : int
        Bytes.

    Examples
    --------
    >>> largest_within((100, 200), lambda shape: 8 * shape[0] * shape[1], 80_000)
    (70, 140)
    """

    def scaled(side: int) -> tuple[int, ...]:
        return tuple(max(1, length * side // max(shape)) for length in shape)

    low, high = 0, max(shape)
    while low < high:
        middle = (low + high + 1) // 2
        try:
            fits = peak_of(scaled(middle)) <= budget
        except ValueError:
            fits = True
        low, high = (middle, high) if fits else (low, middle - 1)
    try:
        return scaled(low) if low and peak_of(scaled(low)) <= budget else None
    except ValueError:
        return None


def format_bytes(count: float) -> str:
    """Bytes as a person reads them."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024 or unit == "TiB":
            return f"{count:.0f} {unit}" if unit == "B" or count >= 100 else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError


def _meminfo_available() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        return None
    return None


def _cgroup_available() -> int | None:
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit == "max":
            return None
        return max(0, int(limit) - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    except (OSError, ValueError):
        return None

"""Where the seconds of `texture` go: its stages timed by wrapping their functions, beside the least
that they could take.

The least is by counting what a stage cannot do without, at rates measured on this machine in the
same run. It leaves out what a stage could in principle avoid (gathering rows for the product,
writing the ranks of a histogram, reading candidates that lie side by side), so a stage at 2 of it
is fast, and one far above it has room.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from common import busy, table
from trabecula.engine.compile import kernel
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.texture.config import TextureConfig

STAGES = {
    "sliced": ("transport_neighbourhoods",),
    "two-point": ("two_point_step", "misfit", "torus_step"),
    "project": ("features_of",),
    "search": ("_search_sweep", "exact_search"),
    "vote": ("cast_votes", "energy_vote"),
    "histogram": ("match_votes", "match_histogram"),
    "choice": ("brightest_voxels",),
}
"""Stage -> functions of `texture` and `shared` by their names. What one spends inside another
counts for the inner.
"""

_ROOMS = ("trabecula.synth.texture.", "trabecula.synth.shared.")


@dataclass
class Stage:
    """What a stage took and did; `work` is in the unit of `COUNTED`, and None where nothing was
    counted.
    """

    seconds: float = 0.0
    calls: int = 0
    work: float | None = None

    def add(self, work: float) -> None:
        """Count work done."""
        self.work = work + (self.work or 0.0)


@dataclass
class Profile:
    """The stages of one run, and the largest table of candidates that it searched."""

    config: TextureConfig
    stages: dict[str, Stage] = field(default_factory=lambda: {name: Stage() for name in STAGES})
    candidates: np.ndarray = field(default_factory=lambda: np.zeros((1, 8), np.int16))
    running: list[str] = field(default_factory=list)
    inner: float = 0.0  # seconds of stages inside the one that runs

    def note(self, name: str, subject: Any) -> None:
        """One call of a stage on a grid, or on a field."""
        stage = self.stages[name]
        stage.calls += 1
        counted = COUNTED.get(name)
        if counted is not None and counted.of is not None:
            work = counted.of(self, subject)
            if work is not None:
                stage.add(work)
        if isinstance(subject, Grid) and subject.candidates.features.size > self.candidates.size:
            self.candidates = subject.candidates.features


@dataclass(frozen=True)
class Counted:
    """What a stage is counted in, and how much of it a call on a grid or field does (None:
    elsewhere).
    """

    unit: str
    of: Callable[[Profile, Any], float | None] | None = None


def _sites(grid: Grid) -> int:
    return int(np.count_nonzero(grid.active))


def _products(profile: Profile, grid: Grid) -> float:
    length, count = grid.candidates.basis.vectors.shape
    return _sites(grid) * length * count


def _rows(profile: Profile, grid: Grid) -> float | None:
    """Bytes of the rows at random places that a sweep looks at; a site's own and its neighbours'
    lie near those before.
    """
    if profile.config.search != "coherent":
        return None
    rows = grid.candidates.features
    return _sites(grid) * 2 * profile.config.tries * rows.shape[1] * rows.itemsize


def _additions(profile: Profile, grid: Grid) -> float:
    """One addition a voxel of every neighbourhood that votes, all its voxels counted."""
    return _sites(grid) * len(grid.candidates.stack.field) * grid.candidates.basis.width**3


def _passes(profile: Profile, subject: Any) -> float | None:
    """Bytes: votes read to count them, read again to map them, the field written."""
    if not isinstance(subject, np.ndarray):
        return None  # counted where it matches each channel
    return subject.size * (2 + 2 + 1)


COUNTED = {
    "two-point": Counted("operations of transforms"),  # counted by `_transform`
    "project": Counted("multiply-adds", _products),
    "search": Counted("bytes of random rows", _rows),
    "vote": Counted("additions", _additions),
    "histogram": Counted("bytes", _passes),
}


@contextmanager
def watched(config: TextureConfig) -> Iterator[Profile]:
    """Time the stages of what runs inside the block."""
    profile = Profile(config)
    modules = [m for name, m in list(sys.modules.items()) if name.startswith(_ROOMS)]
    replaced = [(np.fft, name, getattr(np.fft, name)) for name in ("fft", "ifft", "rfft", "irfft")]
    for module, name, function in replaced:
        setattr(module, name, _transform(function, profile))
    for stage, names in STAGES.items():
        for module, name in ((m, n) for m in modules for n in names if hasattr(m, n)):
            replaced.append((module, name, getattr(module, name)))
            setattr(module, name, _wrapped(getattr(module, name), stage, profile))
    try:
        yield profile
    finally:
        for module, name, function in replaced:
            setattr(module, name, function)


def _wrapped(function: Callable[..., Any], stage: str, profile: Profile) -> Callable[..., Any]:
    def wrapper(subject: Any, *arguments: Any, **settings: Any) -> Any:
        outer, profile.inner = profile.inner, 0.0
        profile.running.append(stage)
        start = time.process_time()
        result = function(subject, *arguments, **settings)
        spent = time.process_time() - start
        profile.running.pop()
        profile.stages[stage].seconds += spent - profile.inner
        profile.inner = outer + spent
        profile.note(stage, subject)
        return result

    return wrapper


def _transform(function: Callable[..., Any], profile: Profile) -> Callable[..., Any]:
    """Count 5 n log2 n operations of a complex transform of n values, half for a real one."""

    def wrapper(values: np.ndarray, n: int | None = None, axis: int = -1) -> Any:
        result = function(values, n=n, axis=axis)
        if profile.running[-1:] == ["two-point"]:
            real = values if np.isrealobj(values) else result
            length = real.shape[axis]
            profile.stages["two-point"].add(
                (2.5 if np.isrealobj(real) else 5) * real.size * np.log2(length)
            )
        return result

    return wrapper


def rates(candidates: np.ndarray) -> dict[str, float]:
    """By stage what this machine does in a second, one thread, best of five each; rows are those of
    `candidates`.
    """
    draw = np.random.default_rng(0)
    square = draw.random((1024, 1024), np.float32)
    cube = draw.random((128, 128, 128), np.float32)
    chosen = draw.integers(0, len(candidates), 1 << 20)
    row, to = np.ones(4096, np.int32), np.zeros(4096, np.int32)  # within the first cache
    volume, copied = np.ones((2, 1 << 26), np.uint8)  # beyond the last

    def adds() -> None:
        for _ in range(4096):
            np.add(to, row, out=to)

    return {
        "two-point": 2.5 * cube.size * np.log2(cube.size) / _best(lambda: np.fft.rfftn(cube)),
        "project": 1024**3 / _best(lambda: square @ square),
        "search": chosen.size
        * candidates[0].nbytes
        / _best(lambda: _read_rows(candidates, chosen)),
        "vote": 4096**2 / _best(adds),
        "histogram": 2 * volume.nbytes / _best(lambda: np.copyto(copied, volume)),
    }


@kernel
def _read_rows(table, chosen):
    """The sum of the squares of these rows: what a comparison with each has to read and to add."""
    total = np.int64(0)
    for n in chosen:
        row = table[n]
        part = np.int32(0)
        for i in range(row.shape[0]):
            part += np.int32(row[i]) * np.int32(row[i])
        total += part
    return total


def _best(job: Callable[[], Any]) -> float:
    job()  # compiles
    return min(busy(job)[0] for _ in range(5))


def show(profile: Profile, whole: float, title: str) -> None:
    """The stages of a run that took `whole` seconds."""
    rate = rates(profile.candidates)
    row = table(
        f"{title}: stage",
        "s",
        "share",
        "calls",
        "counted, 1e9",
        "1e9/s",
        "floor, s",
        "s / floor",
        wide=36,
    )
    least = 0.0
    for name, stage in profile.stages.items():
        if not stage.calls:
            continue
        cells: list[object] = [
            f"{stage.seconds:.3f}",
            f"{stage.seconds / whole:.0%}",
            stage.calls,
            *["-"] * 4,
        ]
        if stage.work:
            floor = stage.work / rate[name]
            least += floor
            cells[3:] = [f"{stage.work / 1e9:.3f}", f"{rate[name] / 1e9:.2f}", f"{floor:.3f}"]
            cells.append(f"{stage.seconds / floor:.1f}")
        row(f"{name} ({COUNTED[name].unit})" if name in COUNTED else name, *cells)
    rest = whole - sum(stage.seconds for stage in profile.stages.values())
    row("rest", f"{rest:.3f}", f"{rest / whole:.0%}", *["-"] * 5)
    row("all", f"{whole:.3f}", *["-"] * 4, f"{least:.3f}", f"{whole / least:.1f}")

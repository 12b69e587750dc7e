"""Scaling on paper: a volume of 4096^3 on 1 to 1,000 workers, reckoned from what one block costs
here.

Measured: seconds of making, of packing and writing one block and one block of a coarser level,
bytes of its file, seconds a task costs a Dask scheduler, seconds a byte of the digest. Then a
simulation of what the client does: every task passes the one scheduler, workers take the next that
can be done, what they write shares the file system, and the digest comes at the end.
"""

from __future__ import annotations

import heapq
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import trabecula as tb
from big import place
from common import table
from trabecula.core.recipe import digest
from trabecula.engine.chunking import Task, sources_of, tasks_of
from trabecula.engine.multiscale import halve_resolution, shapes_of
from trabecula.engine.store import CHUNK
from trabecula.synth.api.windows import WindowModel

SIDE = 4096
WORKERS = (1, 10, 100, 1000)
SHARED = 1e9
"""Bytes a second that a parallel file system is taken to write for all together."""
_NO_TASKS = 2000


@dataclass(frozen=True)
class Cost:
    """Of one block of a level: seconds of a worker, and bytes written."""

    seconds: float
    bytes: int


def big_scaling() -> None:
    """Time, and how many times faster than one worker, for 4096^3 in blocks of 128 and 256. The
    digest at the end is on top.
    """
    side = int(os.environ.get("TRABECULA_BENCH_SIDE", SIDE))
    each = _task_seconds()
    print(
        f"{each * 1e3:.2f} ms a task for the scheduler; {SHARED / 1e9:.0f} GB/s are "
        "taken for the file system\n"
    )
    heads = ("a block s", "KiB", *(f"{count} workers" for count in WORKERS), "digest")
    row = table(f"{side}^3", *heads, wide=14)
    shapes = shapes_of((side,) * 3, 2 * CHUNK)
    for edge in (CHUNK, 2 * CHUNK):
        tasks = tasks_of(shapes, side=edge, chunk=CHUNK)
        sources = sources_of(tasks, shapes, side=edge, chunk=CHUNK)
        for name, model in _models():
            costs, reading = _costs(model, edge)
            spent = [simulated(tasks, sources, costs, count, each) for count in WORKERS]
            cells = [f"{_time(t)} {spent[0] / t:.0f}x" for t in spent]
            told = f"{costs[0].seconds:.2f}", f"{costs[0].bytes / 1024:.0f}"
            row(f"{name}, {edge}", *told, *cells, _time(reading * side**3))


def simulated(
    tasks: Sequence[Task],
    sources: Sequence[Sequence[int]],
    costs: Sequence[Cost],
    workers: int,
    each: float,
) -> float:
    """Seconds until the last task is done."""
    waits, next_ = [len(before) for before in sources], [[] for _ in tasks]
    for number, before in enumerate(sources):
        for source in before:
            next_[source].append(number)
    ready = [(0.0, number) for number, count in enumerate(waits) if not count]
    heapq.heapify(ready)
    free, scheduler, disk, end = [0.0] * workers, 0.0, 0.0, 0.0
    while ready:
        can, number = heapq.heappop(ready)
        cost = costs[min(tasks[number].level, len(costs) - 1)]
        scheduler = max(scheduler, can) + each
        made = max(heapq.heappop(free), scheduler) + cost.seconds
        disk = max(disk, made) + cost.bytes / SHARED
        heapq.heappush(free, disk)
        end = max(end, disk)
        for after in next_[number]:
            waits[after] -= 1
            if not waits[after]:
                heapq.heappush(ready, (disk, after))
    return end


def _models() -> list[tuple[str, WindowModel]]:
    found = [("noise", tb.method("noise").fit(tb.crop(tb.sample("bone"), 64)))]
    found.append(("bubbles, foam", tb.method("bubbles", preset="foam").fit()))
    with suppress(tb.errors.MissingExtraError):
        found.append(("gan, bone", tb.load_model("bone")))
    return found


def _costs(model: WindowModel, edge: int) -> tuple[list[Cost], float]:
    """Of a block of voxels and of one of a coarser level, and seconds a voxel of reading for the
    digest.
    """
    request, box = tb.Request(1024, seed=1), tuple((2 * edge, 3 * edge) for _ in range(3))
    model.values_of(request, tuple((0, 16) for _ in range(3)))
    making, values = _timed(lambda: model.values_of(request, box))
    fine = np.tile(values[:CHUNK, :CHUNK, :CHUNK], (2, 2, 2))
    halving, coarse = _timed(lambda: halve_resolution(fine, labels=True))
    with place() as folder:
        writing, size = _written(values, folder / "block.zarr")
        coarser, less = _written(coarse, folder / "coarse.zarr")
        reading, _ = _timed(lambda: digest(tb.read(folder / "block.zarr").values))
    return [Cost(making + writing, size), Cost(halving + coarser, less)], reading / values.size


def _written(values: np.ndarray, path: Path) -> tuple[float, int]:
    """Seconds of writing voxels into a store, and the bytes of its files."""
    seconds, _ = _timed(lambda: tb.write(tb.Image(values, "labels"), path))
    return seconds, sum(file.stat().st_size for file in (path / "0").rglob("*") if file.is_file())


def _timed(job: Callable[[], Any]) -> tuple[float, Any]:
    """The least seconds of three runs, and what the last gave."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        made = job()
        times.append(time.perf_counter() - start)
    return min(times), made


def _task_seconds() -> float:
    """What a task costs the scheduler, client and all."""
    import distributed

    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        client.gather(client.map(abs, range(100), pure=False))
        start = time.perf_counter()
        client.gather(client.map(abs, range(_NO_TASKS), pure=False))
        return (time.perf_counter() - start) / _NO_TASKS


def _time(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 600
        else f"{seconds / 60:.0f} min"
        if seconds < 6000
        else f"{seconds / 3600:.1f} h"
    )

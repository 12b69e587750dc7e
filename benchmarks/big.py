"""Volumes in blocks: what cutting costs, memory against its forecast, kills at random moments,
workers.

`--side N` makes another size than 256^3, `--methods NAME ...` takes some. Every run is a process of
its own.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import trabecula as tb
from common import table
from trabecula.engine import checkpoint
from trabecula.engine.blocks import boxes_of
from trabecula.pipeline.generate import generate_to, partial_path, resume
from trabecula.synth.api.method import Model
from trabecula.synth.api.registry import methods

KILLS = 100
WORDS = {"noise": ("sample:bone", "--crop", "64", "--method", "noise"), "gan": ("--model", "bone")}
"""Of the command, by method; window methods alone. Others that need no exemplar are added by name.
"""


@dataclass(frozen=True)
class Ran:
    """What a command took: seconds of the processor and on the wall, bytes at most, and what it
    printed as JSON.
    """

    busy: float
    wall: float
    peak: int
    found: dict


def side_of() -> int:
    """Voxels a side of what is made."""
    return int(os.environ.get("TRABECULA_BENCH_SIDE", "256").split(";")[0])


def command(*words: object) -> Ran:
    """Run `trabecula ... --json` as a process."""
    program = [
        sys.executable,
        "-m",
        "trabecula.cli.main",
        *map(str, words),
        "--threads",
        "1",
        "--json",
    ]
    return spend(program)


def spend(program: list[str]) -> Ran:
    """Run a program that prints JSON, as a process."""
    start = time.perf_counter()
    with tempfile.TemporaryFile("w+") as out:
        child = subprocess.Popen(program, stdout=out, stderr=subprocess.PIPE, text=True)
        err = child.stderr.read() if child.stderr else ""
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise SystemExit(f"{' '.join(program)}: {err}")
        out.seek(0)
        found = json.loads(out.read())
    return Ran(
        used.ru_utime + used.ru_stime, time.perf_counter() - start, used.ru_maxrss * 1024, found
    )


def sources() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Window methods and what the command says of each, those alone whose extras are here."""
    only = os.environ.get("TRABECULA_BENCH_METHODS", "").split(";")
    for name, spec in methods().items():
        if only != [""] and name not in only:
            continue
        if spec.scaling != "window" or (spec.extras and importlib.util.find_spec("torch") is None):
            continue
        if name in WORDS:
            yield name, WORDS[name]
        elif spec.alone:
            yield name, ("--method", name)


@contextmanager
def place() -> Iterator[Path]:
    """A folder for what is made, beside no other work."""
    with tempfile.TemporaryDirectory(prefix="big-") as folder:
        yield Path(folder)


def big_blocks() -> None:
    """At once and in blocks, to a .zarr, one thread: seconds of the processor beyond those of 16^3,
    peaks, forecasts, digests.

    The better of two runs. `over` is what blocks cost beyond the run at once; `peak / forecast` is
    of the whole process. The seconds of the forecast are on the wall: they say something on a quiet
    machine only.
    """
    side, heads = (
        side_of(),
        (
            "busy s",
            "ns / voxel",
            "over",
            "wall s",
            "forecast s",
            "peak MiB",
            "/ forecast",
            "sha256",
        ),
    )
    row = table(f"{side}^3", *heads, wide=20)
    for name, words in sources():
        asked = ("--seed", 1, *words)
        with place() as folder:
            small = (*asked, "--shape", 16, "--out", folder / "least.zarr")
            least = min((command("generate", *small) for _ in range(2)), key=lambda ran: ran.busy)
            at_once = None
            for title, cut in (
                ("at once", ()),
                ("blocks of 256", ("--chunks", 256)),
                ("blocks of 128", ("--chunks", 128)),
            ):
                if title == "at once" and side > 512:
                    continue
                run = (*asked, "--shape", side, "--out", folder / "x.zarr", *cut)
                plan = command("plan", *run).found
                made = min((command("generate", *run) for _ in range(2)), key=lambda ran: ran.busy)
                took = made.busy - least.busy
                at_once = at_once or took
                row(
                    f"{name}, {title}",
                    f"{took:.2f}",
                    f"{took / side**3 * 1e9:.0f}",
                    f"{took / at_once - 1:+.0%}",
                    f"{made.wall:.1f}",
                    f"{plan['seconds']:.1f}",
                    f"{made.peak / 2**20:.0f}",
                    f"{made.peak / plan['peak']:.2f}",
                    made.found["sha256"][:8],
                )


def big_kills() -> None:
    """A run in blocks of 32, killed at a random moment and gone on with: are the voxels the same?

    `blocks there` is what of level 0 had been written by then. Methods that make a volume as a
    whole keep their state after every round here; `states` is how many of the kills left one, or
    all voxels.
    """
    row = table(
        "", "kills", "while running", "identical", "blocks there", "states", "left over", wide=12
    )
    picture = tb.Image(
        tb.sample("bone").values[32], "labels", (0.04, 0.04), "mm", ("void", "solid")
    )
    bone = tb.crop(tb.sample("bone"), 40)
    asked = {
        "noise": (tb.method("noise", reach=4, corrections=2), tb.crop(bone, 24), 96),
        "texture": (tb.method("texture", preset="fast"), bone, 64),
        "quilt": (tb.method("quilt", preset="fast"), bone, 64),
        "kopf": (tb.method("kopf", preset="fast"), picture, 40),
        "mrf": (tb.method("mrf", sweeps=(1, 2, 4)), picture, 40),
    }
    only = os.environ.get("TRABECULA_BENCH_METHODS", "").split(";")
    for name, (method, exemplar, side) in asked.items():
        if only != [""] and name not in only:
            continue
        with place() as folder:
            tb.write(exemplar, folder / "scan.tif")
            model = method.fit(tb.read(folder / "scan.tif"))
            row(name, *_killed(model, tb.Request(side, seed=1), folder / "out" / "x.zarr"))


def _killed(model: Model, request: tb.Request, path: Path) -> list[object]:
    """What is told of many kills of one run."""
    whole = model.generate(request).recipe.steps[-1]["sha256"]

    def begin() -> None:
        checkpoint.EVERY = 0.0
        generate_to(model, request, path, chunks=32)

    def go_on() -> None:
        left = partial_path(path).exists() or path.exists()
        made = resume(path) if left else generate_to(model, request, path, chunks=32)
        (path.parent.parent / "sha256").write_text(made.sha256)

    importlib.import_module("zarr")  # once, and not in every copy
    start = time.perf_counter()
    _child(begin)
    longest = time.perf_counter() - start
    _remove(path)
    rng, same, caught, states, there = np.random.default_rng(0), 0, 0, 0, []
    for _ in range(KILLS):
        caught += _child(begin, kill_after=float(rng.uniform(0, longest)))
        there.append(
            len([file for file in partial_path(path).rglob("0/c/*/*/*") if not file.suffix])
        )
        scratch = path.with_name(path.name + ".scratch")
        states += (scratch / "state").exists() or (scratch / "made.json").exists()
        _child(go_on)
        same += (path.parent.parent / "sha256").read_text() == whole
        _remove(path)
    left = len(list(path.parent.iterdir()))
    spread = f"{min(there)} .. {max(there)} of {len(boxes_of(request.shape, 32))}"
    return [KILLS, caught, same, spread, states, left]


def big_workers() -> None:
    """The same volume by 1, 2 and 3 processes of this machine: digests, and seconds on the wall
    (start of workers included).
    """
    row = table(f"{side_of()}^3 noise", "wall s", "sha256")
    with place() as folder:
        asked = (
            "--seed",
            1,
            *WORDS["noise"],
            "--shape",
            side_of(),
            "--out",
            folder / "x.zarr",
            "--chunks",
            128,
        )
        for count in (0, 1, 2, 3):
            made = command("generate", *asked, *(("--workers", count) if count else ()))
            row(
                f"{count} workers" if count else "this process",
                f"{made.wall:.1f}",
                made.found["sha256"][:8],
            )


def _child(job: Callable[[], None], *, kill_after: float | None = None) -> bool:
    """Run a job in a copy of this process, which it may not outlive; whether it was killed while it
    ran.

    The parent never opens a store, so that no thread of zarr is lost in the copy.
    """
    child = os.fork()
    if child == 0:
        status = 1
        try:
            job()
            status = 0
        finally:
            os._exit(status)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if kill_after is None and status:
        raise SystemExit("the run failed")
    return os.WIFSIGNALED(status)


def _remove(path: Path) -> None:
    for one in (path, partial_path(path)):
        shutil.rmtree(one, ignore_errors=True)

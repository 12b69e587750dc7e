"""Saved results of the comparison with the five papers: one JSON file a run, in
`benchmarks/results/papers`.

A file holds the tables that the run printed, and where they come from: the command that makes them
again, commit, date, machine, seconds. Cells are strings, as the case printed them.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from common import Table, recorded
from trabecula.core.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "benchmarks" / "results" / "papers"
PICTURES = ROOT / "docs" / "images" / "papers"
LIBRARIES = ("numpy", "numba", "torch")


@dataclass(frozen=True)
class Saved:
    """One run: what it printed, and where that comes from."""

    name: str
    command: str
    commit: str
    """The commit that was measured, with a `+` where code was not committed yet."""
    date: str
    machine: Mapping[str, Any]
    seconds: Mapping[str, float]
    """Of the processor, and on the wall."""
    tables: tuple[Table, ...]

    def cell(self, row: str, head: str, *, table: str = "") -> str:
        """Return a cell by the name of its row and the head of its column; of several tables, of
        that whose first head is `table`.

        Raises
        ------
        InputError
            There is no such cell.
        """
        found = [
            cells[one.heads.index(head)]
            for one in self.tables
            if table in ("", one.heads[0]) and head in one.heads
            for cells in one.rows
            if cells[0] == row
        ]
        if len(found) != 1:
            raise InputError(f"run {self.name!r} has no cell {row!r}, {head!r}: run it again")
        return found[0]

    def has(self, row: str) -> bool:
        """Return whether a table has a row of this name."""
        return any(cells[0] == row for one in self.tables for cells in one.rows)


def load(name: str) -> Saved:
    """Return a saved run.

    Raises
    ------
    InputError
        It was never saved.
    """
    path = FOLDER / f"{name}.json"
    if not path.is_file():
        raise InputError(
            f"no saved result of {name!r}: make it with trabecula bench papers --run {name}"
        )
    found = json.loads(path.read_text(encoding="utf-8"))
    tables = tuple(Table(one["heads"], one["rows"]) for one in found.pop("tables"))
    return Saved(**found, tables=tables)


def measure(name: str, run: Callable[[], None]) -> Saved:
    """Run a case, and save what it printed."""
    wall, busy = time.perf_counter(), time.process_time()
    with recorded() as tables:
        run()
    seconds = {
        "processor": round(time.process_time() - busy, 1),
        "wall": round(time.perf_counter() - wall, 1),
    }
    found = Saved(
        name=name,
        command=f"trabecula bench papers --run {name}",
        commit=_commit(),
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        machine=machine(),
        seconds=seconds,
        tables=tuple(tables),
    )
    FOLDER.mkdir(parents=True, exist_ok=True)
    text = json.dumps(asdict(found), indent=1, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    return found


def machine() -> dict[str, Any]:
    """Return what seconds depend on: processor, cores, memory, load, GPU, versions; no names."""
    torch = sys.modules.get("torch")
    gpu = torch is not None and torch.cuda.is_available()
    return {
        **({"gpu": torch.cuda.get_device_name()} if gpu else {}),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
        "threads": 1,
        "load": round(os.getloadavg()[0], 1),
        "python": platform.python_version(),
        **{name: found for name in LIBRARIES if (found := _version(name))},
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    found = {
        key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)
    }
    wide = " with AVX-512" if "avx512f" in found.get("flags", "") else ""
    return found.get("model name", platform.machine()) + wide


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _commit() -> str:
    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "src", "benchmarks/*.py")
    return (git("rev-parse", "--short=10", "HEAD") or "unknown") + ("+" if changed else "")

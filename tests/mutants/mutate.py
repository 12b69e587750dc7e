"""Mutation run: apply each entry of `mutants.toml` to a copy of the package, run the tests nearest
to it, print which of the faults the tests find.

    python tests/mutants/mutate.py [--only WORD ...] [--jobs 2] [--list]

An entry is `file` (below `src/trabecula`), `old` and `new` text, `tests` (pytest's node ids or
files), a `reason` and, where no test can tell the two apart, an `equivalent` with the argument.
Such an entry is not run. The copies are in `build/mutants`; the working tree stays as it is. They
keep Numba's cache from run to run: a compiled kernel holds the code of the kernels that it calls,
so that a change of a file drops the compiled kernels of every file that calls into it, too.
"""

from __future__ import annotations

import argparse
import ast
import multiprocessing
import os
import shutil
import signal
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from hypothesis import Phase, settings

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SOURCE = ROOT / "src"
COPIES = ROOT / "build" / "mutants"
ENTRIES = HERE / "mutants.toml"

GOAL = 0.95
"""Least share of the mutants that the tests must kill."""

TIMEOUT = 600.0
"""Seconds for the tests of one mutant."""


@dataclass(frozen=True)
class Mutant:
    """A fault: `old` text of `file` replaced by `new`, and the tests that should find it."""

    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    reason: str
    equivalent: str = ""

    @property
    def room(self) -> str:
        """Return the folder of the package; of a method its own."""
        parts = self.file.split("/")
        return "/".join(parts[:2] if parts[0] == "synth" else parts[:1])

    def apply(self, text: str) -> str:
        """Return the text with the fault; raise where `old` does not stand in it exactly once."""
        found = text.count(self.old)
        if found != 1 or self.old == self.new:
            raise ValueError(f"{self.file}: old text found {found} times: {self.old!r}")
        return text.replace(self.old, self.new)


def read_entries() -> list[Mutant]:
    """Read `mutants.toml`."""
    entries = tomllib.loads(ENTRIES.read_text())["mutant"]
    return [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]


def _module(file: str) -> str:
    return "trabecula." + file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@cache
def _calls_of_kernels() -> dict[str, frozenset[str]]:
    """Return for each file with kernels the modules whose names those kernels use."""
    found = {}
    for path in sorted((SOURCE / "trabecula").rglob("*.py")):
        tree = ast.parse(path.read_text())
        homes = {
            name.asname or name.name: node.module
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module
            for name in node.names
        }
        used = {
            name.id
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef)
            and {getattr(mark, "id", "") for mark in node.decorator_list} & {"kernel", "inline"}
            for name in ast.walk(node)
            if isinstance(name, ast.Name)
        }
        if used:
            file = path.relative_to(SOURCE / "trabecula").as_posix()
            found[file] = frozenset(homes[name] for name in used & homes.keys())
    return found


def _compiled_with(file: str) -> set[str]:
    """Return the files whose compiled kernels hold code or constants of `file`, itself too."""
    found, fresh = {file}, {_module(file)}
    while fresh:
        callers = {other for other, homes in _calls_of_kernels().items() if homes & fresh} - found
        fresh = {_module(other) for other in callers}
        found |= callers
    return found


def _write(package: Path, file: str, text: str) -> None:
    """Write a file of a copy and drop what is compiled with it."""
    path = package / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)  # it may be a hard link
    path.write_text(text)
    for other in _compiled_with(file):
        stem = package / other
        for kept in (stem.parent / "__pycache__").glob(f"{stem.stem}.*"):
            kept.unlink()


def refresh_copy() -> Path:
    """Bring the copy of the package up to date; return the folder for PYTHONPATH."""
    base = COPIES / "base"
    package, source = base / "trabecula", SOURCE / "trabecula"
    files = {path.relative_to(source).as_posix() for path in source.rglob("*.py")}
    for gone in {path.relative_to(package).as_posix() for path in package.rglob("*.py")} - files:
        (package / gone).unlink()
    for file in sorted(files):
        text = (source / file).read_text()
        if not (package / file).exists() or (package / file).read_text() != text:
            _write(package, file, text)
    for path in source.rglob("*"):
        if path.is_file() and path.suffix not in {".py", ".pyc", ".nbi", ".nbc"}:
            target = package / path.relative_to(source)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, target)
    return base


@cache
def _processes() -> Any:
    """Return where tests run: one process imports what takes seconds, each mutant's tests are a
    fork of it.
    """
    found = multiprocessing.get_context("forkserver")  # not on Windows
    found.set_forkserver_preload(
        ["numba", "hypothesis", "scipy.stats", "scipy.ndimage", "trimesh", "zarr", "torch"]
    )
    return found


def _test(copy: Path, tests: list[str], log: Path, told: Connection) -> None:
    """Run tests against a copy, in a process of its own; send pytest's status and CPU seconds."""
    with log.open("wb") as output:
        for stream in (1, 2):
            os.dup2(output.fileno(), stream)
    os.setsid()
    os.chdir(ROOT)
    os.environ.update(PYTHONPATH=str(copy), TRABECULA_THREADS="1")
    sys.dont_write_bytecode = False  # compiling the package takes longer than most tests
    sys.path.insert(0, str(copy))
    # The first counterexample is enough, the smallest takes long.
    settings.register_profile("first", phases=[Phase.explicit, Phase.generate])
    settings.load_profile("first")
    status = pytest.main(["-x", "--no-header", "-p", "no:cacheprovider", *tests])
    told.send((int(status), sum(os.times()[:4])))


def run_tests(
    copy: Path, tests: Sequence[str], log: Path, *, timeout: float | None = None
) -> tuple[str, float]:
    """Run tests against a copy, their output into a file; return "passed", "failed", "timeout" or
    what else came, and the seconds of CPU.
    """
    told, sender = _processes().Pipe(duplex=False)
    process = _processes().Process(target=_test, args=(copy, list(tests), log, sender))
    process.start()
    sender.close()
    try:
        if not told.poll(timeout):
            return "timeout", 0.0
        status, seconds = told.recv()
    except EOFError:
        return "no result", 0.0
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.join()
    names = {0: "passed", 1: "failed", 5: "no test"}
    return names.get(status, f"pytest: {status}"), seconds


def try_mutant(mutant: Mutant, base: Path, copy: Path) -> tuple[str, float]:
    """Return "killed", "survived", "timeout" or why the tests did not run, and the seconds of
    CPU.
    """
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(base, copy, copy_function=os.link)
    text = (base / "trabecula" / mutant.file).read_text()
    _write(copy / "trabecula", mutant.file, mutant.apply(text))
    outcome, seconds = run_tests(copy, mutant.tests, copy.with_suffix(".log"), timeout=TIMEOUT)
    return {"failed": "killed", "passed": "survived"}.get(outcome, outcome), seconds


def table(results: list[tuple[Mutant, str]]) -> str:
    """Return killed, survived and others by room."""
    rooms = sorted({mutant.room for mutant, _ in results})
    lines = [
        f"{'room':<16}{'killed':>8}{'survived':>10}{'timeout':>9}{'other':>7}{'equivalent':>12}"
    ]
    for room in [*rooms, "all"]:
        counts = Counter(result for mutant, result in results if room in (mutant.room, "all"))
        known = [counts.pop(name, 0) for name in ("killed", "survived", "timeout")]
        same = counts.pop("equivalent", 0)
        lines.append(
            f"{room:<16}{known[0]:>8}{known[1]:>10}{known[2]:>9}{counts.total():>7}{same:>12}"
        )
    return "\n".join(lines)


def _run_unchanged(base: Path, mutants: Sequence[Mutant], jobs: int) -> float | None:
    """Run all tests of the mutants without a fault, which fills the cache of kernels; return the
    seconds of CPU, None where one fails.
    """
    files: dict[str, set[str]] = {}
    for mutant in mutants:
        for test in mutant.tests:
            files.setdefault(test.partition("::")[0], set()).add(test)
    logs = [base.parent / f"unchanged-{number}.log" for number in range(len(files))]
    with ThreadPoolExecutor(jobs) as pool:
        tests = (sorted(nodes) for nodes in files.values())
        found = list(pool.map(lambda nodes, log: run_tests(base, nodes, log), tests, logs))
    for file, log, (outcome, _) in zip(files, logs, found, strict=True):
        if outcome != "passed":
            print(f"{outcome} without a fault: {file}\n{log.read_text()}")
    seconds = sum(each for _, each in found)
    print(f"without a fault: {seconds:.0f} s of CPU", flush=True)
    return seconds if all(outcome == "passed" for outcome, _ in found) else None


def main() -> int:
    """Run the mutants; return 1 where too few are killed."""
    parser = argparse.ArgumentParser(description="Run the mutants of mutants.toml.")
    parser.add_argument("--only", nargs="*", help="words: entries whose file or reason holds one")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants at once")
    parser.add_argument("--list", action="store_true", help="print the entries, run nothing")
    chosen = parser.parse_args()
    mutants = [
        mutant
        for mutant in read_entries()
        if not chosen.only or any(word in mutant.file + mutant.reason for word in chosen.only)
    ]
    if chosen.list:
        print("\n".join(f"{mutant.file}: {mutant.reason}" for mutant in mutants))
        return 0
    base = refresh_copy()
    run = [mutant for mutant in mutants if not mutant.equivalent]
    started = time.monotonic()
    seconds = _run_unchanged(base, run, chosen.jobs)
    if seconds is None:
        return 2
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(chosen.jobs):
        copies.put(COPIES / f"copy-{number}")

    def attempt(mutant: Mutant) -> tuple[str, float]:
        copy = copies.get()
        try:
            result, seconds = try_mutant(mutant, base, copy)
        finally:  # else the others would wait for it without end
            copies.put(copy)
        print(f"{result:<9} {seconds:5.1f} s  {mutant.file}: {mutant.reason}", flush=True)
        return result, seconds

    with ThreadPoolExecutor(chosen.jobs) as pool:
        found = list(pool.map(attempt, run))
    seconds += sum(each for _, each in found)
    results = [(mutant, result) for mutant, (result, _) in zip(run, found, strict=True)]
    results += [(mutant, "equivalent") for mutant in mutants if mutant.equivalent]
    killed = sum(result == "killed" for _, result in results)
    print(f"\n{table(results)}\n\n{killed} of {len(run)} killed ({killed / max(len(run), 1):.1%})")
    print(f"{time.monotonic() - started:.0f} s, {seconds:.0f} s of CPU")
    return 0 if killed >= GOAL * len(run) else 1


if __name__ == "__main__":
    sys.exit(main())

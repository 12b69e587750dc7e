"""Run a sample of tests with kernels as plain Python and count the branches of kernels they reach.

    python tests/plain_kernels.py [pytest's arguments]

Compiled, a kernel hides its lines from coverage, reads past the end of an array without a word and
wraps integers; as plain Python it does none of this. It is a hundred times slower, so the sample is
of rooms whose tests have small arrays, and a test that takes longer than some seconds is given up.
The exit status is pytest's.
"""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "trabecula"
REPORT = ROOT / "build" / "plain_kernels.json"
SETTINGS = ROOT / "build" / "plain_kernels.ini"

SAMPLE = (
    *("numerics", "mesh", "measure", "finish", "fields"),
    *("synth/test_nearest.py", "synth/test_mrf_density.py", "synth/test_slices_shared.py"),
    *("synth/test_shared.py", "synth/test_texture_paper.py", "synth/quilt/test_quilt_cut.py"),
    *("synth/bubbles/test_growth.py", "synth/bubbles/test_draw.py"),
)
"""Tests that run, below `tests`. Most tests of methods take too long: they are not among them."""

PATIENCE = 2.0
"""Seconds after which a test is given up."""


def _give_up(number: int, frame: object) -> None:
    pytest.skip(f"takes longer than {PATIENCE:g} s where kernels are plain Python")


def _run_for_a_while() -> Iterator[None]:
    """Give a fixture or a test up when its time is over (on Windows never)."""
    if not hasattr(signal, "setitimer"):
        return (yield)
    signal.signal(signal.SIGALRM, _give_up)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """Limit the time of fixtures."""
    return (yield from _run_for_a_while())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Limit the time of tests."""
    return (yield from _run_for_a_while())


def kernels_of(path: Path) -> set[str]:
    """Return the names of the functions of a file that are compiled."""
    return {
        node.name
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and {getattr(mark, "id", "") for mark in node.decorator_list} & {"kernel", "inline"}
    }


def branches(report: dict) -> dict[str, list[int]]:
    """Return for each room the branches of its kernels that were reached, and all of them."""
    found: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for file, measured in report["files"].items():
        path = ROOT / file
        room = path.relative_to(PACKAGE).parts[0]
        for name in kernels_of(path):
            summary = measured["functions"][name]["summary"]
            found[room][0] += summary["covered_branches"]
            found[room][1] += summary["num_branches"]
    return {room: counts for room, counts in sorted(found.items()) if counts[1]}


def main() -> int:
    """Run the sample, print the table; return pytest's exit status."""
    SETTINGS.parent.mkdir(exist_ok=True)
    SETTINGS.write_text("[run]\nbranch = true\nsource = trabecula\n", encoding="utf-8")
    coverage = ["--cov", f"--cov-config={SETTINGS}", f"--cov-report=json:{REPORT}"]
    command = [sys.executable, "-m", "pytest", "-n", "auto", "--maxprocesses", "8", *coverage]
    command += ["-p", "plain_kernels", "-m", "not whole", *sys.argv[1:]]
    command += [f"tests/{name}" for name in SAMPLE]
    path = os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path.strip(os.pathsep)}
    status = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    table = branches(json.loads(REPORT.read_text(encoding="utf-8")))
    table["all"] = [sum(counts) for counts in zip(*table.values(), strict=True)]
    sys.stdout.write("room           branches of kernels reached, of all\n")
    for room, (reached, number) in table.items():
        sys.stdout.write(f"{room:12} {reached:6} {number:6}  {reached / number:.0%}\n")
    return status


if __name__ == "__main__":
    raise SystemExit(main())

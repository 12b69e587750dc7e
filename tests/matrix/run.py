"""Install the wheel into fresh environments and try it there: every Python at hand, oldest and
newest dependencies.

    python tests/matrix/run.py [--python 3.12 ...] [--dependencies oldest newest] [--environments
    DIR]

Pythons are found on PATH, with pyenv and with uv. "oldest" are the lower bounds of pyproject.toml,
as requirements/oldest.txt lists them; "newest" is whatever the package index gives without any pin.
A cell takes about three minutes, most of which is the compilation of kernels.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
OLDEST_PYTHON = (3, 11)
TESTS = (
    "tests/matrix/smoke.py",
    "tests/io",
    "tests/core/test_image.py",
    "tests/core/test_arrays.py",
)
TOOLS = ("pytest", "hypothesis")
SHOWN = (
    "numpy",
    "numba",
    "zarr",
    "tifffile",
    "pillow",
    "nibabel",
    "pynrrd",
    "threadpoolctl",
    "filelock",
    "psutil",
)
SETS = ("oldest", "newest")
LIMIT = 1200  # seconds of one step


class Cell(NamedTuple):
    """What came of one environment."""

    python: str
    dependencies: str
    outcome: str
    passed: bool
    seconds: float
    versions: str


def main(words: Sequence[str] | None = None) -> int:
    """Try every cell in turn, print the table, and return 0 where all of them passed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--python",
        nargs="+",
        metavar="X.Y",
        help='only these; "last" is the newest at hand (default: all)',
    )
    parser.add_argument("--dependencies", nargs="+", choices=SETS, default=SETS)
    parser.add_argument(
        "--environments",
        type=Path,
        metavar="DIR",
        help="keep them here (default: a folder that goes)",
    )
    options = parser.parse_args(words)
    pythons = find_pythons()
    wanted = [list(pythons)[-1] if one == "last" else one for one in options.python or []]
    missing = sorted(set(wanted) - set(pythons))
    if missing:
        parser.error(f"no Python {', '.join(missing)} at hand: there is {', '.join(pythons)}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(options.environments or temporary).resolve()
        cells = []
        for version in wanted or pythons:
            for dependencies in options.dependencies:
                print(f"Python {version}, {dependencies} dependencies ...", flush=True)
                cells.append(try_cell(pythons[version], version, dependencies, folder))
                print(f"  {cells[-1].outcome}, {cells[-1].seconds:.0f} s", flush=True)
    print(table(cells))
    return 0 if all(cell.passed for cell in cells) else 1


def find_pythons() -> dict[str, Path]:
    """Return an interpreter for every version that is at hand and can make environments, the oldest
    first.
    """
    found: dict[tuple[int, int, int], Path] = {}
    for path in (Path(sys.executable), *_candidates()):
        version = _version_of(path)
        if version is not None and version[:2] >= OLDEST_PYTHON:
            found.setdefault(version, path)
    # the newest patch stays
    return {f"{version[0]}.{version[1]}": found[version] for version in sorted(found)}


def _candidates() -> Iterator[Path]:
    for folder in os.get_exec_path():
        yield from sorted(
            path
            for path in Path(folder).glob("python3*")
            if re.fullmatch(r"python3(\.\d+)?", path.name)
        )
    for root in _answers("pyenv", "root"):
        yield from sorted(Path(root, "versions").glob("*/bin/python3"))
    for line in _answers("uv", "python", "list", "--only-installed"):
        yield Path(line.split()[1])


def _answers(*command: str) -> list[str]:
    """Return the lines that a program prints; none where it is not installed or fails."""
    if shutil.which(command[0]) is None:
        return []
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    return done.stdout.splitlines() if done.returncode == 0 else []


def _version_of(python: Path) -> tuple[int, int, int] | None:
    """Return an interpreter's version; None where it does not run (a shim), is no release, or lacks
    venv.
    """
    ask = "import sys, venv, ensurepip; print(*sys.version_info[:3], sys.version_info[3])"
    try:
        done = subprocess.run(
            [python, "-c", ask], capture_output=True, text=True, check=False, timeout=60
        )
    except OSError:
        return None
    words = done.stdout.split()
    if done.returncode != 0 or len(words) != 4 or words[3] != "final":
        return None
    return int(words[0]), int(words[1]), int(words[2])


def try_cell(python: Path, version: str, dependencies: str, folder: Path) -> Cell:
    """Make an environment, install the wheel and the tests' tools, and run the tests in it."""
    started, home = time.monotonic(), folder / f"{version}-{dependencies}"
    # What the caller set for its own environment must not reach into this one.
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    }
    inside = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    pip = [inside, "-m", "pip", "--disable-pip-version-check", "-q"]
    pinned = (
        ["--constraint", ROOT / "requirements" / "oldest.txt"]
        if dependencies == "oldest"
        else ["--upgrade"]
    )
    steps = {
        "environment": [python, "-m", "venv", "--clear", home],
        "wheel": [*pip, "wheel", "--no-deps", "--wheel-dir", home / "wheel", ROOT],
        "install": [
            *pip,
            "install",
            "--only-binary",
            ":all:",
            *pinned,
            "--find-links",
            home / "wheel",
            *TOOLS,
            "trabecula",
        ],
        "tests": [inside, "-m", "pytest", "-p", "no:cacheprovider", *TESTS],
    }
    outcome, passed = "", False
    for name, command in steps.items():
        if name == "install":
            command = [*command[:-1], next((home / "wheel").glob("trabecula-*.whl"))]
        try:
            done = subprocess.run(
                command,
                cwd=ROOT,
                env=clean,
                capture_output=True,
                text=True,
                check=False,
                timeout=LIMIT,
            )
            text, passed = done.stdout + done.stderr, done.returncode == 0
        except subprocess.TimeoutExpired:
            text, passed = f"more than {LIMIT} s", False
        if not passed:
            print(*text.splitlines()[-60:], sep="\n", flush=True)
            outcome = f"{name}: FAILED"
            break
        outcome = "passed"
    if name == "tests":
        counted = re.findall(r"\d+ (?:passed|failed|skipped|errors?)", text)
        outcome = ", ".join(counted) or outcome
    return Cell(
        version, dependencies, outcome, passed, time.monotonic() - started, _list_versions(inside)
    )


def _list_versions(python: Path) -> str:
    ask = (
        "import sys, importlib.metadata as m; "
        "print(*(f'{n} {m.version(n)}' for n in sys.argv[1:]), sep=', ')"
    )
    done = subprocess.run([python, "-c", ask, *SHOWN], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def table(cells: Sequence[Cell]) -> str:
    """Return the cells as a table, one a line."""
    rows = [("Python", "dependencies", "result", "s", "versions")]
    rows += [(c.python, c.dependencies, c.outcome, f"{c.seconds:.0f}", c.versions) for c in cells]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = [
        "  ".join([*(f"{text:{width}}" for text, width in zip(row, widths, strict=False)), row[4]])
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

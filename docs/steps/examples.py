"""Run the examples of a page, in order, in a fresh folder with one namespace.

- ```python blocks are executed. A ```text block right after one is what it prints.
- ```console blocks: every line `$ trabecula ...` is run and must exit with 0, or with 2 where a
line of the block says
  `# exit 2`. The other lines are what it prints; a block that shows nothing promises nothing.

In what is shown `...` stands for anything, and runs of blanks count as one. Other languages, and
other commands than trabecula, are not run. The folder holds stand-ins for a user's scans (see
`stand_ins`).

A picture that a page shows as `../made/FOLDER/PAGE/NAME.png` is one that its examples wrote as
NAME.png. The blocks of tutorials are the cells of notebooks (steps/notebooks.py). What was made is
kept beside the page's key, so it need not be made again.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import shlex
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np

from steps import notebooks
from steps.blocks import Block, blocks_of
from steps.cache import ExampleCache

_SAME = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# Depends on what was run before on this machine.
_BY_THE_WAY = re.compile(
    r"^trabecula: (compiling kernels.*|.* (\d+ of \d+|\d+%)(, \d+% of the run)?(, .* left)?)\n",
    re.MULTILINE,
)
"""Lines that slow machines print: of compiling, and of progress every 30 seconds."""


class WrongExampleError(Exception):
    """An example that does not do what its page says; the message begins with the line in the
    block, from 0.
    """

    def __init__(self, line: int, what: str) -> None:
        super().__init__(what)
        self.line = line


def run(paths: list[Path], *, home: Path, cache: ExampleCache | None = None) -> dict[str, str]:
    """Run the examples of these pages, but for those that a cache knows to pass; return the pages
    that failed, each with `page:line: why`.
    """
    failures, known = {}, 0
    with tempfile.TemporaryDirectory() as stock:
        stand_ins(Path(stock))
        for path in paths:
            start, begun = time.monotonic(), time.process_time()
            blocks = list(runnable(path.read_text(encoding="utf-8")))
            if not blocks:
                continue
            name = path.relative_to(home)
            key = None if cache is None else cache.key(name.as_posix(), [*blocks, _pictures(path)])
            place = home / "docs" / notebooks.MADE / path.parent.name / path.stem
            if key is not None and cache.has(key):
                cache.restore(key, place)
                known += 1
                continue
            shutil.rmtree(place, ignore_errors=True)
            failure = _run_page(name, blocks, Path(stock), place, path.read_text(encoding="utf-8"))
            seconds, used = time.monotonic() - start, time.process_time() - begun
            print(
                f"docs:   {name}: {len(blocks)} examples, {seconds:.1f} s, "
                f"{used:.1f} s of the processor",
                flush=True,
            )
            if failure:
                failures[name.as_posix()] = failure
            elif key is not None:
                cache.add(key, name.as_posix(), place)
    if known:
        print(f"docs:   {known} pages passed before, and nothing of them has changed", flush=True)
    return failures


def _pictures(path: Path) -> list[str]:
    """List the pictures that a page shows of its examples."""
    return re.findall(r"\.\./made/[^)\s]+", path.read_text(encoding="utf-8"))


def stand_ins(folder: Path) -> None:
    """Write `femur.tif`, a segmented scan of 0 and 255, and `scan.tif`, a noisy grey one: made from
    sample:bone, without metadata.
    """
    import tifffile

    from trabecula import sample
    from trabecula.measure import signed_distance

    solid = sample("bone").values
    tifffile.imwrite(folder / "femur.tif", solid * np.uint8(255))
    noise = np.random.Generator(np.random.Philox(key=1)).normal(0.0, 14.0, solid.shape)
    grey = 120 + 22 * signed_distance(solid == 1, clip=3.0) + noise
    tifffile.imwrite(folder / "scan.tif", np.clip(grey, 0, 255).astype(np.uint8))


def runnable(text: str) -> Iterator[Block]:
    """List the python and console blocks, the former with the text block that follows it."""
    lines, found = text.splitlines(), list(blocks_of(text))
    for block, after in pairwise([*found, None]):
        if block.language == "console" and "$ trabecula" in block.text:
            yield block
        elif block.language == "python":
            end = block.line + block.text.count("\n")  # the line number of the closing fence
            follows = (
                after is not None
                and after.language == "text"
                and not "".join(lines[end : after.line - 2]).strip()
            )
            yield Block("python", block.text, block.line, after.text if follows else None)


def _run_page(page: Path, blocks: list[Block], stock: Path, place: Path, source: str) -> str | None:
    """Run a page, keep what it made in `place`, and return the reason why it failed, or None."""
    cells: list[notebooks.Output] = []
    tutorial = page.parent.name == notebooks.FOLDER
    # A module of its own: dataclasses, among others, look up the module that they are made in.
    module = sys.modules["example"] = ModuleType("example")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        shutil.copytree(stock, folder, dirs_exist_ok=True)
        for block in blocks:
            try:
                if block.language == "python" and tutorial:
                    cells.append(notebooks.run_cell(page, block, module.__dict__, place))
                elif block.language == "python":
                    _run_python(page, block, module.__dict__)
                else:
                    _run_console(block)
            except WrongExampleError as error:
                return f"{page}:{block.line + error.line}: {error}"
            except Exception as error:  # noqa: BLE001 (any error is its page's fault)
                frames = traceback.extract_tb(error.__traceback__)
                lines = [frame.lineno for frame in frames if frame.filename == str(page)]
                number = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
                line = number or (lines or [block.line])[-1]
                return f"{page}:{line}: {type(error).__name__}: {error}"
        name = f"{page.parent.name}/{page.stem}"
        missing = notebooks.keep_pictures(source, name, Path(folder), place)
        if missing:
            return f"{page}:1: the page shows {', '.join(missing)}, which no example made"
        if tutorial:
            notebooks.write_made(place, page.stem, source, cells)
    return None


def _run_python(page: Path, block: Block, namespace: dict) -> None:
    # Empty lines before the text give tracebacks the page's own line numbers.
    code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, namespace)
    if block.shown is not None:
        _check_same(block.shown, printed.getvalue(), line=block.text.count("\n") + 2)


def _run_console(block: Block) -> None:
    lines = block.text.splitlines()
    status = 2 if any("# exit 2" in line for line in lines) else 0
    for start, command, shown in _commands(lines):
        got, printed = _call(shlex.split(command, comments=True)[1:])
        if got != status:
            raise WrongExampleError(
                start, f"{command!r} exits with {got}, not {status}: {printed.strip()}"
            )
        if shown.strip():
            _check_same(shown, printed, line=start + 1)


def _commands(lines: list[str]) -> Iterator[tuple[int, str, str]]:
    """List every `$ trabecula ...` with its place in the block and the lines shown after it; `\\`
    continues a command.
    """
    at = 0
    while at < len(lines):
        start, command, shown = at, lines[at], []
        while command.endswith("\\") and at + 1 < len(lines):
            at += 1
            command = command[:-1] + lines[at]
        at += 1
        while at < len(lines) and not lines[at].startswith("$ "):
            shown.append(lines[at])
            at += 1
        if command.startswith("$ trabecula"):
            kept = [line for line in shown if not line.startswith("# ")]
            yield start, command.removeprefix("$ "), "\n".join(kept) + "\n"


def _call(words: list[str]) -> tuple[int, str]:
    """Return the exit status and everything printed, as a terminal shows it."""
    from trabecula.cli.main import main

    printed = io.StringIO()
    width = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "100"
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            status = main(words)
    except SystemExit as stop:
        status = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    finally:
        os.environ.pop("COLUMNS") if width is None else os.environ.update(COLUMNS=width)
    return status, _BY_THE_WAY.sub("", printed.getvalue())


def _check_same(shown: str, printed: str, *, line: int) -> None:
    if not doctest.OutputChecker().check_output(shown, printed, _SAME):
        raise WrongExampleError(line, f"the page shows\n{shown}but it prints\n{printed}")

"""One damaged file: which, how, and what its reader makes of it."""

import shutil
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from crafted import CRAFTED
from damage import DAMAGES
from specimens import READERS, Reader, check

from trabecula.errors import TrabeculaError

CRAFTED_SHARE = 0.3
"""Of the cases, those whose file is made to harm; the others damage a whole one."""
MADE = "made to harm"

_WHOLE = tempfile.TemporaryDirectory(prefix="fuzz-whole-")  # goes with the process


def choose(seed: int, number: int) -> tuple[Reader, str, np.random.Generator, Any]:
    """Return the reader of a case, the name of its damage, its random numbers, and who makes it."""
    rng = np.random.default_rng([seed, number])
    if rng.random() < CRAFTED_SHARE:
        reader, make = CRAFTED[int(rng.integers(len(CRAFTED)))]
        return reader, MADE, rng, make
    reader = READERS[int(rng.integers(len(READERS)))]
    name = list(DAMAGES)[int(rng.integers(len(DAMAGES)))]
    return reader, name, rng, DAMAGES[name]


def attempt(seed: int, number: int, folder: Path) -> None:
    """Write the file of a case into a folder, and read it."""
    reader, name, rng, change = choose(seed, number)
    if name == MADE:
        path = reader.write(folder)
        change(rng, path)
    else:
        whole = _whole(READERS.index(reader))
        shutil.copytree(whole.parent, folder, dirs_exist_ok=True)
        path = change(rng, folder / whole.name)
    check(reader.read(path))


def prepare() -> None:
    """Write a whole file of every reader, and read it: kernels are compiled then."""
    for index, reader in enumerate(READERS):
        path = _whole(index)
        with tempfile.TemporaryDirectory() as folder:
            shutil.copytree(path.parent, folder, dirs_exist_ok=True)
            with suppress(TrabeculaError):
                check(reader.read(Path(folder) / path.name))


@cache
def _whole(index: int) -> Path:
    """Return a whole file of a reader, made once a process."""
    folder = Path(_WHOLE.name) / str(index)
    folder.mkdir()
    return READERS[index].write(folder)

"""Examples that passed are not run again while nothing that they depend on has changed.

The key of a page is a hash of its examples, of the package, of the modules that pages import, of
what runs them, and of the versions of Python and NumPy. A passed page leaves a folder of that name
in build/docs-cache, with the pictures that its examples made; `docs/build.py --fresh` removes them
all.
"""

from __future__ import annotations

import hashlib
import platform
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np

_PAGE = "page.txt"


class ExampleCache:
    """The pages that passed, by their keys.

    Parameters
    ----------
    folder : Path
        Of the keys.
    sources : iterable of Path
        Files and folders on which every example depends.
    """

    def __init__(self, folder: Path, sources: Iterable[Path]) -> None:
        self.folder = folder
        digester = hashlib.sha256(f"{platform.python_version()} {np.__version__}".encode())
        for source in sources:
            for path in sorted(source.rglob("*")) if source.is_dir() else [source]:
                if path.is_file() and "__pycache__" not in path.parts:
                    name = path.relative_to(source.parent).as_posix()
                    digester.update(f"{name} {path.stat().st_size}\0".encode())
                    digester.update(path.read_bytes())
        self._package = digester.hexdigest()

    def key(self, page: str, blocks: Iterable[object]) -> str:
        """Return the key of a page with these examples."""
        text = "\0".join([self._package, page, *map(repr, blocks)])
        return hashlib.sha256(text.encode()).hexdigest()

    def has(self, key: str) -> bool:
        """Return whether the examples passed."""
        return (self.folder / key / _PAGE).exists()

    def add(self, key: str, page: str, made: Path | None = None) -> None:
        """Record that they did, and keep what they made."""
        place = self.folder / key
        shutil.rmtree(place, ignore_errors=True)
        if made is not None and made.is_dir():
            shutil.copytree(made, place)
        place.mkdir(parents=True, exist_ok=True)
        (place / _PAGE).write_text(page + "\n", encoding="utf-8")

    def restore(self, key: str, made: Path) -> None:
        """Put back what the examples made."""
        place = self.folder / key
        shutil.rmtree(made, ignore_errors=True)
        if any(path.name != _PAGE for path in place.iterdir()):
            shutil.copytree(place, made, ignore=shutil.ignore_patterns(_PAGE))

    def clear(self) -> None:
        """Forget all."""
        shutil.rmtree(self.folder, ignore_errors=True)

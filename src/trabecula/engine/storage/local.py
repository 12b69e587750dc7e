"""The location of a store, and a folder as the one case: it grows under another name, and takes its
own when it is complete.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from glob import escape
from pathlib import Path, PurePosixPath
from typing import Any

from trabecula.core.errors import FileError
from trabecula.engine.files import put_in_place, remove, replacing

ROOTS = ("zarr.json", ".zgroup", ".zarray")
"""Of which every Zarr store has one; ours have the first."""


class Location(os.PathLike[str]):
    """The location of a store.

    Names of its files are relative, with "/" between their parts.
    """

    name: str
    """Its name in messages."""

    stem: str
    """The last part of its name, without the suffix."""

    whole: bool
    """True where a file is always a complete one."""

    memory: int
    """Bytes that reaching it takes."""

    @property
    @abstractmethod
    def folder(self) -> Path:
        """Return a folder of this machine for what goes with the store: its parent, or the working
        directory for an address.
        """

    def beside(self, suffix: str) -> Path:
        """Return a name beside the store, such as rock.zarr.scratch, in that folder."""
        return self.folder / (PurePosixPath(self.name).name + suffix)

    @abstractmethod
    def __fspath__(self) -> str: ...

    def __str__(self) -> str:
        return os.fspath(self)

    @abstractmethod
    def growing(self) -> Location:
        """Return the location of the store until it is finished."""

    @abstractmethod
    def settle(self, grown: Location) -> None:
        """Move a finished store from where it grew to its place, and remove what killed runs left
        of such a move.
        """

    @abstractmethod
    def appearing(self) -> AbstractContextManager[Path]:
        """Yield a temporary folder; on success the store made there takes its place here, on
        failure nothing is left.
        """

    @abstractmethod
    def is_there(self) -> bool:
        """Return whether anything is stored there, a store or not."""

    @abstractmethod
    def is_store(self) -> bool:
        """Return whether a Zarr store is there."""

    @abstractmethod
    def files(self) -> set[str]:
        """Return the names of all files of the store."""

    @abstractmethod
    def missing(self, names: Sequence[str]) -> list[str]:
        """Return the names of which no file is there."""

    @abstractmethod
    def remove(self, names: Iterable[str]) -> None:
        """Remove files; a file that is not there is no error."""

    @abstractmethod
    def sweep(self) -> None:
        """Remove the files that a killed run was writing."""

    @abstractmethod
    def zarr(self) -> Any:
        """Return the argument that zarr's functions take for the store."""

    def explain_errors(self, hint: str = "") -> AbstractContextManager[None]:
        """Turn the errors of reaching the store into one line, with a hint at its end."""
        return nullcontext()


class Folder(Location):
    """A store in a folder of this machine."""

    whole = False  # a disk may have spoilt it
    memory = 0

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name, self.stem = path.name, path.stem

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    @property
    def folder(self) -> Path:
        return self.path.absolute().parent

    def growing(self) -> Folder:
        """Return the folder beside it, as rock.zarr.part of rock.zarr."""
        return Folder(self.beside(".part"))

    def settle(self, grown: Location) -> None:
        put_in_place(Path(grown), self.path)
        for name in (self.name, Path(grown).name):
            for left in self.path.parent.glob(f".{'[0-9a-f]' * 8}-{escape(name)}"):
                remove(left)

    def appearing(self) -> AbstractContextManager[Path]:
        self.check_replaceable()
        return replacing(self.path)

    def check_replaceable(self) -> None:
        """Raise where something else than a store would be lost."""
        path = self.path
        if path.is_dir() and any(path.iterdir()) and not (path / "zarr.json").exists():
            raise FileError(
                f"cannot write {path}: a folder that is no Zarr store is there; choose another name"
            )

    def is_there(self) -> bool:
        return self.path.exists()

    def is_store(self) -> bool:
        return any((self.path / name).exists() for name in ROOTS)

    def files(self) -> set[str]:
        found: set[str] = set()
        for folder, _, names in os.walk(self.path):
            inside = Path(folder).relative_to(self.path).as_posix()
            found.update(names if inside == "." else (f"{inside}/{name}" for name in names))
        return found

    def missing(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if not (self.path / name).exists()]

    def remove(self, names: Iterable[str]) -> None:
        for name in names:
            (self.path / name).unlink(missing_ok=True)

    def sweep(self) -> None:
        self.remove(name for name in self.files() if name.endswith(".partial"))

    def zarr(self) -> Any:
        return str(self.path)

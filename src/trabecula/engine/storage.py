"""Locations of stores: a folder, or an address that fsspec reaches, such as s3://bucket/rock.zarr;
one code writes and reads both.

In a folder a store grows under another name, and takes its own when it is complete. An object store
cannot rename: a store has its name from the start, and says itself that it is not complete. An
object appears at once, and the one by which readers know a store is written after the others.
"""

from __future__ import annotations

import os
import re
import tempfile
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cached_property
from glob import escape
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.request import url2pathname
from uuid import uuid4

from trabecula.core.checks import as_path_text
from trabecula.core.errors import FileError, InputError, MissingExtraError, TrabeculaError
from trabecula.core.optional import need
from trabecula.engine.files import put_in_place, remove, replacing

AnyPath = str | os.PathLike[str]

ROOTS = ("zarr.json", ".zgroup", ".zarray")
"""Of which every Zarr store has one; ours have the first."""

_OURS = re.compile(r"\d+/(zarr\.json|c/[\d/]+)|\.probe-\w+")
_S3_KEYS = " (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, ...)"
_FEW = 8  # files that are asked for one by one

# two letters: one is a drive of Windows
_ADDRESS = re.compile(r"(?P<protocol>[a-z][a-z0-9+.:-]+)://", re.IGNORECASE)


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


class Remote(Location):
    """A store at an address; keys and endpoints come from the environment, as its service documents
    them.
    """

    whole = True  # an object appears at once, and its service keeps its checksum
    memory = 64 << 20  # s3fs with all that it imports: 48 MiB measured

    def __init__(self, address: str) -> None:
        bare = address.rstrip("/")
        self.name = address if bare.endswith(":") else bare
        self.stem = PurePosixPath(self.name).stem

    def __fspath__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"Remote({self.name!r})"

    @property
    def folder(self) -> Path:
        return Path.cwd()

    @cached_property
    def _files(self) -> tuple[Any, str]:
        """Return the file system and the root in it."""
        return self._system()

    def _system(self, **options: Any) -> tuple[Any, str]:
        if "::" in self.name:
            raise InputError(
                f"cannot reach {self}: chains of addresses are not followed; give the last one "
                "alone"
            )
        fsspec = need("fsspec", extra="remote", purpose=f"reaching {self}")
        try:
            # Listings that are kept would not show what other processes wrote.
            found, root = fsspec.url_to_fs(self.name, use_listings_cache=False, **options)
        except ImportError as error:
            raise MissingExtraError(
                f"reaching {self} needs a package that is not installed (for s3: pip install "
                f"'trabecula[remote]'): {error}"
            ) from error
        except (ValueError, OSError) as error:
            raise InputError(
                f"cannot reach {self}: {error}; give a path, or an address that fsspec knows "
                "(s3://BUCKET/NAME.zarr)"
            ) from error
        return found, root.rstrip("/")

    def growing(self) -> Remote:
        """Return the same location: an object store cannot rename."""
        return self

    def settle(self, grown: Location) -> None:
        """Do nothing: the store is in place once it says that it is complete."""

    @contextmanager
    def appearing(self) -> Iterator[Path]:
        """Yield a temporary folder that is uploaded on success. An existing store is not replaced,
        since that takes more than one step.
        """
        self.check_free()
        with tempfile.TemporaryDirectory() as folder:
            made = Folder(Path(folder) / PurePosixPath(self.name).name)
            yield made.path
            try:
                self._upload(made)
            except BaseException:
                with suppress(Exception):  # the first error is the one to tell
                    self.remove(made.files())
                raise

    def _upload(self, made: Folder) -> None:
        """Copy a store from a folder, the file by which readers know it last."""
        fs, root = self._files
        with self._translate_errors():
            self.remove(self.files())  # chunks of an upload that was killed would pass for ours
            names = sorted(made.files() - set(ROOTS))
            fs.put([str(made.path / name) for name in names], [f"{root}/{name}" for name in names])
            for name in ROOTS:
                if (made.path / name).exists():
                    fs.pipe_file(f"{root}/{name}", (made.path / name).read_bytes())

    def is_there(self) -> bool:
        """Return whether anything is stored there; what a killed upload left counts for nothing."""
        return not self.missing(ROOTS[:1]) or any(
            not _OURS.fullmatch(name) for name in self.files()
        )

    def is_store(self) -> bool:
        return any(not self.missing([name]) for name in ROOTS)

    def files(self) -> set[str]:
        fs, root = self._files
        with self._translate_errors():
            return {name.removeprefix(f"{root}/") for name in fs.find(root)}

    def missing(self, names: Sequence[str]) -> list[str]:
        fs, root = self._files
        if len(names) > _FEW:
            there = self.files()
            return [name for name in names if name not in there]
        with self._translate_errors():
            return [name for name in names if not fs.exists(f"{root}/{name}")]

    def remove(self, names: Iterable[str]) -> None:
        fs, root = self._files
        with self._translate_errors():
            there = [f"{root}/{name}" for name in set(names) & self.files()]
            if there:
                fs.rm(there)

    def sweep(self) -> None: ...

    def zarr(self) -> Any:
        from zarr.storage import FsspecStore

        with self._translate_errors():
            fs, root = self._system(asynchronous=True)
            if not fs.async_impl:
                from fsspec.implementations.asyn_wrapper import AsyncFileSystemWrapper

                fs = AsyncFileSystemWrapper(fs, asynchronous=True)
            return FsspecStore(fs, path=root)

    def check_writable(self) -> None:
        """Raise where nothing can be written there.

        Raises
        ------
        FileError
            Nobody answers, there is no such bucket, or no right to write or to list.
        """
        fs, root = self._files
        probe = f".probe-{uuid4().hex}"
        with self._translate_errors():
            fs.pipe_file(f"{root}/{probe}", b"")
            self.remove([probe])

    def check_free(self) -> None:
        """Raise where something is there.

        Raises
        ------
        FileError
            As it says, or as `check_writable`.
        """
        if self.is_there():
            raise FileError(
                f"cannot write {self}: something is there, and an object store cannot replace it "
                "in one step; remove it, or choose another name"
            )

    @contextmanager
    def explain_errors(self, hint: str = "") -> Iterator[None]:
        # What the rest says is of the store's contents, not of the way there.
        with self._translate_errors(
            hint, passed=(LookupError, TypeError, ValueError, RuntimeError)
        ):
            yield

    @contextmanager
    def _translate_errors(
        self, hint: str = "", *, passed: tuple[type[Exception], ...] = ()
    ) -> Iterator[None]:
        """Turn every error of a service, or of the package for it, into one line."""
        try:
            yield
        except Exception as error:  # of any kind: every service has its own
            if isinstance(error, (TrabeculaError, MemoryError, *passed)):
                raise
            if isinstance(error, NotImplementedError):
                raise FileError(
                    f"cannot write {self}: at such an address one can only read; choose another"
                ) from error
            reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise FileError(
                f"cannot reach {self}: {reason[:200]}; check the address, the network, and what "
                "the environment says of endpoint and "
                f"keys{_S3_KEYS if self.name.startswith('s3') else ''}{hint}"
            ) from error


def is_address(path: AnyPath) -> bool:
    """Return whether a path is an address beyond this machine's folders."""
    found = _ADDRESS.match(as_path_text(path))
    return found is not None and found["protocol"].lower() not in ("file", "local")


def location_of(path: AnyPath) -> Location:
    """Return the location that a path or an address names; file:// is a folder."""
    if isinstance(path, Location):
        return path
    text = as_path_text(path)
    if is_address(text):
        return Remote(text)
    found = _ADDRESS.match(text)
    return Folder(Path(path) if found is None else Path(url2pathname(text[found.end() :])))


def path_or_remote(path: AnyPath) -> Path | Remote:
    """Return the location for callers that read other files as well: a path where it is one."""
    found = location_of(path)
    return found if isinstance(found, Remote) else Path(found)

"""A store at an address that fsspec reaches.

An object store cannot rename: a store has its name from the start, and says itself that it is not
complete. An object appears at once, and the one by which readers know a store is written after the
others.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any
from uuid import uuid4

from trabecula.core.errors import FileError, InputError, MissingExtraError, TrabeculaError
from trabecula.core.optional import need
from trabecula.engine.storage.local import ROOTS, Folder, Location

_OURS = re.compile(r"\d+/(zarr\.json|c/[\d/]+)|\.probe-\w+")
_S3_KEYS = " (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, ...)"
_FEW = 8  # files that are asked for one by one


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

"""One process at a time: a lock on what grows at a path, which ends with its process however that
ends.
"""

from __future__ import annotations

import errno
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from trabecula.core.errors import FileError

_held: ContextVar[frozenset[Path]] = ContextVar("trabecula_locks", default=frozenset())
"""What this run has locked, so that what it calls may lock it again."""

_TAKEN = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK)
"""How systems say that another process has the lock."""


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep others from what grows at `path` while the block lasts.

    The lock is on a file beside it, .NAME.lock, which is removed at the end; one that a killed
    process left means nothing. A file system without locks, or that cannot be written, locks
    nothing: whoever writes there tells what is wrong.

    Raises
    ------
    FileError
        Another run has it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with locked(Path(folder) / "rock.zarr.part"):
    ...         print([entry.name for entry in Path(folder).iterdir()])
    ['.rock.zarr.part.lock']
    """
    path = Path(os.path.realpath(path))
    if path in _held.get():
        yield
        return
    file = path.with_name(f".{path.name}.lock")
    descriptor = _acquired(path, file)
    token = _held.set(_held.get() | {path})
    try:
        yield
    finally:
        _held.reset(token)
        if descriptor is not None:
            _release(descriptor, file)


def _acquired(path: Path, file: Path) -> int | None:
    """A descriptor of the lock's file, locked; None where nothing can be locked."""
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None
        try:
            _lock(descriptor)
            # Who had it may have removed the file after we opened it: then others lock another file
            # of that name.
            if os.path.samestat(os.fstat(descriptor), file.stat()):
                _sign(descriptor)
                return descriptor
        except FileNotFoundError:
            pass
        except OSError as error:
            if error.errno in _TAKEN:
                owner = _signature(file)
                os.close(descriptor)
                raise FileError(
                    f"{path.name} is being written by another run{owner}: wait until that has ended, or choose another --out"
                ) from error
            os.close(descriptor)
            return None
        os.close(descriptor)


def _release(descriptor: int, file: Path) -> None:
    if os.name == "nt":  # an open file cannot be removed there
        os.close(descriptor)
    with suppress(OSError):
        file.unlink(missing_ok=True)
    if os.name != "nt":
        os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Lock a file or raise OSError at once."""
    if os.name == "nt":
        import msvcrt

        # beyond what is written, which others may then read
        os.lseek(descriptor, 1 << 20, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _sign(descriptor: int) -> None:
    """Write who has the lock, for whom it refuses."""
    with suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, f"process {os.getpid()} on {platform.node()}".encode())


def _signature(file: Path) -> str:
    try:
        text = file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return f" ({text})" if text and text.isprintable() else ""

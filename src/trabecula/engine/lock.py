"""Locks between processes: one run at a time writes to a path.

A lock ends with its process, however that ends (`filelock`).
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from trabecula.core.errors import FileError

if TYPE_CHECKING:
    from filelock import BaseFileLock

_PATIENCE = 0.2  # seconds in which a run that has just ended removes its file

_held: ContextVar[frozenset[Path]] = ContextVar("trabecula_locks", default=frozenset())
"""Paths that this run has locked, so that a function which it calls may lock them again."""


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Keep other runs from writing to `path` while the block lasts.

    The lock is on a file beside it, .NAME.lock, which is removed at the end; one that a killed
    process left means nothing. Where the file system knows no locks, or cannot be written, nothing
    is locked: the writer that follows reports the fault.

    Raises
    ------
    FileError
        Another run has the lock.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with hold_lock(Path(folder) / "rock.zarr.part"):
    ...         print([entry.name for entry in Path(folder).iterdir()])
    ['.rock.zarr.part.lock']
    """
    path = Path(os.path.realpath(path))
    if path in _held.get():
        yield
        return
    file = path.with_name(f".{path.name}.lock")
    lock = _acquire(path, file)
    token = _held.set(_held.get() | {path})
    try:
        yield
    finally:
        _held.reset(token)
        if lock is not None:
            _release(lock, file)


def _acquire(path: Path, file: Path) -> BaseFileLock | None:
    """Return the lock, signed with this process; None where nothing can be locked."""
    from filelock import FileLock, Timeout

    # A soft lock would outlive a killed process.
    lock = FileLock(file, timeout=_PATIENCE, thread_local=False, fallback_to_soft=False)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise FileError(
            f"{path.name} is being written by another run{_signature(file)}: wait until that has "
            "ended, or choose another --out"
        ) from None
    except (OSError, NotImplementedError):
        return None
    with suppress(OSError):  # Windows lets nobody write to a locked file
        file.write_text(f"process {os.getpid()} on {platform.node()}", encoding="utf-8")
    return lock


def _release(lock: BaseFileLock, file: Path) -> None:
    """Remove the file, then release the lock: whoever waits for it finds that the file is gone, and
    opens a new one.
    """
    with suppress(OSError):
        file.unlink(missing_ok=True)
    lock.release()
    if os.name == "nt":  # an open file cannot be removed there
        with suppress(OSError):
            file.unlink(missing_ok=True)


def _signature(file: Path) -> str:
    try:
        text = file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return f" ({text})" if text and text.isprintable() else ""

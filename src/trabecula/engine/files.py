"""Files that appear whole or not at all."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from trabecula.core.errors import FileError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it takes the place of `path`, on failure
    nothing is left.

    The temporary name keeps the suffix, since writers choose their format by it. Works for files
    and for folders.

    Raises
    ------
    FileError
        The folder cannot be written, the disk is full, or a folder is where a file should go.
    """
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex[:8]}-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        put_in_place(temporary, path)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(
            f"cannot write {path}: {error.strerror or error}; check the folder, its rights and the "
            "space left"
        ) from error
    finally:
        remove(temporary)


def put_in_place(temporary: Path, path: Path) -> None:
    """Give a finished file or folder its name; what had that name before goes."""
    if path.is_dir() and not temporary.is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    if path.is_dir() and not path.is_symlink():
        # A folder cannot be replaced in one step: set the old one aside, so that a failure can put
        # it back.
        aside = path.with_name(f".{uuid.uuid4().hex[:8]}-{path.name}")
        path.rename(aside)
        try:
            temporary.rename(path)
        except OSError:
            aside.rename(path)
            raise
        remove(aside)
    else:
        temporary.replace(path)


def remove(path: Path) -> None:
    """Remove a file or a folder with all in it, as far as can be; what is not there is no error."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        # Where the folder never came to be there is nothing to remove, and the first error is the
        # one to tell.
        with suppress(OSError):
            path.unlink(missing_ok=True)

"""Settings that are more than a word: a file of numbers, an array, a function.

A setting has to fit into a recipe, which is plain JSON. So each of these is a descriptive text that
carries the object itself beside it: "field.npy#sha256=..." is read and checked again by whoever
makes the material again; for an array or a function in memory the text can only say that it was
one.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import check_finite
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image
from trabecula.core.recipe import digest
from trabecula.io import files

MARK = "#sha256="
_ARRAY, _FUNCTION = "an array in memory, SHA-256 ", "a function in memory, "
_PROBES = 5  # points along an axis at which a function's values identify it


class Given(str):
    """A text for the recipe, with the object behind it.

    Attributes
    ----------
    array : array, or None
    function : callable, or None
    """

    array: np.ndarray | None = None
    function: Callable[..., Any] | None = None

    def __deepcopy__(self, memo: Any) -> Given:
        return self  # settings are copied often, and an array may be large


def as_given(value: Any, *, name: str) -> Given | None:
    """Return the object behind a setting, or None where it is plain text (a name, a formula).

    Raises
    ------
    InputError
        Not numbers; or the text of a recipe whose array or function is not at hand.
    FileError
        The file is missing or damaged, or another than its SHA-256 says.
    """
    if isinstance(value, Given):
        return value
    if isinstance(value, (Image, np.ndarray)):
        array = _numbers(value.values if isinstance(value, Image) else value, name=name)
        return _make_given(_ARRAY + digest(array), array=array)
    if callable(value):
        return _make_given(
            f"{_FUNCTION}{_name_of(value)}, SHA-256 of its values {_probe_digest(value, name)}",
            function=value,
        )
    if isinstance(value, os.PathLike):
        return _read(os.fspath(value), name=name)
    if not isinstance(value, str):
        raise InputError(
            f"{name}={value!r} should be a name, a formula, a file, an array or a function"
        )
    if value.startswith((_ARRAY, _FUNCTION)):
        what = "array" if value.startswith(_ARRAY) else "function"
        raise InputError(
            f"{name} was {value}: nothing says how to make it again; give the {what} as {name}, "
            "or its file"
        )
    is_file = MARK in value or Path(value).suffix.lower() in (
        ".npy",
        ".tif",
        ".tiff",
        ".nrrd",
        ".zarr",
        ".mhd",
    )
    return _read(value, name=name) if is_file else None


def _read(text: str, *, name: str) -> Given:
    """Read the numbers of a file, and check them against a SHA-256 in the text."""
    path, _, expected = text.partition(MARK)
    try:
        array = (
            _field_of(path, name)
            if path.lower().endswith(".npy")
            else _numbers(files.read(path).values, name=name)
        )
    except FileError as error:
        raise FileError(
            f"{name}={path}: {error}; it is looked for from the folder that the run is started in"
        ) from error
    found = digest(array)
    if expected and found != expected:
        raise FileError(
            f"{name}={path} holds other numbers (SHA-256 {found[:12]}) than the recipe says "
            f"({expected[:12]})"
        )
    return _make_given(f"{path}{MARK}{found}", array=array)


def _field_of(path: str, name: str) -> np.ndarray:
    """Read a plain array: a field of vectors has an axis more than an image."""
    try:
        with Path(path).open("rb") as file:
            return _numbers(np.load(file, allow_pickle=False), name=name)
    except (OSError, ValueError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise FileError(
            f"{path} cannot be read as an array ({error}): write it with np.save"
        ) from None


def _numbers(array: Any, *, name: str) -> np.ndarray:
    """Check that an array holds finite numbers."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise InputError(
            f"{name} holds {getattr(array, 'dtype', type(array).__name__)}: numbers are needed"
        )
    check_finite(array, name=name)
    return array


def _make_given(
    text: str, *, array: np.ndarray | None = None, function: Callable[..., Any] | None = None
) -> Given:
    """Build the text with its array or function."""
    made = Given(text)
    made.array, made.function = array, function
    return made


def _name_of(function: Callable[..., Any]) -> str:
    """Return the name of a function."""
    return str(getattr(function, "__qualname__", type(function).__name__))


def _probe_digest(function: Callable[..., Any], name: str) -> str:
    """Return a digest of a function's values at fixed points, to identify it."""
    at = np.linspace(-1.0, 1.0, _PROBES)
    z, y, x = (part.ravel() for part in np.meshgrid(at, at, at, indexing="ij"))
    return digest(call_function(function, z, y, x, name=name))[:12]


def call_function(
    function: Callable[..., Any], z: np.ndarray, y: np.ndarray, x: np.ndarray, *, name: str
) -> np.ndarray:
    """Return the vectors (z, y, x) of a user's function at points, (3, ...) float64.

    Raises
    ------
    InputError
        It returns something else than three arrays of the points' shape.
    """
    found = function(z.copy(), y.copy(), x.copy())
    try:
        z1, y1, x1 = (np.broadcast_to(np.asarray(part, np.float64), z.shape) for part in found)
    except (TypeError, ValueError):
        raise InputError(
            f"the function {_name_of(function)} ({name}) takes arrays z, y, x and returns three "
            f"arrays of their shape, the velocities along z, y and x: got {type(found).__name__}"
        ) from None
    return np.stack([z1, y1, x1])

"""The contract of a format of file: `check_format`."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe
from trabecula.io.files import read, write
from trabecula.testing.method_case import raises, same


def check_format(
    suffix: str,
    *,
    ndim: Sequence[int] = (2, 3),
    kinds: Sequence[str] = ("labels", "grey", "colour"),
    greys: Sequence[str] = ("uint8", "uint16", "float32"),
) -> None:
    """Check that a format keeps the contract: an image comes back as it was, and a file that is
    cut off is refused.

    Parameters
    ----------
    suffix : str
        Such as ".nrrd"; "/" for a folder of slices.
    ndim : sequence of int
        Axes that it holds.
    kinds : sequence of str
        Kinds of image that it holds.
    greys : sequence of str
        Types of grey values that it holds.

    Raises
    ------
    AssertionError
        With what differs.
    """
    for axes in ndim:
        for kind in kinds:
            for dtype in greys if kind == "grey" else ("uint8",):
                with tempfile.TemporaryDirectory() as folder:
                    _check_one(Path(folder), suffix, _image(axes, kind, dtype))


def _check_one(folder: Path, suffix: str, image: Image) -> None:
    """Check that one image comes back, and that half of its file is refused."""
    what = f"{suffix}: {image.ndim}-D {image.kind} {image.values.dtype}"
    path = write(image, f"{folder}/x{suffix}")
    back = read(path)
    same(back.values, image.values, f"{what} does not come back")
    for name in ("kind", "unit", "phases"):
        found, expected = getattr(back, name), getattr(image, name)
        assert found == expected, f"{what}: {name} is {expected!r}, comes back as {found!r}"
    assert np.allclose(back.spacing, image.spacing, rtol=1e-6, atol=0), (
        f"{what}: spacing is {image.spacing}, comes back as {back.spacing}"
    )
    assert back.values.dtype == image.values.dtype, f"{what}: comes back as {back.values.dtype}"
    assert back.recipe == image.recipe, f"{what}: the recipe does not come back"
    if Path(path).is_file():
        data = Path(path).read_bytes()
        Path(path).write_bytes(data[: len(data) // 2])
        with raises(FileError, "", f"{what}: half of a file is read without an error"):
            read(path)


def _image(ndim: int, kind: str, dtype: str) -> Image:
    """Return a small image with all that an image can say."""
    shape, rng = (5, 6, 7)[-ndim:], np.random.default_rng(ndim)
    phases = ("void", "solid", "binder") if kind == "labels" else ()
    if kind == "colour":
        shape = (*shape, 3)
    if np.dtype(dtype).kind == "f":
        values = rng.normal(0, 50, shape).astype(dtype)
    else:
        high = len(phases) or np.iinfo(dtype).max
        values = rng.integers(0, high, shape).astype(dtype)
    recipe = Recipe().then("made", values, seed=1, note="ä")
    return Image(values, kind, (0.5, 1.25, 2.0)[-ndim:], "um", phases, recipe)

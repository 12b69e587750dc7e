"""Certificates as one self-contained HTML page with pictures."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image
from trabecula.engine.lazy_volume import Slabs
from trabecula.io import files
from trabecula.pipeline.outputs import check_folder
from trabecula.report.page import page
from trabecula.report.page import write_page as write_html
from trabecula.report.verdict import Certificate
from trabecula.view.slices import montage
from trabecula.view.still import render

_SHOWN = 256
"""Voxels a side of the centre box that stands for a volume in slabs."""


def check_page(path: str | os.PathLike[str]) -> None:
    """Raise before any work is done where a page cannot be written to `path`."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InputError(f"a report is a page, {path} should end in .html")
    if Path(path).is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    check_folder(path)


def write_page(
    path: str | os.PathLike[str],
    exemplar: Image | Sequence[Image],
    images: Sequence[Image | Slabs],
    certificates: Sequence[Certificate],
) -> None:
    """Write certificates as one page, with slices and stills of exemplars and results.

    A volume in slabs is shown by a box in its centre.
    """
    exemplars = [exemplar] if isinstance(exemplar, Image) else list(exemplar)
    numbers = [""] if len(exemplars) == 1 else [f" {n}" for n in range(1, len(exemplars) + 1)]
    results = [certificate.name for certificate in certificates]
    names = [f"exemplar{number}" for number in numbers] + results
    shown = [*exemplars, *(_in_memory(image) for image in images)]
    title = "Slices through the middle" if images[0].ndim == 3 else "Images"
    pictures = [(title, _png(montage(shown, names)))]
    pictures += [
        (name, _png(render(image, size=(640, 480))))
        for name, image in zip(names, shown, strict=True)
        if image.ndim == 3 and image.kind == "labels"
    ]
    write_html(page(certificates, pictures=pictures), Path(path))


def _in_memory(image: Image | Slabs) -> Image:
    if isinstance(image, Slabs):
        return image.centre([min(side, _SHOWN) for side in image.shape])
    return image


def _png(picture: Image) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        files.write(picture, path)
        return path.read_bytes()

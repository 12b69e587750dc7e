"""Certificates as one self-contained HTML page with pictures."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, with_values
from trabecula.engine.lazy_volume import Slabs
from trabecula.io import files
from trabecula.pipeline.outputs import check_folder
from trabecula.report.dependence import spread_boxes
from trabecula.report.ensemble import choose_evenly
from trabecula.report.ensemble_certificate import EnsembleCertificate
from trabecula.report.ensemble_page import ensemble_page
from trabecula.report.page import page
from trabecula.report.page import write_page as write_html
from trabecula.report.source_map import own_source_map, source_map
from trabecula.report.verdict import Certificate
from trabecula.view.slices import montage
from trabecula.view.still import render

_SHOWN = 256
"""Voxels a side of the centre box that stands for a volume in slabs."""

_DRAWN = 3
"""Real parts, and members of an ensemble, that are shown."""


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
    """Write certificates as one page, with slices, stills and source maps of exemplars and results.

    A volume in slabs is shown by a box in its centre.
    """
    exemplars = [exemplar] if isinstance(exemplar, Image) else list(exemplar)
    numbers = [""] if len(exemplars) == 1 else [f" {n}" for n in range(1, len(exemplars) + 1)]
    results = [certificate.name for certificate in certificates]
    names = [f"exemplar{number}" for number in numbers] + results
    shown = [*exemplars, *(_in_memory(image) for image in images)]
    title = "Slices through the middle" if images[0].ndim == 3 else "Images"
    pictures = [(title, png_bytes(montage(shown, names)))]
    pictures += [
        (name, png_bytes(render(image, size=(1200, 900))))
        for name, image in zip(names, shown, strict=True)
        if image.ndim == 3 and image.kind == "labels"
    ]
    maps = []
    if certificates[0].about.get("level") != "quick" and len(exemplars) == 1:
        maps = _source_maps(exemplars[0], dict(zip(results, shown[1:], strict=True)))
    write_html(page(certificates, pictures=pictures, source_maps=maps), Path(path))


def _source_maps(exemplar: Image, images: Mapping[str, Image]) -> list[tuple[str, bytes]]:
    """Draw where results, and a half of the exemplar, might have been taken from."""
    drawn = {name: source_map(exemplar, image) for name, image in images.items()}
    if not any(drawn.values()):
        return []
    drawn["one half of the exemplar, searched in the other"] = own_source_map(exemplar)
    return [
        (f"{name}: a patch has {found.patch:.0f} voxels in the mean", png_bytes(found.picture))
        for name, found in drawn.items()
        if found is not None
    ]


def write_ensemble_page(
    path: str | os.PathLike[str],
    exemplars: Sequence[Image],
    members: Sequence[Image],
    certificate: EnsembleCertificate,
) -> None:
    """Write the certificate of an ensemble as a page, with slices of real parts and of members.

    Parts of the members' shape are cut from the first exemplar that is large enough.
    """
    real: list[Image] = []
    shape = members[0].shape
    for exemplar in exemplars:
        boxes = spread_boxes(exemplar.shape, shape)
        if boxes and not real:
            chosen = choose_evenly(len(boxes), _DRAWN)
            real = [with_values(exemplar, exemplar.values[boxes[n]]) for n in chosen]
    places = choose_evenly(len(members), _DRAWN)
    drawn = {"Real parts of the members' size": real, "Members": [members[n] for n in places]}
    names = [
        [f"real {n}" for n in range(1, len(real) + 1)],
        [certificate.names[n] for n in places],
    ]
    pictures = [
        (title, png_bytes(montage(images, called)))
        for (title, images), called in zip(drawn.items(), names, strict=True)
        if images
    ]
    write_html(ensemble_page(certificate, pictures=pictures), Path(path))


def _in_memory(image: Image | Slabs) -> Image:
    if isinstance(image, Slabs):
        return image.centre([min(side, _SHOWN) for side in image.shape])
    return image


def png_bytes(picture: Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        files.write(picture, path)
        return path.read_bytes()

"""NIfTI through nibabel. Its axes are x, y, z; zooms are 32-bit, so our JSON in an extension keeps
the exact ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.guard import DEFLATE, NUMBERS, check_claim, check_dtype, report_damage
from trabecula.io.metadata import FileContent, decode, encode
from trabecula.io.units import canonical, has_length, to_metres

_RGB = np.dtype([("R", "u1"), ("G", "u1"), ("B", "u1")])
_UNITS = {"m": "meter", "mm": "mm", "um": "micron"}  # all that the header can say
_ORDERS: dict[str, Literal["little", "big"]] = {"<": "little", ">": "big"}
_COMMENT = 6  # code of an extension that holds text


def write(image: Image, path: Path) -> Path:
    """Write .nii or .nii.gz (see `trabecula.io.files.write`)."""
    import nibabel

    check_dtype(image.values.dtype, NUMBERS, form="NIfTI")
    values = np.ascontiguousarray(image.values)
    if image.kind == "colour":
        values = values.view(_RGB)[..., 0]
    unit = canonical(image.unit)
    factor = 1.0
    if has_length(unit) and unit not in _UNITS:
        factor, unit = to_metres(unit) / to_metres("um"), "um"
    zooms = [edge * factor for edge in reversed(image.spacing)]
    # NIfTI-1 counts voxels along an axis in 16 bits.
    form = nibabel.Nifti1Image if max(image.shape) < 2**15 else nibabel.Nifti2Image
    picture = form(values.T, np.diag([*zooms, *[1.0] * (4 - len(zooms))]), dtype=values.dtype)
    picture.header.set_zooms(zooms)
    picture.header.set_xyzt_units(_UNITS.get(unit, "unknown"))
    picture.header.extensions.append(
        nibabel.nifti1.Nifti1Extension(_COMMENT, encode(image).encode("ascii"))
    )
    with replacing(path) as temporary:
        picture.to_filename(temporary)
    return path


def read(path: Path) -> FileContent:
    """Read .nii or .nii.gz (see `trabecula.io.files.read`)."""
    import nibabel

    families = (nibabel.filebasedimages.ImageFileError, nibabel.spatialimages.HeaderDataError)
    with report_damage(path, "NIfTI", also=families), _quiet(nibabel.imageglobals.logger):
        size = path.stat().st_size
        _check_extensions(path, size * (1 if path.suffix.lower() == ".nii" else DEFLATE))
        picture: Any = nibabel.load(path)
        header, proxy = picture.header, picture.dataobj
        room = size - int(proxy.offset) if path.suffix.lower() == ".nii" else size * DEFLATE
        check_claim(path, picture.shape, header.get_data_dtype(), stored=room)
        values = np.asanyarray(proxy)  # scaled where the header says so
        while values.ndim > 3 and values.shape[-1] == 1:
            values = values[..., 0]
        values = values.T
        colour = values.dtype == _RGB
        if colour:
            values = np.ascontiguousarray(values)[..., None].view(np.uint8)
        zooms = tuple(
            abs(float(zoom)) for zoom in reversed(header.get_zooms()[: values.ndim - colour])
        )
        unit = header.get_xyzt_units()[0]
        return FileContent(
            values,
            colour=bool(colour),
            spacing=zooms if all(zooms) else None,
            unit=None if unit == "unknown" else unit,
            fields=_read_fields(header.extensions),
        )


def _check_extensions(path: Path, room: int) -> None:
    """Raise where an extension of the header claims more than the file can hold: nibabel would ask
    for it in one piece.
    """
    import nibabel

    with nibabel.openers.ImageOpener(str(path)) as file:
        start = file.read(544)
        form = nibabel.Nifti2Header if start[4:7] == b"n+2" else nibabel.Nifti1Header
        at = form.template_dtype.itemsize
        if len(start) < at + 4 or not start[at]:
            return
        header = form(start[:at], check=False)
        at += 4
        while at + 16 <= header["vox_offset"]:
            file.seek(at)
            claim = int.from_bytes(file.read(4), _ORDERS[header.endianness], signed=True)
            if not 8 <= claim <= room - at:
                raise ValueError(f"an extension of its header claims {claim} bytes")
            at += claim


@contextmanager
def _quiet(logger: Any) -> Iterator[None]:
    """Stop nibabel's notices of fields that it repairs while it reads."""
    was, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = was


def _read_fields(extensions: Any) -> dict[str, Any] | None:
    for extension in extensions:
        if extension.get_code() == _COMMENT:
            content = extension.get_content()
            fields = decode(content if isinstance(content, (str, bytes)) else None)
            if fields is not None:
                return fields
    return None

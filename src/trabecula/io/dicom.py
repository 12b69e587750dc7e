"""DICOM: a series of slices in a folder, or one file of one or many frames (extra `dicom`).

Slices are sorted along the normal of their plane, by Image Position (Patient) (0020,0032) and Image
Orientation (Patient) (0020,0037); where these are not there by their instance number. Values are
stored values by Rescale Slope and Intercept (0028,1053, 0028,1052): Hounsfield units of CT. DICOM
PS3.3, C.7.6.2.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.core.optional import need
from trabecula.core.progress import track
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent

_EVEN = 0.01
"""Share of the distance of slices by which one may differ."""


def recognises(path: Path) -> bool:
    """Return whether a file is DICOM by its mark, or a folder holds such files."""
    if path.is_dir():
        return any(_is_dicom(entry) for entry in sorted(path.iterdir())[:8])
    return _is_dicom(path)


def _is_dicom(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(132)[128:] == b"DICM"
    except OSError:
        return False


def read(path: Path, dataset: str | None = None) -> FileContent:
    """Read a series or a file (see `trabecula.io.files.read`).

    Parameters
    ----------
    path : Path
    dataset : str, optional
        Of a folder with several series: the number, description or unique identifier of one.
    """
    pydicom = need("pydicom", extra="dicom", purpose="reading DICOM")
    with report_damage(path, "DICOM"):
        if path.is_dir():
            return _read_series(pydicom, path, dataset)
        if dataset is not None:
            raise InputError(f"{path} is one file: a series is chosen in a folder of files")
        head = pydicom.dcmread(path)
        values = _rescale(_pixels(head, path), head)
        return FileContent(values, spacing=_spacing(head, values.ndim), unit="mm", origin="DICOM")


def _read_series(pydicom: Any, folder: Path, dataset: str | None) -> FileContent:
    heads = {
        path: pydicom.dcmread(path, stop_before_pixels=True)
        for path in sorted(folder.iterdir())
        if _is_dicom(path)
    }
    slices = {path: head for path, head in heads.items() if "Rows" in head}
    if not slices:
        raise FileError(f"the folder {folder} holds no DICOM images: name another one")
    paths = _choose_series(folder, slices, dataset)
    if len(paths) == 1:
        return read(paths[0])
    order, gap = _sort(folder, {path: slices[path] for path in paths})
    first = slices[order[0]]
    shape = (len(order), int(first.Rows), int(first.Columns))
    check_claim(folder, shape, np.dtype(np.int32))
    values: np.ndarray | None = None
    for z, path in enumerate(track(order, "reading slices", total=len(order))):
        with report_damage(path, "DICOM"):
            plane = _rescale(_pixels(pydicom.dcmread(path), path), slices[path])
        if plane.shape != shape[1:]:
            raise FileError(
                f"{path} is {plane.shape}, the first slice {shape[1:]}: all must be alike"
            )
        if values is None:
            values = np.empty(shape, plane.dtype)
        if not np.can_cast(plane.dtype, values.dtype):
            values = values.astype(np.result_type(plane.dtype, values.dtype))
        values[z] = plane
    assert values is not None
    inside = _spacing(first, 2)
    spacing = None if inside is None or gap is None else (gap, *inside)
    ignored = "" if spacing else "its slices do not state where they lie: give the spacing"
    return FileContent(values, spacing=spacing, unit="mm", origin="DICOM", ignored=ignored)


def _choose_series(folder: Path, slices: dict[Path, Any], dataset: str | None) -> list[Path]:
    """Return the files of one series."""
    series: dict[str, list[Path]] = {}
    for path, head in slices.items():
        series.setdefault(str(head.get("SeriesInstanceUID", "")), []).append(path)
    if dataset is None:
        if len(series) > 1:
            names = "; ".join(
                f"{_number(slices[paths[0]])}: {slices[paths[0]].get('SeriesDescription', '')} "
                f"({len(paths)} files)"
                for paths in series.values()
            )
            raise InputError(
                f"{folder} holds {len(series)} series: {names}; name one by its number (--dataset)"
            )
        return next(iter(series.values()))
    for uid, paths in series.items():
        head = slices[paths[0]]
        if dataset in (uid, _number(head), str(head.get("SeriesDescription", ""))):
            return paths
    known = ", ".join(_number(slices[paths[0]]) for paths in series.values())
    raise InputError(f"{folder} holds no series {dataset!r}: there are {known}")


def _number(head: Any) -> str:
    return str(head.get("SeriesNumber", "") or "0")


def _sort(folder: Path, slices: dict[Path, Any]) -> tuple[list[Path], float | None]:
    """Return the files in order, and the distance of neighbours in mm where it is stated.

    Raises
    ------
    FileError
        Two slices at one place, slices missing, or distances that differ.
    """
    places = {path: _place(head) for path, head in slices.items()}
    if any(place is None for place in places.values()):
        numbers = {path: int(head.get("InstanceNumber", 0) or 0) for path, head in slices.items()}
        order = sorted(slices, key=lambda path: (numbers[path], path.name))
        _check_numbers(folder, [numbers[path] for path in order])
        thick = slices[order[0]].get("SpacingBetweenSlices")
        return order, float(thick) if thick else None
    order = sorted(slices, key=lambda path: (places[path], path.name))
    at = np.array([places[path] for path in order], float)
    steps = np.diff(at)
    usual = float(np.median(steps))
    if steps.min() <= 1e-4 * max(usual, 1e-9):
        first = int(steps.argmin())
        raise FileError(
            f"{folder} holds two slices at {at[first]:g} mm ({order[first].name}, "
            f"{order[first + 1].name}): keep one series"
        )
    worst = int(np.abs(steps - usual).argmax())
    if abs(steps[worst] - usual) > _EVEN * usual:
        between = f"between {order[worst].name} and {order[worst + 1].name}"
        gaps = steps / usual
        if np.abs(gaps - np.rint(gaps)).max() < 0.1:
            count = int(np.rint(gaps - 1).sum())
            raise FileError(
                f"{folder} misses {count} slices of {len(order) + count}, the first gap {between}: "
                "copy the whole series"
            )
        raise FileError(
            f"the slices of {folder} are {steps.min():g} to {steps.max():g} mm apart ({between}): "
            "resample them evenly first"
        )
    return order, float((at[-1] - at[0]) / len(steps))


def _check_numbers(folder: Path, numbers: list[int]) -> None:
    """Raise where instance numbers have gaps."""
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    if missing and len(set(numbers)) == len(numbers):
        raise FileError(
            f"{folder} misses {len(missing)} slices of {len(numbers) + len(missing)}, the first is "
            f"number {missing[0]}: copy the whole series"
        )


def _place(head: Any) -> float | None:
    """Return where a slice lies along the normal of its plane, mm."""
    position, plane = head.get("ImagePositionPatient"), head.get("ImageOrientationPatient")
    if position is None or plane is None or len(position) != 3 or len(plane) != 6:
        return None
    along = np.array([float(word) for word in plane])
    return float(np.cross(along[:3], along[3:]) @ [float(word) for word in position])


def _pixels(head: Any, path: Path) -> np.ndarray:
    if int(head.get("SamplesPerPixel", 1)) != 1:
        raise InputError(f"{path} is in colour: a grey series is needed")
    values: np.ndarray = head.pixel_array
    return values


def _rescale(values: np.ndarray, head: Any) -> np.ndarray:
    """Return stored values by slope and intercept: whole numbers where both are whole."""
    slope = float(head.get("RescaleSlope", 1) or 1)
    intercept = float(head.get("RescaleIntercept", 0) or 0)
    if (slope, intercept) == (1, 0):
        return values
    if slope != int(slope) or intercept != int(intercept):
        return (values * slope + intercept).astype(np.float32)
    whole = values.astype(np.int32) * int(slope) + int(intercept)
    fits = whole.size and np.iinfo(np.int16).min <= whole.min() and whole.max() < 1 << 15
    return whole.astype(np.int16) if fits else whole


def _spacing(head: Any, ndim: int) -> tuple[float, ...] | None:
    """Return the edges of a pixel along y, x in mm; of a file of many frames along z too."""
    found = head.get("PixelSpacing") or head.get("ImagerPixelSpacing")
    between = head.get("SpacingBetweenSlices") or head.get("SliceThickness")
    shared = head.get("SharedFunctionalGroupsSequence")
    if found is None and shared and "PixelMeasuresSequence" in shared[0]:
        measures = shared[0].PixelMeasuresSequence[0]
        found = measures.get("PixelSpacing")
        between = measures.get("SpacingBetweenSlices") or measures.get("SliceThickness")
    if not found:
        return None
    inside = (float(found[0]), float(found[1]))
    if ndim == 2:
        return inside
    return (float(between), *inside) if between else None

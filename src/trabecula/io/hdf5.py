"""HDF5: one data set of a file, with the size of its voxels where a usual layout states it (extra
`hdf5`).

Without a name, the data set is the one that NeXus marks as default, that of a usual layout
(Data Exchange "exchange/data", NeXus "entry/data/data"), else the only volume in the file. Sizes:
the attribute `element_size_um` (ilastik, ImageJ), `voxel_size` or `spacing` of the data set or of a
group above (along z, y, x, with `unit` or `units`), and DREAM.3D's SPACING (along x, y, z).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.optional import need
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent
from trabecula.io.resolution import Calibration
from trabecula.io.units import canonical, check_unit

_USUAL = ("exchange/data", "entry/data/data", "entry1/tomo_entry/data/data", "t0/channel0", "data")
_SIZES = ("element_size_um", "voxel_size", "voxel_spacing", "spacing", "pixel_size")
_DREAM = "_SIMPL_GEOMETRY"


def read(path: Path, dataset: str | None = None) -> FileContent:
    """Read a data set (see `trabecula.io.files.read`).

    Parameters
    ----------
    path : Path
    dataset : str, optional
        Its place in the file: "exchange/data".
    """
    h5py = need("h5py", extra="hdf5", purpose="reading HDF5")
    with report_damage(path, "HDF5"), h5py.File(path, "r") as file:
        name = _choose(h5py, file, path, dataset)
        found = file[name]
        shape = _shape(found.shape, path, name)
        check_claim(path, shape, found.dtype)
        values = np.asarray(found[()]).reshape(shape)
        size = _calibration(h5py, file, found, len(shape))
    return FileContent(values, spacing=size.spacing, unit=size.unit, origin=size.origin)


def _shape(shape: tuple[int, ...], path: Path, name: str) -> tuple[int, ...]:
    """Return the sides along z, y, x without axes of length one beyond these."""
    sides = tuple(int(side) for side in shape)
    while len(sides) > 3 and 1 in (sides[0], sides[-1]):
        sides = sides[1:] if sides[0] == 1 else sides[:-1]
    if len(sides) not in (2, 3):
        raise InputError(f"{path}: {name} has the shape {shape}, two or three axes are needed")
    return sides


def _volumes(h5py: Any, file: Any) -> dict[str, tuple[int, ...]]:
    """Return the data sets of numbers with two or more axes that are no lists, by their places."""
    found: dict[str, tuple[int, ...]] = {}

    def visit(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "biuf":
            sides = [side for side in node.shape if side > 1]
            if len(sides) in (2, 3):
                found[name] = node.shape

    file.visititems(visit)
    return found


def _choose(h5py: Any, file: Any, path: Path, dataset: str | None) -> str:
    """Return the place of a data set."""
    known = _volumes(h5py, file)
    if dataset is not None:
        name = dataset.strip("/")
        check_name(name, known, name=f"data set of {path.name}")
        return name
    marked = _nexus_default(h5py, file)
    for name in ([marked] if marked else []) + list(_USUAL):
        if name in known:
            return name
    deep = [name for name, shape in known.items() if sum(side > 1 for side in shape) == 3]
    chosen = deep or list(known)
    if not chosen:
        raise InputError(f"{path} holds no data set of numbers with two or three axes")
    if len(chosen) > 1:
        words = ", ".join(f"{name} {'x'.join(map(str, known[name]))}" for name in chosen[:12])
        raise InputError(f"{path} holds several data sets: {words}; name one (--dataset)")
    return chosen[0]


def _nexus_default(h5py: Any, file: Any) -> str | None:
    """Return the place of the data set that NeXus marks: by `default` down to `signal`."""
    node = file
    for _ in range(8):
        step = _word(node.attrs.get("default"))
        if step is None or not isinstance(node, h5py.Group) or step not in node:
            break
        node = node[step]
    signal = _word(node.attrs.get("signal"))
    if signal is None or not isinstance(node, h5py.Group) or signal not in node:
        return None
    return str(node[signal].name).strip("/")


def _word(value: Any) -> str | None:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else None


def _calibration(h5py: Any, file: Any, found: Any, ndim: int) -> Calibration:
    """Return the spacing that the file states along z, y, x."""
    node = found
    while True:
        for name in _SIZES:
            if name in node.attrs:
                return _of_attribute(node, name, ndim)
        if isinstance(node, h5py.Group) and _DREAM in node:
            spacing = np.asarray(node[_DREAM]["SPACING"][()], float).ravel()[::-1]
            return _as_calibration(spacing, None, f"{_DREAM}/SPACING", ndim)
        if node.name == "/":
            return Calibration()
        node = node.parent


def _of_attribute(node: Any, name: str, ndim: int) -> Calibration:
    unit = "um" if name.endswith("_um") else None
    for key in ("unit", "units", f"{name}_unit", f"{name}_units"):
        unit = unit or _word(node.attrs.get(key))
    values = np.asarray(node.attrs[name], float).ravel()
    return _as_calibration(values, unit, f"the attribute {name}", ndim)


def _as_calibration(values: np.ndarray, unit: str | None, origin: str, ndim: int) -> Calibration:
    edges = np.repeat(values, ndim) if len(values) == 1 else values[-ndim:]
    if len(edges) != ndim or not np.isfinite(edges).all() or edges.min() <= 0:
        return Calibration(ignored=f"{origin} is {values}, no size of voxels")
    if unit is not None:
        unit = canonical(unit)
        check_unit(unit)
    return Calibration(tuple(float(edge) for edge in edges), unit, origin)

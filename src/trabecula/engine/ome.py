"""OME-Zarr 0.5 metadata: axes, their unit, size and position of the voxels at every level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def ome_attribute(
    axes: Sequence[str], scale: Sequence[float], unit: str | None, name: str, levels: int
) -> dict[str, Any]:
    """Return the attribute "ome" of a store of `levels` arrays, each of half the voxels of the one
    before.
    """
    length = {} if unit is None else {"unit": unit}
    named = [
        {"name": axis, "type": "channel"}
        if axis == "c"
        else {"name": axis, "type": "space", **length}
        for axis in axes
    ]
    before = len(axes) - len(scale)
    datasets = []
    for level in range(levels):
        factors = [1.0] * before + [edge * 2.0**level for edge in scale]
        moves: list[dict[str, Any]] = [{"type": "scale", "scale": factors}]
        # OME places the centre of the first voxel, which lies farther in than the finest level's
        if level:
            shift = [0.0] * before + [edge * (2.0**level - 1) / 2 for edge in scale]
            moves.append({"type": "translation", "translation": shift})
        datasets.append({"path": str(level), "coordinateTransformations": moves})
    return {"version": "0.5", "multiscales": [{"name": name, "axes": named, "datasets": datasets}]}


def datasets(ome: Any) -> list[dict[str, Any]] | None:
    """Return the levels of a multiscale image, the finest first; None where the metadata are of no
    such image.

    Raises
    ------
    ValueError
        Metadata of another form than OME-Zarr's.
    """
    if "multiscales" not in _as(ome, dict):
        return None
    levels = _as(_first(ome["multiscales"])["datasets"], list)
    for level in levels:
        _as(_as(level, dict)["path"], str)
    return levels


def calibration(ome: Any, level: int) -> tuple[tuple[float, ...], str | None]:
    """Return the edges of the voxels of a level, and their unit.

    Raises
    ------
    ValueError
        An edge that is not above 0; metadata of another form than OME-Zarr's.
    """
    axes = [_as(axis, dict) for axis in _as(_first(ome["multiscales"])["axes"], list)]
    space = [index for index, axis in enumerate(axes) if axis["type"] == "space"]
    move = _first((datasets(ome) or [])[level]["coordinateTransformations"])
    factors = [_as(factor, (int, float)) for factor in _as(move["scale"], list)]
    scale = tuple(float(factors[index]) for index in space)
    if not all(math.isfinite(edge) and edge > 0 for edge in scale):
        raise ValueError(f"its scale {scale} is not positive")
    return scale, axes[space[0]].get("unit")


def _as(value: Any, kind: type | tuple[type, ...]) -> Any:
    """Return a part of somebody's JSON, or raise a ValueError where it is not of the type that the
    format says.
    """
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"its OME metadata hold {value!r:.40} in a wrong place")
    return value


def _first(value: Any) -> Any:
    """Return the first item of a list in somebody's JSON."""
    return _as(_as(value, list)[0], dict)

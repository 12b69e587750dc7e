"""OME-Zarr 0.5: what a store says of its axes, their unit, and the size and place of its voxels at every level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def described(axes: Sequence[str], scale: Sequence[float], unit: str | None, name: str, levels: int) -> dict[str, Any]:
    """The attribute "ome" of a store of `levels` arrays, each of half the voxels of the one before."""
    length = {} if unit is None else {"unit": unit}
    named = [
        {"name": axis, "type": "channel"} if axis == "c" else {"name": axis, "type": "space", **length} for axis in axes
    ]
    before = len(axes) - len(scale)
    datasets = []
    for level in range(levels):
        factors = [1.0] * before + [edge * 2.0**level for edge in scale]
        moves: list[dict[str, Any]] = [{"type": "scale", "scale": factors}]
        if level:  # OME places the centre of the first voxel, which lies farther in than the finest level's
            shift = [0.0] * before + [edge * (2.0**level - 1) / 2 for edge in scale]
            moves.append({"type": "translation", "translation": shift})
        datasets.append({"path": str(level), "coordinateTransformations": moves})
    return {"version": "0.5", "multiscales": [{"name": name, "axes": named, "datasets": datasets}]}


def calibration(ome: Any, level: int) -> tuple[tuple[float, ...], str | None]:
    """Edges of the voxels of a level, and their unit.

    Raises
    ------
    ValueError
        An edge that is not above 0.
    """
    multiscale = ome["multiscales"][0]
    space = [index for index, axis in enumerate(multiscale["axes"]) if axis["type"] == "space"]
    factors = multiscale["datasets"][level]["coordinateTransformations"][0]["scale"]
    scale = tuple(float(factors[index]) for index in space)
    if not all(math.isfinite(edge) and edge > 0 for edge in scale):
        raise ValueError(f"its scale {scale} is not positive")
    return scale, multiscale["axes"][space[0]].get("unit")

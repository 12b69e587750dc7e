"""Coarser copies of a volume for viewers: each level has half the resolution of the one before.

Level 0 is the volume itself. A voxel of the next level stands for the 2 x 2 x 2 below it (2 x 2 of
a picture), at an odd end for fewer: of labels for what most of them are, of greys and colours for
their mean.

The levels are described as OME-Zarr 0.5 does: axes, their unit, size and position of the voxels at
every level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

# that are halved at once, an even number: what is held besides is that of a few planes
_PLANES = 16


def shapes_of(shape: Sequence[int], smallest: int) -> list[tuple[int, ...]]:
    """Return the shapes of all levels, the volume's own first, down to one of at most `smallest`
    voxels along its longest axis.

    Examples
    --------
    >>> shapes_of((600, 90, 1), 256)
    [(600, 90, 1), (300, 45, 1), (150, 23, 1)]
    """
    found = [tuple(shape)]
    while max(found[-1]) > smallest:
        found.append(tuple((side + 1) // 2 for side in found[-1]))
    return found


def halve_resolution(values: np.ndarray, *, labels: bool, axes: int | None = None) -> np.ndarray:
    """Return the next level of an array.

    Parameters
    ----------
    values : (..., Z, Y, X) or (..., Y, X) array
    labels : bool
        Whether its values are names: 0..n-1, uint8. Of a tie the first voxel's wins where it is in
        it, else the lowest: so no phase is favoured by its number.
    axes : int, optional
        How many of the last axes are of space. Default: all.

    Returns
    -------
    array of the same type, of half the sides, rounded up

    Examples
    --------
    >>> halved(np.array([[0, 1, 1], [1, 1, 2]], np.uint8), labels=True)
    array([[1, 1]], dtype=uint8)
    >>> halved(np.array([[0.0, 1.0], [2.0, 5.0]]), labels=False)
    array([[2.]])
    """
    if axes is not None and values.ndim > axes:
        return np.stack([halve_resolution(channel, labels=labels, axes=axes) for channel in values])
    one = _most if labels else _mean
    return np.concatenate(
        [
            one(_pad_to_even(values[first : first + _PLANES]))
            for first in range(0, len(values), _PLANES)
        ]
    )


def _pad_to_even(values: np.ndarray) -> np.ndarray:
    """Repeat the last plane of an odd axis, which changes neither the majority nor the mean of its
    pairs.
    """
    if not any(side % 2 for side in values.shape):
        return values
    return np.pad(values, [(0, side % 2) for side in values.shape], mode="edge")


def _sums(values: np.ndarray) -> np.ndarray:
    """Return the sums of 2 x 2 x 2 voxels, the first axis first: its planes are added as they are
    stored.
    """
    for axis in range(values.ndim):
        pairs = np.moveaxis(values, axis, 0)
        values = np.moveaxis(pairs[::2] + pairs[1::2], 0, axis)
    return values


def _most(values: np.ndarray) -> np.ndarray:
    first = values[(slice(None, None, 2),) * values.ndim]
    result, most = np.zeros_like(first), np.zeros(first.shape, np.uint8)
    of_first = np.zeros_like(most)
    for label in range(int(values.max()) + 1):
        count = _sums((values == label).view(np.uint8))
        better = count > most
        result[better] = label
        np.maximum(most, count, out=most)
        np.copyto(of_first, count, where=first == label)
    np.copyto(result, first, where=of_first == most)
    return result


def _mean(values: np.ndarray) -> np.ndarray:
    count = 2**values.ndim
    if values.dtype.kind == "f":
        return (_sums(values.astype(np.float64)) / count).astype(values.dtype)
    # The nearest whole number, upwards from a half.
    return ((_sums(values.astype(np.int64)) + count // 2) // count).astype(values.dtype)


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


def datasets_of(ome: Any) -> list[dict[str, Any]] | None:
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
    move = _first((datasets_of(ome) or [])[level]["coordinateTransformations"])
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

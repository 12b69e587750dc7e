"""Cuts of a picture: a corner, halves along axes, one side of a free plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError

WORDS = ("corner", "none", "x", "y", "z", "plane")


@dataclass(frozen=True, eq=False)
class Cut:
    """Box and plane of a cut, for `rays`.

    Parameters
    ----------
    box : (4, 3) float
        Lower and upper corner of the part that is kept, then of the part that is taken out of it;
        (x, y, z) in voxels.
    plane : (4,) float
        Normal (x, y, z) in true space and offset in smallest voxel edges: all beyond is cut away.
    """

    box: np.ndarray
    plane: np.ndarray


def parse_cut(cut: str | Sequence[str]) -> tuple[str, ...]:
    """Check the words of a cut; see `make_cut`."""
    words = (cut,) if isinstance(cut, str) else tuple(cut)
    names = [str(word).partition("=")[0] for word in words]
    for name in names:
        check_name(name, WORDS, name="cut")
    if not words or len(set(names)) < len(names) or ("none" in names and len(names) > 1):
        raise InputError(
            f"cut {' '.join(words) or '()'}: give none alone, or each of corner, x, y, z and plane "
            "once"
        )
    for word in words:
        _numbers(word)
    return words


def make_cut(
    words: Sequence[str], shape: Sequence[int], edges: np.ndarray, viewer: np.ndarray
) -> Cut:
    """Make the cut of a volume.

    Parameters
    ----------
    words : sequence of str
        "none"; "corner": the octant that faces the viewer; "x=0.5" (y, z): what faces the viewer
        beyond that share of the axis; "plane=AZ,EL,0.5": what lies beyond that share of the box
        along the direction of azimuth AZ and elevation EL (degrees, as of a camera).
    shape : (X, Y, Z)
    edges : (3,) float
        Of a voxel along x, y, z.
    viewer : (3,) float
        Direction towards the viewer.
    """
    sides, towards = np.array(shape, float), viewer >= -1e-9
    box, plane = np.array([0 * sides, sides, 0 * sides, 0 * sides]), np.array([0.0, 0.0, 0.0, 1.0])
    for word in words:
        name, numbers = word.partition("=")[0], _numbers(word)
        if name == "corner" and sides.min() >= 2:
            middle = sides // 2
            box[2:] = np.where(towards, middle, -1.0), np.where(towards, sides + 1, middle)
        elif name in ("x", "y", "z"):
            axis = "xyz".index(name)
            at = (numbers[0] if numbers else 0.5) * sides[axis]
            box[1 if towards[axis] else 0, axis] = at
        elif name == "plane":
            plane = _plane(numbers, sides * edges / edges.min())
    return Cut(box, plane)


def _plane(numbers: Sequence[float], extent: np.ndarray) -> np.ndarray:
    azimuth, elevation, at = (*numbers, 0.5)[:3]
    normal = viewer_direction(azimuth, elevation)
    return np.array([*normal, normal @ extent / 2 + (at - 0.5) * (np.abs(normal) @ extent)])


def viewer_direction(azimuth: float, elevation: float) -> np.ndarray:
    """Return the (3,) unit vector (x, y, z) to a viewer at that azimuth and elevation, degrees."""
    turn, lift = math.radians(azimuth), math.radians(elevation)
    return np.array(
        [math.sin(turn) * math.cos(lift), -math.cos(turn) * math.cos(lift), math.sin(lift)]
    )


def _numbers(word: str) -> list[float]:
    name, sign, text = word.partition("=")
    try:
        numbers = [float(part) for part in text.split(",")] if sign else []
    except ValueError:
        numbers = [math.nan]
    most = {"x": 1, "y": 1, "z": 1, "plane": 3}.get(name, 0)
    least = 2 if name == "plane" else 0
    at = numbers[0] if name in "xyz" and numbers else numbers[2] if len(numbers) == 3 else 0.5
    if not (least <= len(numbers) <= most and all(map(math.isfinite, numbers)) and 0 <= at <= 1):
        raise InputError(
            f"cut {word!r}: write corner, none, x=0.5 (a share 0..1 of the axis; y, z) or "
            "plane=AZ,EL,0.5 (degrees, share)"
        )
    return numbers

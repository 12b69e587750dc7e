"""The camera of a still: orthographic, so that one scale bar holds for the whole picture."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.view.cut import direction


@dataclass(frozen=True, eq=False)
class Camera:
    """Where the rays start and go, in true lengths; x to the right, y away from the viewer, z up at
    azimuth 0.

    Parameters
    ----------
    right, up, viewer : (3,) float
        Unit vectors (x, y, z).
    corner : (3,) float
        Middle of the upper left pixel.
    pixel : float
        Edge of a pixel.
    """

    right: np.ndarray
    up: np.ndarray
    viewer: np.ndarray
    corner: np.ndarray
    pixel: float

    def in_voxels(self, edges: np.ndarray) -> np.ndarray:
        """(4, 3): corner, step right and step down in voxels, direction in voxels per smallest edge
        of a voxel.
        """
        steps = np.stack(
            [
                self.corner,
                self.right * self.pixel,
                -self.up * self.pixel,
                -self.viewer * edges.min(),
            ]
        )
        return steps / edges


def as_angles(camera: tuple[float, float]) -> tuple[float, float]:
    """Azimuth and elevation in degrees, checked."""
    try:
        azimuth, elevation = (float(angle) for angle in camera)
    except (TypeError, ValueError):
        raise InputError(f"camera {camera!r} should be (azimuth, elevation) in degrees") from None
    if not math.isfinite(azimuth) or not -90 <= elevation <= 90:
        raise InputError(
            f"camera {(azimuth, elevation)}: the elevation runs from -90 to 90 degrees, both are finite"
        )
    return azimuth, elevation


def place(
    angles: tuple[float, float],
    extent: np.ndarray,
    size: tuple[int, int],
    *,
    margin: int,
    foot: int,
    pixel: float | None = None,
) -> Camera:
    """A camera that sees the whole box.

    Parameters
    ----------
    angles : (azimuth, elevation) in degrees
        Azimuth turns the viewer to the right around z, elevation lifts him.
    extent : (3,) float
        Edges of the box along x, y, z.
    size : (width, height) in pixels
    margin, foot : int
        Pixels left free all round, and more at the foot for the scale bar.
    pixel : float, optional
        Edge of a pixel. Default: such that the box fills what is free.
    """
    azimuth = math.radians(angles[0])
    right, viewer = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), direction(*angles)
    up = np.cross(viewer, right)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * extent
    width, height = np.ptp(corners @ right), np.ptp(corners @ up)
    if pixel is None:
        pixel = max(
            width / max(size[0] - 2 * margin, 1), height / max(size[1] - 2 * margin - foot, 1)
        )
    far = extent / 2 + viewer * np.linalg.norm(extent)
    across, down = (size[0] - 1) / 2 * pixel, (size[1] - foot - 1) / 2 * pixel
    return Camera(right, up, viewer, far - right * across + up * down, pixel)

"""The camera of a traced still: turned upright, framed on what is seen of the material."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.view.scene import UPRIGHT, Cut, viewer_direction
from trabecula.view.trace.space import BLOCK

MARGIN = 0.09
"""Share of the picture left free on every side."""


@dataclass(frozen=True, eq=False)
class Framing:
    """Where the camera stands.

    Attributes
    ----------
    lens : (6, 3) float
        As `paths.trace` takes it.
    right, above, viewer : (3,) float
        Axes of the camera.
    up : (3,) float
    ground : float
        Height of the lowest material along `up`.
    middle : (3,) float
        Of what is seen.
    extent : float
        Longest edge of the box around the material, cut or not.
    pixel : float
        Edge of a pixel at the middle, smallest edges of a voxel.
    """

    lens: np.ndarray
    right: np.ndarray
    above: np.ndarray
    viewer: np.ndarray
    up: np.ndarray
    ground: float
    middle: np.ndarray
    extent: float
    pixel: float


def kept_blocks(skip: np.ndarray, stretch: np.ndarray, cut: Cut) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles of the blocks with material, (N, 3), smallest edges: all, and those that
    the cut leaves.
    """
    places = np.argwhere(skip == 0)[:, ::-1]
    points = (places + 0.5) * BLOCK * stretch
    box = cut.box * stretch
    kept = ((points > box[0]) & (points < box[1])).all(axis=1)
    kept &= ~((points > box[2]) & (points < box[3])).all(axis=1)
    kept &= points @ cut.plane[:3] <= cut.plane[3]
    return points, points[kept]


def axes(angles: tuple[float, float], up: str) -> np.ndarray:
    """Return (4, 3): right, above and viewer of a camera, and up, in the volume."""
    turn = math.radians(angles[0])
    viewer = viewer_direction(*angles)
    right = np.array([math.cos(turn), math.sin(turn), 0.0])
    frame = np.stack([right, np.cross(viewer, right), viewer, np.array([0.0, 0, 1])])
    return frame @ UPRIGHT[up]


def frame_camera(
    points: np.ndarray,
    kept: np.ndarray,
    angles: tuple[float, float],
    up: str,
    size: tuple[int, int],
    *,
    lens: float,
    aperture: float,
    focus: float,
) -> Framing:
    """Place the camera so that the kept material fills the picture.

    Parameters
    ----------
    points, kept : (N, 3), (M, 3) float
        From `kept_blocks`.
    angles : (azimuth, elevation) in degrees
    up : one of UPRIGHT
    size : (width, height) in pixels
    lens : float
        Angle of view of the longer side, degrees; 0: parallel rays.
    aperture : float
        Diameter of the lens, a share of the longest edge.
    focus : float
        Where it is sharp: 0 at the nearest material, 1 at the farthest.
    """
    right, above, viewer, upwards = axes(angles, up)
    extent = float(np.ptp(points, axis=0).max()) + BLOCK
    centre = (kept.min(axis=0) + kept.max(axis=0)) / 2
    slope = math.tan(math.radians(lens) / 2) if lens > 0 else 1e-3
    room = np.array(size) * (1 - 2 * MARGIN) / max(size) * slope
    pad = BLOCK / 2
    seen = np.stack([(kept - centre) @ axis for axis in (right, above, viewer)], axis=1)
    shift, distance = np.zeros(2), 0.0
    for _ in range(8):
        across = np.abs(seen[:, :2] - shift) + pad
        distance = float((seen[:, 2] + pad + (across / room).max(axis=1)).max())
        ends = (seen[:, :2] - shift) / (distance - seen[:, 2])[:, None]
        shift = shift + (ends.min(axis=0) + ends.max(axis=0)) / 2 * distance
    middle = centre + shift[0] * right + shift[1] * above
    eye = middle + distance * viewer
    step = 2 * slope / max(size)
    corner = -viewer - right * step * (size[0] - 1) / 2 + above * step * (size[1] - 1) / 2
    near, far = distance - seen[:, 2].max(), distance - seen[:, 2].min()
    sharp = near + focus * (far - near)
    given = np.zeros((6, 3))
    if lens > 0:
        given[0], given[1], given[2], given[3] = eye, right * step, -above * step, corner
    else:
        pixel = step * distance
        start = middle + viewer * (2 * extent + 10)
        start = start - right * pixel * (size[0] - 1) / 2 + above * pixel * (size[1] - 1) / 2
        given[1], given[2], given[3] = right * pixel, -above * pixel, start
    given[4] = aperture / 2 * extent, sharp, float(lens <= 0)
    given[5] = -viewer
    heights = kept @ upwards
    ground = float(heights.min()) - pad
    return Framing(given, right, above, viewer, upwards, ground, middle, extent, step * distance)

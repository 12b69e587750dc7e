"""The scene of a still: the image, prepared and cut, in its look; the camera that turns around it;
and the light that reaches each pixel.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_shape, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.memory import Plan, check_budget
from trabecula.engine.parallel import for_slabs
from trabecula.view import cut as cuts
from trabecula.view import kernels
from trabecula.view.looks import (
    AMBIENCE,
    FILL,
    LAMP,
    LAMP_STRENGTH,
    Look,
    all_round,
    find_look,
    phase_colours,
    to_linear,
    to_srgb,
)
from trabecula.view.picture import ink_on
from trabecula.view.scale import bar_height, draw_bar
from trabecula.view.volume import Volume, prepare_volume, visible_phases

SAMPLING = 2
"""Rays along each edge of a pixel."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Start and direction of the rays, in true lengths; x to the right, y away from the viewer, z
    up at azimuth 0. Orthographic, so that one scale bar holds for the whole picture.

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
        """Return (4, 3): corner, step right and step down in voxels, direction in voxels per
        smallest edge of a voxel.
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
    """Check azimuth and elevation, degrees."""
    try:
        azimuth, elevation = (float(angle) for angle in camera)
    except (TypeError, ValueError):
        raise InputError(
            f"camera {quote(camera)} should be (azimuth, elevation) in degrees"
        ) from None
    if not math.isfinite(azimuth) or not -90 <= elevation <= 90:
        raise InputError(
            f"camera {(azimuth, elevation)}: the elevation runs from -90 to 90 degrees, both are "
            "finite"
        )
    return azimuth, elevation


def place_camera(
    angles: tuple[float, float],
    extent: np.ndarray,
    size: tuple[int, int],
    *,
    margin: int,
    foot: int,
    pixel: float | None = None,
) -> Camera:
    """Place a camera so that it sees the whole box.

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
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    viewer = cuts.viewer_direction(*angles)
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


@dataclass(frozen=True, eq=False)
class Scene:
    """A volume, its cut and its look, which stay the same while the camera turns."""

    image: Image
    volume: Volume
    cut: cuts.Cut
    look: Look
    size: tuple[int, int]

    @property
    def margin(self) -> int:
        """Return the pixels left free all round."""
        return max(8, min(self.size) // 24)

    @property
    def edges(self) -> np.ndarray:
        """Return the edges of a voxel along x, y, z."""
        return np.array(self.image.spacing[::-1])

    def camera(self, angles: tuple[float, float], pixel: float | None = None) -> Camera:
        """Return a camera that sees the whole box, or its middle with pixels of that edge."""
        extent, foot = self.edges * self.image.shape[::-1], bar_height(_letters(self.size[1]))
        return place_camera(angles, extent, self.size, margin=self.margin, foot=foot, pixel=pixel)

    def picture(
        self, angles: tuple[float, float], pixel: float | None = None
    ) -> tuple[np.ndarray, float]:
        """Return (H, W, 3) uint8 with its scale bar, and the edge of a pixel."""
        view = self.camera(angles, pixel)
        light = to_srgb(self.light(view))
        return _with_bar(light, view.pixel, self.image.unit, self.look, self.margin), view.pixel

    def light(self, view: Camera) -> np.ndarray:
        """Compute the linear light, (H, W, 3)."""
        lamp = np.array(LAMP) @ np.stack([view.right, view.up, view.viewer])
        lamp /= np.linalg.norm(lamp)
        half = lamp + view.viewer
        lights = np.stack(
            [lamp, view.viewer, half / np.linalg.norm(half), to_linear(self.look.shade)]
        )
        light = np.zeros((self.size[1], self.size[0], 3))
        stretch = self.edges / self.edges.min()
        strength = np.array([LAMP_STRENGTH, AMBIENCE, FILL])
        palette = _palette(self.image, self.look)
        finishes = np.array([self.look.finish] * len(self.image.phases))
        rays = (view.in_voxels(self.edges), stretch, self.cut.box, self.cut.plane, all_round())
        given = (*self.volume, *rays, lights, strength, palette, finishes, SAMPLING)
        for_slabs(lambda first, last: kernels.march(*given, first, last, light), len(light))
        return light


def prepare_scene(
    image: Image | ArrayLike,
    look: str,
    phase: str | int | Sequence[str | int] | None,
    camera: tuple[float, float],
    cut: str | Sequence[str],
    size: tuple[int, int],
    threshold: float | None,
) -> tuple[Scene, tuple[float, float]]:
    """Check everything, then prepare the volume; the scene, and the angles of the camera."""
    drawable = _as_drawable(image, threshold)
    chosen, words = find_look(look), cuts.parse_cut(cut)
    width, height = _as_size(size)
    angles = as_angles(camera)
    check_budget(
        forecast(drawable.shape, (width, height)),
        advice="render a crop, or a coarser level of a .zarr",
    )
    edges, viewer = np.array(drawable.spacing[::-1]), cuts.viewer_direction(*angles)
    opened = cuts.make_cut(words, drawable.shape[::-1], edges, viewer)
    volume = prepare_volume(drawable.values, visible_phases(drawable, phase))
    return Scene(drawable, volume, opened, chosen, (width, height)), angles


def forecast(shape: Sequence[int], size: tuple[int, int]) -> Plan:
    """Forecast the memory of a still of `size` pixels of a volume in memory."""
    return Plan({"fields": 8 * prod(shape), "picture": 24 * prod(size)})


def _as_drawable(image: Image | ArrayLike, threshold: float | None) -> Image:
    image = as_image(image)
    if image.ndim != 3:
        raise InputError(
            f"a still needs a volume, the image has shape {image.shape}: show it with slices()"
        )
    if image.kind == "colour":
        raise InputError(
            "a still needs labels or grey, the image is colour: show it with slices() or view()"
        )
    if image.kind == "grey":
        if threshold is None:
            raise InputError(
                "a still of a grey image needs a threshold=...: give one, or segment it first "
                "(tb.segment)"
            )
        return Image(
            image.values >= threshold, "labels", image.spacing, image.unit, recipe=image.recipe
        )
    if threshold is not None:
        raise InputError(
            "threshold is for grey images, this one holds labels: choose with phase=..."
        )
    return image


def _as_size(size: tuple[int, int]) -> tuple[int, int]:
    width, height = as_shape(size, ndim=2, name="size")
    if not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise InputError(f"size {(width, height)} is outside 16..8192 pixels")
    return width, height


def _palette(image: Image, look: Look) -> np.ndarray:
    """Return linear colours: the background, the dye of cut faces, none, then every phase."""
    fixed = to_linear([look.background, look.cut, (255, 255, 255)])
    return np.concatenate([fixed, to_linear(phase_colours(image, look))])


def _letters(height: int) -> int:
    """Return the height of letters that suits a picture."""
    return max(12, height // 32)


def _with_bar(values: np.ndarray, pixel: float, unit: str, look: Look, margin: int) -> np.ndarray:
    from PIL import Image as Pillow
    from PIL import ImageDraw

    picture = Pillow.fromarray(values)
    height, width = values.shape[:2]
    draw_bar(
        ImageDraw.Draw(picture),
        margin,
        height - margin,
        pixel=pixel,
        unit=unit,
        room=width / 4,
        ink=ink_on(look.background),
        size=_letters(height),
    )
    return np.asarray(picture)

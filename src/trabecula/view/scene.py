"""What a still needs while the camera turns: the image, prepared and cut, in its look; and the
light that comes of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.memory import Plan, check_budget
from trabecula.engine.parallel import for_slabs
from trabecula.view import cut as cuts
from trabecula.view import kernels
from trabecula.view.camera import Camera, as_angles, place
from trabecula.view.looks import (
    AMBIENCE,
    FILL,
    LAMP,
    LAMP_STRENGTH,
    Look,
    all_round,
    look_named,
    phase_colours,
    to_linear,
    to_srgb,
)
from trabecula.view.picture import ink_on
from trabecula.view.scale import bar_height, draw_bar
from trabecula.view.volume import Volume, drawn_phases, prepare

SAMPLING = 2
"""Rays along each edge of a pixel."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What stays the same while the camera turns."""

    image: Image
    volume: Volume
    cut: cuts.Cut
    look: Look
    size: tuple[int, int]

    @property
    def margin(self) -> int:
        """Pixels left free all round."""
        return max(8, min(self.size) // 24)

    @property
    def edges(self) -> np.ndarray:
        """Of a voxel, along x, y, z."""
        return np.array(self.image.spacing[::-1])

    def camera(self, angles: tuple[float, float], pixel: float | None = None) -> Camera:
        """A camera that sees the whole box, or the middle of it with pixels of that edge."""
        extent, foot = self.edges * self.image.shape[::-1], bar_height(_letters(self.size[1]))
        return place(angles, extent, self.size, margin=self.margin, foot=foot, pixel=pixel)

    def picture(
        self, angles: tuple[float, float], pixel: float | None = None
    ) -> tuple[np.ndarray, float]:
        """(H, W, 3) uint8 with its scale bar, and the edge of a pixel."""
        view = self.camera(angles, pixel)
        return _with_bar(
            to_srgb(self.light(view)), view.pixel, self.image.unit, self.look, self.margin
        ), view.pixel

    def light(self, view: Camera) -> np.ndarray:
        """Linear light, (H, W, 3)."""
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
        volume = self.volume
        scene = (
            volume.field,
            volume.labels,
            volume.occupied,
            volume.pyramid,
            volume.offsets,
            volume.shapes,
        )
        stage = (
            view.in_voxels(self.edges),
            stretch,
            self.cut.box,
            self.cut.plane,
            all_round(),
            lights,
            strength,
        )
        for_slabs(
            lambda first, last: kernels.march(
                *scene, *stage, palette, finishes, SAMPLING, first, last, light
            ),
            len(light),
        )
        return light


def scene_of(
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
    chosen, words = look_named(look), cuts.as_words(cut)
    width, height = _as_size(size)
    angles = as_angles(camera)
    check_budget(
        forecast(drawable.shape, (width, height)),
        advice="render a crop, or a coarser level of a .zarr",
    )
    made = cuts.make(
        words, drawable.shape[::-1], np.array(drawable.spacing[::-1]), cuts.direction(*angles)
    )
    volume = prepare(drawable.values, drawn_phases(drawable, phase))
    return Scene(drawable, volume, made, chosen, (width, height)), angles


def forecast(shape: Sequence[int], size: tuple[int, int]) -> Plan:
    """What a still of `size` pixels of a volume in memory takes."""
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
                "a still of a grey image needs a threshold=...: give one, or segment it first (tb.segment)"
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
    """Linear colours: the background, the dye of cut faces, none, then every phase."""
    fixed = to_linear([look.background, look.cut, (255, 255, 255)])
    return np.concatenate([fixed, to_linear(phase_colours(image, look))])


def _letters(height: int) -> int:
    """Height of letters that suits a picture."""
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

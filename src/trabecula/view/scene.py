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

from trabecula.core.checks import as_shape, check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.memory import Plan, check_budget
from trabecula.engine.parallel import for_slabs
from trabecula.view import kernels
from trabecula.view.colouring import FieldColours, colour_by, draw_legend
from trabecula.view.colours import few_colours, form_of
from trabecula.view.looks import (
    AMBIENCE,
    FILL,
    LAMP,
    LAMP_STRENGTH,
    Look,
    all_round,
    phase_colours,
    to_linear,
    to_srgb,
)
from trabecula.view.picture import ink_on
from trabecula.view.scale import bar_height, draw_bar
from trabecula.view.volume import Volume, prepare_volume, visible_phases

SAMPLING = 2
"""Rays along each edge of a pixel."""

UPRIGHT = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]),
    "x": np.array([[0, 1.0, 0], [0, 0, 1.0], [1.0, 0, 0]]),
    "-z": np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]),
    "-x": np.array([[0, 1.0, 0], [0, 0, -1.0], [-1.0, 0, 0]]),
}
"""Axis of the volume that points up -> where the right of a camera at azimuth 0, the way it looks
and up point in the volume (x, y, z). Rotations: nothing is mirrored.
"""

CUTS = ("corner", "none", "x", "y", "z", "plane")
"""First words of the cuts: a corner, none, halves along axes, one side of a free plane."""


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
    if not isinstance(cut, str | Sequence):
        raise InputError(f"cut {quote(cut)}: give a word, or several in a list")
    words = (cut,) if isinstance(cut, str) else tuple(map(str, cut))
    names = [str(word).partition("=")[0] for word in words]
    for name in names:
        check_name(name, CUTS, name="cut")
    if not words or len(set(names)) < len(names) or ("none" in names and len(names) > 1):
        raise InputError(
            f"cut {' '.join(words) or '()'}: give none alone, or each of corner, x, y, z and plane "
            "once"
        )
    for word in words:
        _cut_numbers(word)
    return words


def make_cut(
    words: Sequence[str],
    shape: Sequence[int],
    edges: np.ndarray,
    viewer: np.ndarray,
    up: str = "z",
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
    up : one of UPRIGHT
        What azimuth and elevation refer to.
    """
    sides, towards = np.array(shape, float), viewer >= -1e-9
    box, plane = np.array([0 * sides, sides, 0 * sides, 0 * sides]), np.array([0.0, 0.0, 0.0, 1.0])
    for word in words:
        name, numbers = word.partition("=")[0], _cut_numbers(word)
        if name == "corner" and sides.min() >= 2:
            middle = sides // 2
            box[2:] = np.where(towards, middle, -1.0), np.where(towards, sides + 1, middle)
        elif name in ("x", "y", "z"):
            axis = "xyz".index(name)
            at = (numbers[0] if numbers else 0.5) * sides[axis]
            box[1 if towards[axis] else 0, axis] = at
        elif name == "plane":
            plane = _cut_plane(numbers, sides * edges / edges.min(), up)
    return Cut(box, plane)


def _cut_plane(numbers: Sequence[float], extent: np.ndarray, up: str) -> np.ndarray:
    azimuth, elevation, at = (*numbers, 0.5)[:3]
    normal = viewer_direction(azimuth, elevation, up)
    return np.array([*normal, normal @ extent / 2 + (at - 0.5) * (np.abs(normal) @ extent)])


def viewer_direction(azimuth: float, elevation: float, up: str = "z") -> np.ndarray:
    """Return the (3,) unit vector (x, y, z) to a viewer at that azimuth and elevation, degrees."""
    turn, lift = math.radians(azimuth), math.radians(elevation)
    viewer = np.array(
        [math.sin(turn) * math.cos(lift), -math.cos(turn) * math.cos(lift), math.sin(lift)]
    )
    return viewer if up == "z" else viewer @ UPRIGHT[up]


def _cut_numbers(word: str) -> list[float]:
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
    up: str = "z",
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
    up : one of UPRIGHT
    """
    azimuth = math.radians(angles[0])
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]) @ UPRIGHT[up]
    viewer = viewer_direction(*angles, up)
    above = np.cross(viewer, right)
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * extent
    width, height = np.ptp(corners @ right), np.ptp(corners @ above)
    if pixel is None:
        pixel = max(
            width / max(size[0] - 2 * margin, 1), height / max(size[1] - 2 * margin - foot, 1)
        )
    far = extent / 2 + viewer * np.linalg.norm(extent)
    across, down = (size[0] - 1) / 2 * pixel, (size[1] - foot - 1) / 2 * pixel
    return Camera(right, above, viewer, far - right * across + above * down, pixel)


@dataclass(frozen=True, eq=False)
class Scene:
    """A volume, its cut and its look, which stay the same while the camera turns."""

    image: Image
    volume: Volume
    cut: Cut
    look: Look
    size: tuple[int, int]
    colours: FieldColours | None = None
    up: str = "z"

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
        return place_camera(
            angles, extent, self.size, margin=self.margin, foot=foot, pixel=pixel, up=self.up
        )

    def picture(
        self, angles: tuple[float, float], pixel: float | None = None
    ) -> tuple[np.ndarray, float]:
        """Return (H, W, 3) uint8 with its scale bar, and the edge of a pixel."""
        view = self.camera(angles, pixel)
        light = to_srgb(self.light(view))
        bar = _with_bar(light, view.pixel, self.image.unit, self.look, self.margin, self.colours)
        return bar, view.pixel

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
        palette = _palette(self.image, self.look, self.colours)
        finishes = np.array([self.look.finish] * (len(palette) - 3))
        rays = (view.in_voxels(self.edges), stretch, self.cut.box, self.cut.plane, all_round())
        given = (*self.volume, *rays, lights, strength, palette, finishes, SAMPLING)
        for_slabs(lambda first, last: kernels.march(*given, first, last, light), len(light))
        return light


@dataclass(frozen=True, eq=False)
class Subject:
    """What is drawn, checked: the image, its labels, which of them are drawn, the cut; `colours`
    where a field or a colour volume gives them.
    """

    image: Image
    labels: np.ndarray
    drawn: Sequence[int]
    cut: Cut
    size: tuple[int, int]
    angles: tuple[float, float]
    up: str
    colours: FieldColours | None = None


def prepare_subject(
    image: Image | ArrayLike,
    phase: str | int | Sequence[str | int] | None,
    camera: tuple[float, float],
    cut: str | Sequence[str],
    size: tuple[int, int],
    threshold: float | None,
    field: Image | None = None,
    limits: Sequence[float] | None = None,
    form: Image | ArrayLike | None = None,
    up: str = "z",
) -> Subject:
    """Check everything that is drawn, and where it is seen from."""
    image = as_image(image)
    colour = image.kind == "colour" and image.ndim == 3
    if form is not None and not colour:
        raise InputError("form is of a colour volume: of labels choose with phase=...")
    drawable = image if colour else _as_drawable(image, threshold)
    if colour:
        for name, value in (("phase", phase), ("threshold", threshold), ("field", field)):
            if value is not None:
                raise InputError(f"{name} does not go with a colour volume, which has its own")
    words = parse_cut(cut)
    width, height = _as_size(size)
    angles = as_angles(camera)
    check_name(up, UPRIGHT, name="up")
    edges, viewer = np.array(drawable.spacing[::-1]), viewer_direction(*angles, up)
    opened = make_cut(words, drawable.shape[::-1], edges, viewer, up)
    if limits is not None and field is None:
        raise InputError("limits are of a field: give the field as well, or leave them out")
    colours = None
    if colour:
        labels, drawn = form_of(image, form), [1]
    else:
        labels, drawn = drawable.values, visible_phases(drawable, phase)
    if field is not None:
        colours = colour_by(drawable, drawn, field, limits)
        labels, drawn = colours.labels, list(range(1, len(colours.colours)))
    return Subject(drawable, labels, drawn, opened, (width, height), angles, up, colours)


def prepare_scene(
    image: Image | ArrayLike,
    look: Look,
    phase: str | int | Sequence[str | int] | None,
    camera: tuple[float, float],
    cut: str | Sequence[str],
    size: tuple[int, int],
    threshold: float | None,
    field: Image | None = None,
    limits: Sequence[float] | None = None,
    form: Image | ArrayLike | None = None,
    up: str = "z",
) -> tuple[Scene, tuple[float, float]]:
    """Check everything, then prepare the volume; the scene, and the angles of the camera."""
    it = prepare_subject(image, phase, camera, cut, size, threshold, field, limits, form, up)
    check_budget(
        forecast(it.image.shape, it.size),
        advice="render a crop, or a coarser level of a .zarr",
    )
    colours = few_colours(it.image, it.labels) if it.image.kind == "colour" else it.colours
    labels, drawn = it.labels, it.drawn
    if colours is not None:
        labels, drawn = colours.labels, list(range(1, len(colours.colours)))
    volume = prepare_volume(labels, drawn)
    return Scene(it.image, volume, it.cut, look, it.size, colours, it.up), it.angles


def forecast(shape: Sequence[int], size: tuple[int, int]) -> Plan:
    """Forecast the memory of a still of `size` pixels of a volume in memory."""
    return Plan({"fields": 8 * prod(shape), "picture": 24 * prod(size)})


def _as_drawable(image: Image | ArrayLike, threshold: float | None) -> Image:
    image = as_image(image)
    if image.ndim != 3:
        raise InputError(
            f"a still needs a volume, the image has shape {image.shape}: show it with slices()"
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


def _palette(image: Image, look: Look, colours: FieldColours | None = None) -> np.ndarray:
    """Return linear colours: the background, the dye of cut faces, none, then every phase, or every
    band of a field, whose colours no dye changes.
    """
    none = (255, 255, 255)
    if colours is not None:
        fixed = to_linear([look.background, none, none])
        return np.concatenate([fixed, to_linear(colours.colours)])
    fixed = to_linear([look.background, look.cut, none])
    return np.concatenate([fixed, to_linear(phase_colours(image, look))])


def draw_field_legend(values: np.ndarray, colours: FieldColours) -> np.ndarray:
    """Return a picture with the legend of a field in its lower right corner."""
    from PIL import Image as Pillow
    from PIL import ImageDraw

    picture = Pillow.fromarray(values)
    height, width = values.shape[:2]
    margin = max(8, min(width, height) // 24)
    corner = values[-margin:, -margin:].reshape(-1, 3).mean(axis=0).astype(int).tolist()
    canvas = ImageDraw.Draw(picture)
    ink = ink_on((corner[0], corner[1], corner[2]))
    at = (width - margin, height - margin)
    draw_legend(canvas, *at, colours, ink=ink, size=_letters(height))
    return np.asarray(picture)


def _letters(height: int) -> int:
    """Return the height of letters that suits a picture."""
    return max(12, height // 32)


def _with_bar(
    values: np.ndarray,
    pixel: float,
    unit: str,
    look: Look,
    margin: int,
    colours: FieldColours | None = None,
) -> np.ndarray:
    from PIL import Image as Pillow
    from PIL import ImageDraw

    picture = Pillow.fromarray(values)
    height, width = values.shape[:2]
    canvas = ImageDraw.Draw(picture)
    if colours is not None and colours.limits is not None:
        letters, ink = _letters(height), ink_on(look.background)
        draw_legend(canvas, width - margin, height - margin, colours, ink=ink, size=letters)
    draw_bar(
        canvas,
        margin,
        height - margin,
        pixel=pixel,
        unit=unit,
        room=width / 4,
        ink=ink_on(look.background),
        size=_letters(height),
    )
    return np.asarray(picture)

"""`render`: a still of a volume, by a ray marcher on the CPU.

1. The drawn phases' indicator, blurred by 0.7 voxel, is the field whose middle value is the surface.
2. A ray per sample, parallel to the others, steps through the box and skips empty blocks. Where it enters the solid
   through a face of the box or of the cut, the normal is that plane's; elsewhere it is the field's gradient.
3. A lamp from the upper left with soft shadows and light from all round, both by cones through a pyramid of densities:
   without random numbers, so without speckle.
4. A scale bar, exact since the view is orthographic.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_shape, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.plan import Plan, check_budget
from trabecula.engine.tiles import for_slabs
from trabecula.view import kernels
from trabecula.view.camera import Camera, as_angles, place
from trabecula.view.looks import Look, look_named, phase_colours, to_linear, to_srgb
from trabecula.view.picture import check_png, ink_on, kept
from trabecula.view.scale import bar_height, draw_bar
from trabecula.view.volume import Volume, drawn_phases, prepare

CUTS = ("corner", "none")
SAMPLING = 2

# Lamp to the upper left, before the material: (right, up, towards the viewer).
_LAMP = np.array([-0.26, 0.56, 0.78])
_LAMP_STRENGTH, _AMBIENCE, _FILL = 0.86, 0.36, 0.12


def render(
    image: Image | ArrayLike,
    path: str | PathLike[str] | None = None,
    *,
    look: str = "bone",
    size: tuple[int, int] = (800, 600),
    phase: str | int | Sequence[str | int] | None = None,
    camera: tuple[float, float] = (32.0, 26.0),
    cut: str = "corner",
    threshold: float | None = None,
) -> Image:
    """A still of a volume.

    Parameters
    ----------
    image : Image or array, (Z, Y, X)
        Labels; or grey together with `threshold`.
    path : path, optional
        Where to write it too, ending in .png.
    look : {"bone", "foam", "bread", "sponge", "stone"}
        Colours and gloss.
    size : (width, height)
        Pixels, 16..8192 each.
    phase : str, int or a sequence of them, optional
        What to draw. Default: every phase but the one named "void".
    camera : (azimuth, elevation)
        Degrees. At (0, 0) x runs to the right, z up, y away; azimuth carries the viewer to the right around z,
        elevation lifts him (-90..90).
    cut : {"corner", "none"}
        Take away the octant that faces the viewer, to see inside; or nothing.
    threshold : float, optional
        Of a grey image: what lies at or above it is drawn.

    Returns
    -------
    Image
        Colour, (height, width); its spacing is the edge of a pixel in the image's unit.

    Raises
    ------
    InputError
        Not a volume, colour, grey without threshold, unknown look, phase or cut, size or camera out of range.
    """
    check_png(path)
    image = _as_drawable(image, threshold)
    chosen = look_named(look)
    check_name(cut, CUTS, name="cut")
    width, height = _as_size(size)
    angles = as_angles(camera)
    check_budget(Plan({"fields": 8 * image.values.size, "picture": 24 * width * height}), advice="render a crop")
    margin = max(8, min(width, height) // 24)
    edges = np.array(image.spacing[::-1])
    view = place(angles, edges * image.shape[::-1], (width, height), margin=margin, foot=bar_height(_letters(height)))
    removed = _removed(image.shape[::-1], view.viewer, cut)
    volume = prepare(image.values, drawn_phases(image, phase), removed=removed)
    light = _shaded(volume, view, edges, removed, _palette(image, chosen), chosen, (height, width))
    values = _with_bar(to_srgb(light), view.pixel, image.unit, chosen, margin)
    made = {"look": look, "size": [width, height], "phase": phase, "camera": angles, "cut": cut, "threshold": threshold}
    recipe = image.recipe.then("render", values, **made)
    return kept(Image(values, "colour", (view.pixel, view.pixel), image.unit, recipe=recipe), path)


def _as_drawable(image: Image | ArrayLike, threshold: float | None) -> Image:
    image = as_image(image)
    if image.ndim != 3:
        raise InputError(f"a still needs a volume, the image has shape {image.shape}: show it with slices()")
    if image.kind == "colour":
        raise InputError("a still needs labels or grey, the image is colour: show it with slices()")
    if image.kind == "grey":
        if threshold is None:
            raise InputError(
                "a still of a grey image needs a threshold=...: give one, or segment it first (tb.segment)"
            )
        return Image(image.values >= threshold, "labels", image.spacing, image.unit, recipe=image.recipe)
    if threshold is not None:
        raise InputError("threshold is for grey images, this one holds labels: choose with phase=...")
    return image


def _as_size(size: tuple[int, int]) -> tuple[int, int]:
    width, height = as_shape(size, ndim=2, name="size")
    if not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise InputError(f"size {(width, height)} is outside 16..8192 pixels")
    return width, height


def _removed(shape: Sequence[int], viewer: np.ndarray, cut: str) -> np.ndarray:
    """(2, 3): corners, in voxels, of the octant towards the viewer; without a cut an empty one."""
    sides = np.array(shape)
    if cut == "none" or sides.min() < 2:
        return np.zeros((2, 3))
    middle = sides // 2
    towards = viewer >= -1e-9
    return np.array([np.where(towards, middle, 0), np.where(towards, sides, middle)], np.float64)


def _palette(image: Image, look: Look) -> np.ndarray:
    """Linear colours: the background, the dye of cut faces, then every phase."""
    return np.concatenate([to_linear([look.background, look.cut]), to_linear(phase_colours(image, look))])


def _directions() -> np.ndarray:
    """Fourteen directions all round: the faces and the corners of a cube."""
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    return np.concatenate([faces, corners])


def _shaded(
    volume: Volume,
    view: Camera,
    edges: np.ndarray,
    removed: np.ndarray,
    palette: np.ndarray,
    look: Look,
    shape: tuple[int, int],
) -> np.ndarray:
    """Linear light, (H, W, 3)."""
    lamp = _LAMP @ np.stack([view.right, view.up, view.viewer])
    lamp /= np.linalg.norm(lamp)
    half = lamp + view.viewer
    lights = np.stack([lamp, view.viewer, half / np.linalg.norm(half), to_linear(look.shade)])
    surface = np.array([_LAMP_STRENGTH, _AMBIENCE, _FILL, look.gloss, look.polish])
    light = np.zeros((*shape, 3))
    scene = (volume.field, volume.labels, volume.occupied, volume.pyramid, volume.offsets, volume.shapes)
    stage = (view.in_voxels(edges), edges / edges.min(), removed, _directions(), lights, palette, surface, SAMPLING)
    for_slabs(lambda first, last: kernels.march(*scene, *stage, first, last, light), shape[0])
    return light


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

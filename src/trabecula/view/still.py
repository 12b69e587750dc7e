"""`render` and `turntable`: stills of a volume, by a ray marcher on the CPU.

1. The drawn phases' indicator, blurred by 0.7 voxel, is the field whose middle value is the
   surface.
2. A ray per sample, parallel to the others, steps through the box and skips empty blocks. Where it
   enters the solid through a face of the box or of a cut, the normal is that plane's; elsewhere it
   is the field's gradient.
3. A lamp from the upper left with soft shadows, light that goes through thin walls, and light from
   all round, by cones through a pyramid of densities: without random numbers, so without speckle
   (see `shading`).
4. A scale bar, exact since the view is orthographic.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.view.picture import check_suffix, save_gif, save_picture
from trabecula.view.scene import prepare_scene


def render(
    image: Image | ArrayLike,
    path: str | PathLike[str] | None = None,
    *,
    look: str = "bone",
    size: tuple[int, int] = (800, 600),
    phase: str | int | Sequence[str | int] | None = None,
    camera: tuple[float, float] = (32.0, 26.0),
    cut: str | Sequence[str] = "corner",
    threshold: float | None = None,
    field: Image | None = None,
    limits: Sequence[float] | None = None,
) -> Image:
    """Render a still of a volume.

    Parameters
    ----------
    image : Image or array, (Z, Y, X)
        Labels; or grey together with `threshold`.
    path : path, optional
        Where to write it too, ending in .png.
    look : {"bone", "foam", "bread", "sponge", "stone"}
        Colours, roughness, gloss, and how light goes through.
    size : (width, height)
        Pixels, 16..8192 each.
    phase : str, int or a sequence of them, optional
        What to draw. Default: every phase but the one named "void".
    camera : (azimuth, elevation)
        Degrees. At (0, 0) x runs to the right, z up, y away; azimuth carries the viewer to the
        right around z, elevation lifts him (-90..90).
    cut : str or sequence of str
        What to take away, to see inside: "corner" (the octant that faces the viewer), "none",
        "x=0.5" (what faces the viewer beyond that share of the axis; "y", "z"), "plane=AZ,EL,0.5"
        (what lies beyond that share of the box in the direction of an azimuth and an elevation).
    threshold : float, optional
        Of a grey image: what lies at or above it is drawn.
    field : Image, optional
        Grey, of the image's shape: what is drawn takes its colours, and a legend names them (a
        stress by `tb.fields.import_result`, a thickness).
    limits : (low, high), optional
        Values of its first and last colour. Default: the 1st and 99th percentile of what is drawn.

    Returns
    -------
    Image
        Colour, (height, width); its spacing is the edge of a pixel in the image's unit.

    Raises
    ------
    InputError
        Not a volume, colour, grey without threshold, unknown look, phase or cut, size or camera out
        of range, a field of another shape.
    """
    check_suffix(path, ".png")
    scene, angles = prepare_scene(image, look, phase, camera, cut, size, threshold, field, limits)
    values, pixel = scene.picture(angles)
    made: dict[str, Any] = {
        "look": look,
        "size": list(scene.size),
        "phase": phase,
        "camera": angles,
        "threshold": threshold,
    }
    if field is not None and scene.colours is not None:
        made |= {"field": field.recipe.to_json(), "limits": list(scene.colours.limits)}
    recipe = scene.image.recipe.then(
        "render", values, cut=cut if isinstance(cut, str) else list(cut), **made
    )
    still = Image(values, "colour", (pixel, pixel), scene.image.unit, recipe=recipe)
    return save_picture(still, path)


def turntable(
    image: Image | ArrayLike,
    path: str | PathLike[str],
    *,
    frames: int = 36,
    seconds: float = 6.0,
    look: str = "bone",
    size: tuple[int, int] = (480, 360),
    phase: str | int | Sequence[str | int] | None = None,
    camera: tuple[float, float] = (32.0, 26.0),
    cut: str | Sequence[str] = "corner",
    threshold: float | None = None,
) -> Path:
    """Render a moving picture of a volume that turns once around z, the cut turning along.

    Parameters
    ----------
    image : Image or array, (Z, Y, X)
    path : path
        Where to write it, ending in .gif.
    frames : int
        Stills of a turn, 2..360.
    seconds : float
        That a turn takes, above 0 and at most 600.
    look, size, phase, camera, cut, threshold
        As of `render`; the camera is that of the first still.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        As of `render`, or frames or seconds out of range.
    """
    check_suffix(path, ".gif")
    if not (2 <= frames <= 360 and 0 < seconds <= 600):
        raise InputError(
            f"a turn of {frames} frames in {seconds} s: 2..360 frames and at most 600 s are needed"
        )
    scene, (azimuth, elevation) = prepare_scene(image, look, phase, camera, cut, size, threshold)
    turns = [(azimuth + 360 * k / frames, elevation) for k in range(frames)]
    pixel = max(scene.camera(angles).pixel for angles in turns)
    pictures = [
        scene.picture(angles, pixel)[0] for angles in track(turns, "turntable", total=frames)
    ]
    return save_gif(pictures, path, seconds=seconds / frames)

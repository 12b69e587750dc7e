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

With `quality` "draft" or "fine" the picture is path traced instead, in perspective and on a ground:
see `trace`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import track
from trabecula.engine.memory import check_budget
from trabecula.view.looks import to_linear, to_srgb
from trabecula.view.picture import check_suffix, save_gif, save_picture
from trabecula.view.scene import Subject, draw_field_legend, prepare_scene, prepare_subject
from trabecula.view.trace.material import TRACED, TracedLook, find_traced, plain_look, read_look
from trabecula.view.trace.photograph import SAMPLES, Exposure, forecast_traced, take

QUALITIES = ("quick", *SAMPLES)


def render(
    image: Image | ArrayLike,
    path: str | PathLike[str] | None = None,
    *,
    look: str | PathLike[str] | Mapping[str, Any] = "bone",
    size: tuple[int, int] = (800, 600),
    phase: str | int | Sequence[str | int] | None = None,
    camera: tuple[float, float] = (32.0, 26.0),
    cut: str | Sequence[str] = "corner",
    threshold: float | None = None,
    field: Image | None = None,
    limits: Sequence[float] | None = None,
    form: Image | ArrayLike | None = None,
    up: str = "z",
    quality: str = "quick",
    samples: int | None = None,
    lens: float = 22.0,
    aperture: float = 0.0,
    focus: float = 0.3,
    exposure: float = 0.0,
    ground: bool = True,
) -> Image:
    """Render a still of a volume.

    Parameters
    ----------
    image : Image or array, (Z, Y, X)
        Labels; grey together with `threshold`; or colour, whose voxels are the albedo.
    path : path, optional
        Where to write it too, ending in .png.
    look : str, path or mapping
        "bone", "foam", "bread", "sponge", "stone", and of materials first made for traced stills
        "cheese", "copper", "ceramic", "rock", "glass", "wax", "clay". A .toml file, or its content,
        changes the parameters of one of them (`base`): see docs/howto/look.md.
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
    form : Image of labels or bool array, (Z, Y, X), optional
        Of a colour volume: where it is material. Default: everywhere, but outside of the mask that
        it was made in.
    up : {"z", "y", "x", "-z", "-y", "-x"}
        Axis of the volume that points up; azimuth and elevation are about it.
    quality : {"quick", "draft", "fine"}
        "quick": a ray marcher, parallel rays, a scale bar. Else a path tracer: a smooth surface,
        framed on the material, in perspective, on a ground, without a bar (a perspective has no
        one scale); "draft" takes 4 paths a pixel, "fine" 16.
    samples : int, optional
        Paths a pixel instead, 2..65536. This and what follows is of traced stills alone.
    lens : float
        Angle of view of the longer side, degrees, 0 (parallel rays) .. 120.
    aperture : float
        Diameter of the lens, a share 0..1 of the material's longest edge; 0: all is sharp.
    focus : float
        What is sharp, from 0 (the nearest) to 1 (the farthest).
    exposure : float
        Stops, -10..10: each doubles the light.
    ground : bool
        Whether the material stands on a ground that takes its shadow.

    Returns
    -------
    Image
        Colour, (height, width); its spacing is the edge of a pixel in the image's unit (of a traced
        still, in the plane through the middle of what is seen). The recipe of a traced still holds
        its noise: the standard deviation of a channel (0..255), by the difference of its two
        halves.

    Raises
    ------
    InputError
        Not a volume, grey without threshold, unknown look, phase or cut, size or camera out of
        range, a field or form of another shape; of a traced still also nothing to draw, or a file
        of a look that does not hold one.
    """
    check_suffix(path, ".png")
    check_name(quality, QUALITIES, name="quality")
    taken = _exposure(quality, samples, lens, aperture, focus, exposure, ground)
    chosen = _as_look(look)
    given = (image, phase, camera, cut, size, threshold, field, limits, form, up)
    if taken is None:
        scene, angles = prepare_scene(given[0], plain_look(chosen), *given[1:])
        values, pixel = scene.picture(angles)
        subject, colours = scene.image, scene.colours
    else:
        drawn = prepare_subject(*given)
        angles, subject, colours = drawn.angles, drawn.image, drawn.colours
        values, pixel, noise = _traced(drawn, find_traced(chosen), taken)
    made: dict[str, Any] = {
        "look": chosen,
        "size": list(size),
        "phase": phase,
        "camera": angles,
        "threshold": threshold,
    }
    if field is not None and colours is not None and colours.limits is not None:
        made |= {"field": field.recipe.to_json(), "limits": list(colours.limits)}
    if form is not None:
        made |= {"form": as_image(form).recipe.to_json()}
    if up != "z":
        made |= {"up": up}
    if taken is not None:
        made |= {"quality": quality, "taken": asdict(taken), "noise": noise}
    recipe = subject.recipe.then(
        "render", values, cut=cut if isinstance(cut, str) else list(cut), **made
    )
    still = Image(values, "colour", (pixel, pixel), subject.unit, recipe=recipe)
    return save_picture(still, path)


def _as_look(look: str | PathLike[str] | Mapping[str, Any]) -> str | dict[str, Any]:
    """Return the name of a look, or the content of one's own, checked."""
    if isinstance(look, Mapping):
        content = dict(look)
    elif str(look).endswith(".toml"):
        content = read_look(look)
    else:
        check_name(str(look), TRACED, name="look")
        return str(look)
    find_traced(content)
    return content


def _exposure(
    quality: str,
    samples: int | None,
    lens: float,
    aperture: float,
    focus: float,
    exposure: float,
    ground: bool,
) -> Exposure | None:
    """Return how a traced still is taken; None of a quick one, which has none of this."""
    if quality == "quick":
        if samples is not None or aperture or exposure:
            raise InputError(
                "samples, aperture and exposure are of traced stills: give quality='draft' or "
                "'fine' as well"
            )
        return None
    count = SAMPLES[quality] if samples is None else samples
    return Exposure(
        samples=int(as_number(count, name="samples", low=2, high=65536, whole=True)),
        lens=as_number(lens, name="lens", low=0, high=120),
        aperture=as_number(aperture, name="aperture", low=0, high=1),
        focus=as_number(focus, name="focus", low=0, high=1),
        exposure=as_number(exposure, name="exposure", low=-10, high=10),
        ground=bool(ground),
    )


def _traced(it: Subject, look: TracedLook, taken: Exposure) -> tuple[np.ndarray, float, float]:
    """Trace a still; the picture, the edge of a pixel, and the noise (0..255)."""
    colour = it.image.kind == "colour"
    check_budget(
        forecast_traced(it.image.shape, it.size, colour=colour),
        advice="render a crop, or a coarser level of a .zarr",
    )
    shot = take(
        it.image, it.labels, it.drawn, it.cut, look, it.angles, it.size, taken,
        up=it.up,
        bands=None if it.colours is None else to_linear(it.colours.colours),
        colours=it.image.values if colour else None,
    )  # fmt: skip
    values = to_srgb(shot.light)
    if it.colours is not None:
        values = draw_field_legend(values, it.colours)
    return values, shot.framing.pixel * min(it.image.spacing), round(shot.noise, 2)


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
    scene, (azimuth, elevation) = prepare_scene(
        image, plain_look(_as_look(look)), phase, camera, cut, size, threshold
    )
    turns = [(azimuth + 360 * k / frames, elevation) for k in range(frames)]
    pixel = max(scene.camera(angles).pixel for angles in turns)
    pictures = [
        scene.picture(angles, pixel)[0] for angles in track(turns, "turntable", total=frames)
    ]
    return save_gif(pictures, path, seconds=seconds / frames)

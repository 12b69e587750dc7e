"""A traced still: the volume prepared, framed, lit, traced in passes, developed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import prod

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine.memory import Plan
from trabecula.engine.parallel import for_slabs
from trabecula.view.looks import to_linear, to_srgb
from trabecula.view.scene import Cut
from trabecula.view.trace.film import average_noise, develop
from trabecula.view.trace.framing import Framing, frame_camera, kept_blocks
from trabecula.view.trace.material import (
    LIGHTS,
    LightTable,
    PhaseMaterial,
    TracedLook,
    material_rows,
)
from trabecula.view.trace.paths import trace
from trabecula.view.trace.rim import coarse_factor, rim_depths
from trabecula.view.trace.space import BLOCK, Space, find_blocks, pack_form, spread_blocks
from trabecula.view.trace.surface import smooth_surface

SAMPLES = {"draft": 4, "fine": 16}
"""Paths a pixel."""

PASS = 4
"""Paths a pixel between two reports of progress."""

CLOSING = 0.035
"""Pores of this radius, a share of the longest edge, do not interrupt the outside of a form."""


@dataclass(frozen=True)
class Exposure:
    """How a traced still is taken.

    Parameters
    ----------
    samples : int
        Paths a pixel, 1..65536.
    lens : float
        Angle of view of the longer side, degrees, 0 (parallel) .. 120.
    aperture : float
        Diameter of the lens, a share of the longest edge; 0: all is sharp.
    focus : float
        What is sharp, from 0 (the nearest) to 1 (the farthest).
    exposure : float
        Stops.
    ground : bool
        Whether it stands on a ground.
    denoise : bool
        Whether noise is averaged away.
    """

    samples: int
    lens: float = 22.0
    aperture: float = 0.0
    focus: float = 0.3
    exposure: float = 0.0
    ground: bool = True
    denoise: bool = True


@dataclass(frozen=True, eq=False)
class Shot:
    """A traced picture: `light` (H, W, 3) linear 0..1, its `framing`, and its noise: the standard
    deviation of a pixel of the picture (0..255) by the difference of its halves, unfiltered and as
    it is.
    """

    light: np.ndarray
    framing: Framing
    raw_noise: float
    noise: float


def forecast_traced(shape: Sequence[int], size: tuple[int, int], *, colour: bool = False) -> Plan:
    """Forecast the memory of a traced still beside the image: field, form, blocks, rim, film."""
    voxels, pixels = prod(shape), prod(size)
    factor = coarse_factor(shape)
    more = math.ceil(CLOSING * max(shape) / factor) + 2
    coarse = prod(-(-side // factor) + 2 * more for side in shape)
    return Plan(
        {
            "field": 2 * voxels,
            "form": voxels if colour else 0,
            "blocks": prod(-(-side // BLOCK) for side in shape),
            "rim": 14 * coarse,
            "film": (6 * 8 + 8 * 4 + 2 * 6 * 8) * pixels,
        }
    )


def prepare_space(
    labels: np.ndarray,
    drawn: Sequence[int],
    stretch: np.ndarray,
    cut: Cut,
    *,
    colours: np.ndarray | None = None,
) -> Space:
    """Prepare the arrays of a volume; the rim is left out.

    Raises
    ------
    InputError
        No voxel is drawn, or the cut leaves none.
    """
    table = np.zeros(256, np.uint8)
    table[list(drawn)] = 1
    field = smooth_surface(labels, table)
    skip = np.empty([-(-side // BLOCK) for side in labels.shape], np.uint8)
    find_blocks(field, skip)
    spread_blocks(skip)
    box = cut.box * stretch
    if not (box[3] > box[2]).all():
        box[2:] = -1e9
    if len(drawn) == 1:  # one material: no label is looked up
        labels = np.full((1, 1, 1), drawn[0], np.uint8)
    return Space(
        field=field,
        labels=labels,
        colours=np.zeros((0, 1, 1, 3), np.uint8) if colours is None else colours,
        skip=skip,
        form=pack_form(stretch, box, cut.plane),
        rim=np.zeros((0, 1, 1), np.float32),
        coarse=stretch,
    )


def take(
    image: Image,
    labels: np.ndarray,
    drawn: Sequence[int],
    cut: Cut,
    look: TracedLook,
    angles: tuple[float, float],
    size: tuple[int, int],
    taken: Exposure,
    *,
    up: str = "z",
    bands: np.ndarray | None = None,
    colours: np.ndarray | None = None,
) -> Shot:
    """Trace a picture.

    Parameters
    ----------
    image : Image
        Its spacing and phases count.
    labels : (Z, Y, X) uint8
    drawn : sequence of int
        Labels that are material.
    cut : Cut
    look : TracedLook
    angles : (azimuth, elevation)
    size : (width, height)
    taken : Exposure
    up : str
        Axis of the volume that points up.
    bands : (N, 3) float, optional
        Linear albedo of every label, in place of the phases' own materials.
    colours : (Z, Y, X, 3) uint8, optional
        Albedo of every voxel.
    """
    edges = np.array(image.spacing[::-1])
    stretch = edges / edges.min()
    space = prepare_space(labels, drawn, stretch, cut, colours=colours)
    points, kept = kept_blocks(space.skip, stretch, cut)
    if not len(points):
        raise InputError("nothing of what is drawn is in the volume: choose another phase")
    if not len(kept):
        raise InputError("the cut leaves nothing of the material: cut less, or cut='none'")
    framing = frame_camera(
        points, kept, angles, up, size,
        lens=taken.lens, aperture=taken.aperture, focus=taken.focus,
    )  # fmt: skip
    rows = _rows(image, look, framing.extent, bands, colours)
    if rows[list(drawn), _STOPS].any():
        rim, coarse = rim_depths(space.field, stretch, CLOSING * framing.extent)
        space = space._replace(rim=rim, coarse=coarse)
    light = light_scene(LIGHTS[look.light], look, framing, cut, ground=taken.ground)
    halves, features = expose(space, rows, drawn, light, framing.lens, size, taken.samples)
    plain = [to_srgb(develop(half, taken.exposure)).astype(float) for half in halves]
    raw = float(np.sqrt(np.mean((plain[0] - plain[1]) ** 2)) / 2)
    if taken.denoise and taken.samples > 1:
        halves = average_noise(halves, features)
        plain = [to_srgb(develop(half, taken.exposure)).astype(float) for half in halves]
    noise = float(np.sqrt(np.mean((plain[0] - plain[1]) ** 2)) / 2)
    return Shot(develop(halves.mean(axis=0), taken.exposure), framing, raw, noise)


_STOPS = 31


def _rows(
    image: Image,
    look: TracedLook,
    extent: float,
    bands: np.ndarray | None,
    colours: np.ndarray | None,
) -> np.ndarray:
    """Return a material a label; of bands and colour volumes plain ones, as rough as the look's."""
    if bands is None and colours is None:
        return material_rows(look, image.phases, extent)
    first = look.materials[0]
    plain = PhaseMaterial(
        roughness=first.roughness, specular=first.specular,
        scattering_depth=0.0 if bands is not None else first.scattering_depth,
    )  # fmt: skip
    rows = np.repeat(plain.row(extent)[None], 2 if bands is None else len(bands), axis=0)
    if bands is not None:
        rows[:, :3] = bands
    return rows


def expose(
    space: Space,
    rows: np.ndarray,
    drawn: Sequence[int],
    light: np.ndarray,
    lens: np.ndarray,
    size: tuple[int, int],
    samples: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Trace all samples: the radiance (2, H, W, 3) of even and odd ones, and features (H, W, 8)."""
    width, height = size
    film = np.zeros((2, height, width, 3))
    features = np.zeros((height, width, 8), np.float32)
    table = np.zeros(256, np.uint8)
    table[list(drawn)] = 1
    linear = to_linear(np.arange(256))
    word = key(0, "traced still")
    passes = range(0, samples, PASS)
    for start in track(passes, "tracing", total=len(passes)):
        stop = min(start + PASS, samples)
        given = (space, rows, table, linear, light, lens, word, start, stop, film, features)
        for_slabs(partial(trace, *given), height)
    even, odd = (samples + 1) // 2, samples // 2
    film[0] /= even
    film[1] = film[1] / odd if odd else film[0]
    return film, features / np.float32(samples)


def light_scene(
    table: LightTable, look: TracedLook, framing: Framing, cut: Cut, *, ground: bool
) -> np.ndarray:
    """Return the light of `paths.trace`, placed about the camera: the lamp to the left, or to the
    right where that lights the cut better.
    """
    left = _direction(framing, -table.side, table.height)
    right = _direction(framing, table.side, table.height)
    sign = 1.0 if _cut_light(cut, framing, right) > _cut_light(cut, framing, left) + 0.05 else -1.0
    lamp = right if sign > 0 else left
    least = math.cos(math.radians(table.size / 2))
    solid = 2 * math.pi * (1 - least)
    beam = np.array(table.key) * math.pi / solid
    window = _direction(framing, sign * table.window[0], table.window[1])
    behind = to_linear(look.background)
    sky = [np.array(part) for part in (table.zenith, table.horizon, table.below)]
    glow = np.array(table.glow)
    above = float(framing.up @ lamp)
    # light on the open ground, over pi: the lamp's, the sky's (mean of its ramp weighted by the
    # cosine: 4/5 of the way to the zenith) and the window's
    level = np.array(table.key) * max(above, 0.0) + sky[1] + 0.8 * (sky[0] - sky[1])
    level = level + glow * 2 / (table.window[2] + 2) * max(float(framing.up @ window), 0.0)
    # a backdrop that is the open ground, so that there is no horizon
    albedo = np.minimum(0.86, behind * 0.9)
    seen = albedo * level
    if not ground:
        albedo, seen = np.full(3, -1.0), albedo * level
    reach = 4.0 * framing.extent
    rows = (
        [*lamp, least], beam, sky[0], sky[1], sky[2], [*window, table.window[2]], glow,
        [*framing.up, framing.ground], albedo, seen, [*framing.middle, reach],
    )  # fmt: skip
    return np.array([[*row, 0.0][:4] for row in rows])


def _direction(framing: Framing, side: float, height: float) -> np.ndarray:
    """Return the direction at an angle to the right of the viewer's, and a height above level."""
    level = framing.viewer - (framing.viewer @ framing.up) * framing.up
    length = np.linalg.norm(level)
    level = level / length if length > 1e-6 else -framing.above
    across = np.cross(framing.up, level)
    turn, lift = math.radians(side), math.radians(height)
    flat = math.cos(turn) * level + math.sin(turn) * across
    return math.cos(lift) * flat + math.sin(lift) * framing.up


def _cut_light(cut: Cut, framing: Framing, lamp: np.ndarray) -> float:
    """Return how much of the lamp falls on the faces of a cut that the viewer sees."""
    total = 0.0
    if np.abs(cut.plane[:3]).sum() > 0:
        total += max(0.0, float(cut.plane[:3] @ lamp)) * max(
            0.0, float(cut.plane[:3] @ framing.viewer)
        )
    low, high = cut.box[0], cut.box[1]
    taken = bool((cut.box[3] > cut.box[2]).all())
    for axis in range(3):
        sign = np.sign(framing.viewer[axis])
        faces = taken or (high[axis] % 1 != 0 or low[axis] > 0)
        if faces:
            total += max(0.0, sign * lamp[axis]) * abs(framing.viewer[axis])
    return total

"""Figures 8, 9, 10, 13 and 14 of Baravalle et al. (2016), and other materials, as traced stills."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image as Pillow

import trabecula as tb
from common import SCANS, asked, busy, pictures, table
from trabecula.core.seeds import generator
from trabecula.measure.distance import distance_transform
from trabecula.mesh.voxels import fit_mesh

SIZE = (480, 360)
Shot = tuple[tb.Image, dict[str, Any]]


def photographs() -> None:
    """Figures 8, 9, 10, 13 and 14 of Baravalle et al. as traced stills, and other materials:
    processor seconds of the volume and of the still, and the noise of a channel.
    """
    folder = pictures()
    row = table("picture", "volume, s", "still, s", "noise")
    wanted = asked("ONLY") or list(SHOTS)
    for name in wanted:
        making, (image, settings) = busy(SHOTS[name])
        drawing, still = busy(
            lambda i=image, s=settings: tb.render(i, quality="fine", size=SIZE, **s)
        )
        noise = still.recipe.to_json()[-1]["noise"]
        row(name, f"{making:.1f}", f"{drawing:.1f}", f"{noise:.2f}")
        if folder is not None:
            Pillow.fromarray(still.values).save(folder / f"{name}.jpg", quality=88, optimize=True)


def loaf() -> Shot:
    """A pan loaf, cut open (figure 14)."""
    form = np.pad(_loaf_form((236, 212, 320)), 4)
    fine = {"distance": 6.5, "time": 0.62, "thickness": 0.16, "coalescence": 0.3}
    coarse = {"distance": 15.0, "time": 0.5, "thickness": 0.14}
    material = _generations(
        form, "bread", {**coarse, "crust_share": 0.45}, {**fine, "crust_share": 0.7}
    )
    return material, {"look": "bread", "cut": "x=0.66", "camera": (52, 22)}


def baguette() -> Shot:
    """A baguette cut open: bubbles about its axis (figures 8 and 13)."""
    return _baguette(np.pad(_baguette_form(420, 76), 4)), {
        "look": "bread", "cut": "x=0.56", "camera": (52, 24),
    }  # fmt: skip


def slices() -> Shot:
    """Slices of the baguette on top of one another (figure 14). Their crust is a phase: a slice's
    own faces have none.
    """
    form = np.pad(_baguette_form(420, 76), 4)
    values = _baguette(form).values.copy()
    depth = distance_transform(form)
    values[(values > 0) & (depth < 7)] = 2
    values[(values > 0) & (depth < 3.6)] = 3
    thick = 32
    cut = [
        np.ascontiguousarray(values[:, :, at : at + thick].transpose(2, 1, 0))
        for at in (150, 60, 230)
    ]
    _, deep, high = cut[0].shape
    stack = np.zeros((2 * thick + 1, deep + 52, high + 150), np.uint8)
    stack[:thick, 40 : 40 + deep, :high] = cut[0]
    stack[:thick, :deep, 150 : 150 + high] = cut[1]
    stack[thick : 2 * thick, 46 : 46 + deep, 60 : 60 + high] = cut[2]
    phases = ("void", "crumb", "light crust", "dark crust")
    return tb.Image(stack, "labels", phases=phases), {
        "look": SLICED, "cut": "none", "camera": (25, 44),
    }  # fmt: skip


SLICED = {
    "base": "bread",
    "rim": [],
    "second": {
        "albedo": [206, 150, 88], "roughness": 0.8, "grain": 0.5, "grain_size": 0.08,
        "grain_albedo": [180, 112, 54],
    },
    "third": {
        "albedo": [160, 92, 42], "roughness": 0.55, "grain": 0.7, "grain_size": 0.1,
        "grain_albedo": [112, 60, 26], "bump": 0.2, "bump_size": 0.01,
    },
}  # fmt: skip


def sponge() -> Shot:
    """A sponge (figure 9)."""
    shape = (124, 192, 290)
    places = np.indices(shape, np.float32)
    beyond = [
        np.maximum(np.abs(each - (side - 1) / 2) - (side / 2 - 16), 0)
        for each, side in zip(places, shape, strict=True)
    ]
    form = np.pad(np.sqrt(sum(each**2 for each in beyond)) < 15, 2)
    material = _generations(
        form, "sponge", {"distance": 15.0, "porosity": 0.56}, {"distance": 7.0, "porosity": 0.3}
    )
    return material, {"look": "sponge", "cut": "none", "camera": (30, 34)}


def stone() -> Shot:
    """A vesicular stone (figure 10)."""
    form = np.pad(_boulder_form(288), 2)
    material = _generations(
        form, "stone", {"distance": 26.0, "porosity": 0.3}, {"distance": 9.0, "porosity": 0.16}
    )
    return material, {"look": "stone", "cut": "none", "camera": (25, 22)}


def cheese() -> Shot:
    """A wedge of a cheese with a rind."""
    side = 380
    z, y, x = np.indices((112, side, side), np.float32)
    rim = side / 2 - 8 - np.hypot(x - side / 2, y - side / 2)
    flat = np.minimum(z - 5, 106 - z)
    round_ = (rim < 14) & (flat < 14) & ((14 - rim) ** 2 + (14 - flat) ** 2 > 196)
    form = (rim > 0) & (flat > 0) & ~round_
    settings = {"distance": 42.0, "spread": 0.5, "time": 0.42, "crust_share": 0.12}
    return _generations(form, "cheese", settings), {
        "look": "cheese", "cut": ["y=0.5", "plane=118,0,0.5"], "camera": (62, 26),
    }  # fmt: skip


def marrow() -> Shot:
    """A scan of bone with its marrow (the sample, where the scan is not there)."""
    path = SCANS / "trabecular_bone_cortex_a.tif"
    scan = tb.read(path).values[3:-3, 3:-3, 3:-3] if path.is_file() else tb.sample("bone").values
    image = tb.Image((scan > 0).astype(np.uint8), "labels")
    return image, {"look": "bone", "phase": ["void", "solid"], "camera": (215, 26)}


def bone() -> Shot:
    """A scan of bone."""
    path = SCANS / "trabecular_bone_a.tif"
    scan = tb.read(path).values if path.is_file() else tb.sample("bone").values
    return tb.Image((scan > 0).astype(np.uint8), "labels"), {"look": "bone", "cut": "none"}


def foam() -> Shot:
    """The sample of an open-cell foam, of metal."""
    return tb.sample("foam"), {"look": "foam", "cut": "none", "camera": (30, 24)}


def rock() -> Shot:
    """A scan of sandstone (the sample of bone, where the scan is not there)."""
    path = SCANS / "berea_sandstone_a.tif"
    scan = tb.read(path).values if path.is_file() else tb.sample("bone").values
    return tb.Image((scan > 0).astype(np.uint8), "labels"), {"look": "rock"}


def terrazzo() -> Shot:
    """Solid colour from a picture, in a form: a cow, or a ball where there is no mesh."""
    path = SCANS / "mesh_spot.ply"
    if path.is_file():
        form = tb.voxelise(fit_mesh(tb.read_mesh(path), shape=200, spacing=1.0), spacing=1.0)
        mask, seen = form.values > 0, {"up": "y", "camera": (215, 12)}
    else:
        mask = np.sqrt(((np.indices((120,) * 3) - 59.5) ** 2).sum(axis=0)) < 57
        seen = {}
    made = tb.method("kopf", preset="fast").fit(tb.Image(_terrazzo_picture(128), "colour"))
    return made.generate(mask.shape, mask=mask, seed=1), {
        "look": "ceramic", "cut": "none", **seen,
    }  # fmt: skip


SHOTS: dict[str, Callable[[], Shot]] = {
    "loaf": loaf,
    "baguette": baguette,
    "slices": slices,
    "sponge": sponge,
    "stone": stone,
    "cheese": cheese,
    "marrow": marrow,
    "bone": bone,
    "foam": foam,
    "rock": rock,
    "terrazzo": terrazzo,
}


def _generations(form: np.ndarray, preset: str, *generations: dict[str, Any]) -> tb.Image:
    """Material that is left between several generations of bubbles."""
    left = None
    for number, settings in enumerate(generations):
        model = tb.method("bubbles", preset=preset, **settings).fit()
        values = model.generate(form.shape, mask=form, seed=5 + number).values
        left = values if left is None else np.minimum(left, values)
    return tb.finish.connect(tb.Image(left, "labels"))


def _baguette(form: np.ndarray) -> tb.Image:
    return _generations(
        form,
        "baguette",
        {
            "distance": 26.0,
            "time": 0.55,
            "thickness": 0.1,
            "coalescence": 0.35,
            "crust_share": 0.35,
        },
        {
            "distance": 13.0,
            "time": 0.62,
            "thickness": 0.12,
            "coalescence": 0.3,
            "crust_share": 0.55,
        },
        {"distance": 6.5, "time": 0.5, "thickness": 0.15, "crust_share": 0.9},
    )


def _baguette_form(length: int, radius: float) -> np.ndarray:
    """A spindle along x with a flat foot, and slanting cuts in its top that opened."""
    shape = (int(1.84 * radius), int(2.12 * radius), length)
    z, y, x = np.indices(shape, np.float32)
    along = (x - (length - 1) / 2) / (length / 2)
    thick = np.sqrt(1 - np.abs(along) ** 3.2)
    side = y - (shape[1] - 1) / 2
    lift = (z - 0.44 * shape[0]) / (0.86 * radius)
    lift = np.where(lift < 0, 1.25 * lift, lift)
    form = np.hypot(side / radius, lift) - thick
    for at in (-0.62, -0.2, 0.22, 0.64):
        across = ((along - at) * length / 2 - 0.9 * side) / np.sqrt(1.81)
        within = np.exp(-((side / (0.62 * radius)) ** 4)) * (lift > 0)
        form += 0.16 * np.exp(-((across / 7) ** 2)) * within
        form -= 0.07 * np.exp(-(((across - 11) / 6) ** 2)) * within
    return form < 0


def _loaf_form(shape: tuple[int, int, int]) -> np.ndarray:
    """Straight sides that widen upwards, a dome that bulges over them."""
    z, y, x = np.indices(shape, np.float32)
    along = 2 * x / (shape[2] - 1) - 1
    side = 2 * y / (shape[1] - 1) - 1
    lift = z / (shape[0] - 1)
    dome = 0.66 + 0.34 * np.sqrt(np.clip(1 - (0.98 * side) ** 2, 0, 1)) * (
        1 - 0.25 * np.abs(along) ** 4
    )
    dome += 0.02 * np.sin(9 * along + 2 * side)
    wide = 0.80 + 0.20 * np.clip((lift - 0.1) / 0.5, 0, 1) ** 0.7
    bulge = 1 + 0.03 * np.exp(-(((lift - 0.72) / 0.08) ** 2))
    wide = np.where(lift > 0.62, wide * bulge, wide) / 1.03
    inside = np.abs(side / wide) ** 6 + np.abs(along / 0.985) ** 14 < 1
    return inside & (lift < 0.99 * dome) & (lift > 0.01)


def _boulder_form(side: int) -> np.ndarray:
    """An ellipsoid, bent by smooth noise."""
    shape = (int(0.7 * side), int(0.85 * side), side)
    places = [2 * each / (length - 1) - 1 for each, length in zip(
        np.indices(shape, np.float32), shape, strict=True
    )]  # fmt: skip
    form = np.sqrt(sum(each**2 for each in places))
    form += 0.10 * _clouds(shape, 10, 0) + 0.03 * _clouds(shape, 32, 1)
    return form < 0.86


def _clouds(shape: tuple[int, ...], cells: int, number: int) -> np.ndarray:
    """Smooth noise of unit variance: chance at the corners of cells, twice interpolated."""
    noise = generator(4, "boulder", number).normal(size=(cells,) * 3)
    for axis in range(3):
        noise = (np.roll(noise, 1, axis) + 2 * noise + np.roll(noise, -1, axis)) / 4
    for axis, length in enumerate(shape):
        at = np.arange(length) * (cells - 1) / (length - 1)
        low = np.minimum(at.astype(int), cells - 2)
        share = (at - low) ** 2 * (3 - 2 * (at - low))
        share = share.reshape([-1 if each == axis else 1 for each in range(3)])
        noise = np.take(noise, low, axis) * (1 - share) + np.take(noise, low + 1, axis) * share
    return noise / noise.std()


def _terrazzo_picture(side: int) -> np.ndarray:
    """Chips of stone in a light cement: cells about random points, apart from one another."""
    chance = generator(3, "terrazzo")
    points, sizes = chance.random((150, 2)) * side, chance.lognormal(0, 0.45, 150)
    stones = [(196, 92, 64), (62, 66, 70), (228, 214, 190), (120, 140, 112), (214, 170, 96),
              (160, 160, 164), (92, 58, 48)]  # fmt: skip
    colours = np.array(stones)[chance.integers(0, len(stones), 150)]
    colours = colours + chance.normal(0, 6, (150, 3))
    y, x = np.mgrid[:side, :side] + 0.5
    half = side / 2
    apart = np.stack(
        [
            np.hypot((x - p + half) % side - half, (y - q + half) % side - half) / size
            for (p, q), size in zip(points, sizes, strict=True)
        ]
    )
    order = np.argsort(apart, axis=0)
    nearest, next_ = (np.take_along_axis(apart, order[n : n + 1], 0)[0] for n in (0, 1))
    chip = (next_ - nearest > 1.6) & (sizes[order[0]] > 0.75)
    cement = np.array([236, 230, 220]) + chance.normal(0, 3, (side, side, 1))
    picture = np.where(chip[..., None], colours[order[0]], cement)
    return np.clip(picture, 1, 255).astype(np.uint8)

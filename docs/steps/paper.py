"""Draw the pictures of Baravalle et al. (2016) again, figures 9 to 14, and some of what other
methods make.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

import trabecula as tb
from steps.presets import loaf
from trabecula.core.image import Image
from trabecula.mesh.voxels import fit_mesh

SCANS = Path(__file__).resolve().parents[2].parent / "shared" / "data"
"""Path of the mesh of the bunny, if it is there: it is not part of the project."""

_SEED = 7
_SIZE = (400, 300)
_ROUND, _LONG = (116, 132, 132), (84, 100, 220)
_RIVALS = {"white": 4.0, "perlin": 22.0, "voronoi": 16.0, "worley": 16.0}
"""Kinds of noise, figures 11 and 12, each with the size of its pattern."""

_SECTION = """## The pictures of Baravalle et al. (2016), drawn again

Breads whose bubbles are about a centre, as figure 13; the same loaf cut at three places, as the
slices of figure 14:

![a round loaf cut in half and a baguette cut across, with concentric bubbles](paper-breads.png)

![the round loaf cut near its end, in the middle and beyond](paper-slices.png)

Sponges (figure 9) and stones (figure 10), at randomness 0.5 and 1; stones have fewer bubbles and a
look that lets no light through:

![two sponges and two stones](paper-materials.png)

What is usually taken instead (figures 11 and 12), as bread: white noise, Perlin, Voronoi and
Worley noise, all of porosity .6. None has pores of a size, a direction and a wall between them at
once.

![blocks of white, Perlin, Voronoi and Worley noise](paper-rivals.png)

## Ours

{ours}
"""
_ARM = """A lattice graded to the field that makes a cantilever stiffest, in one component
([how](../howto/graded-structures.md)):

![a cantilever of a graded lattice](ours-cantilever.png)
"""
_BUNNY = """A bunny of bone, by the preset of `bubbles`: a cortex, and plates and rods within.

![a bunny of bone, cut open](ours-bunny.png)
"""


def draw_paper(folder: Path) -> str:
    """Draw all of them and return the section that shows them."""
    draw_figures(folder)
    _draw_cantilever(folder)
    ours = _ARM + (_BUNNY if _draw_bunny(folder) else "")
    return _SECTION.format(ours=ours)


def draw_figures(folder: Path) -> None:
    """Draw figures 9 to 14."""
    _draw_breads(folder)
    _draw_materials(folder)
    _draw_rivals(folder)


def _draw_breads(folder: Path) -> None:
    breads = [
        _bubbles("bread", loaf(_ROUND), flow="concentric", flow_axis="y", randomness=0.4),
        _bubbles("baguette", loaf(_LONG), flow="concentric", randomness=0.35),
    ]
    _sheet(
        [_still(breads[0], "bread", cut="y=0.5"), _still(breads[1], "bread", cut="x=0.6")],
        folder / "paper-breads.png",
    )
    slices = [
        _still(breads[0], "bread", cut=f"y={at}", camera=(10.0, 16.0)) for at in (0.25, 0.5, 0.75)
    ]
    _sheet(slices, folder / "paper-slices.png")


def _draw_materials(folder: Path) -> None:
    stills = []
    for preset, look, sides in (
        ("sponge", "sponge", (72, 100, 140)),
        ("stone", "stone", (96, 112, 128)),
    ):
        for randomness in (0.5, 1.0):
            ball = _pebble(sides) if preset == "stone" else None
            settings = {"flow": "horizontal", "randomness": randomness}
            made = _bubbles(preset, ball, sides=sides, **settings)
            stills.append(_still(made, look, cut="none" if ball is None else "corner"))
    _sheet(stills, folder / "paper-materials.png")


def _draw_rivals(folder: Path) -> None:
    stills = []
    for kind, length in _RIVALS.items():
        pores = {"invert": True} if kind == "worley" else {}  # round pores instead of balls
        model = tb.method(
            "noise", kind=kind, length=length, porosity=0.6, exact=True, **pores
        ).fit()
        made = model.generate(100, seed=_SEED)
        stills.append(_still(made, "bread"))
    _sheet(stills, folder / "paper-rivals.png")


def _draw_cantilever(folder: Path) -> None:
    """Draw the cantilever of the how-to, larger."""
    z, y, x = np.indices((64, 64, 64))
    level = np.cos(np.pi * z / 5) + np.cos(np.pi * y / 5) + np.cos(np.pi * x / 5)
    sample = Image(
        (level < 0.9 * np.cos(x / 11) * np.cos(y / 14 + z / 19)).astype(np.uint8), "labels"
    )
    density = tb.fields.resample(tb.fields.simp("cantilever", (10, 5, 20)), (80, 40, 150))
    field = tb.fields.rescale(density, low=0.32, high=0.68)
    made = tb.method("quilt", orientations="all").fit(sample).generate(
        field.shape, seed=_SEED, target={"volume_fraction": field}
    )  # fmt: skip
    tb.render(
        made,
        folder / "ours-cantilever.png",
        look="foam",
        size=(800, 480),
        cut="none",
        camera=(24.0, 24.0),
    )


def _draw_bunny(folder: Path) -> bool:
    """Draw the bunny and tell whether there was a mesh to fill."""
    if not (SCANS / "mesh_bunny.ply").exists():
        return False
    form = fit_mesh(tb.read_mesh(SCANS / "mesh_bunny.ply"), shape=200, spacing=1.0)
    lying = tb.voxelise(form, spacing=1.0).values > 0
    upright = np.ascontiguousarray(lying.transpose(1, 0, 2)[:, ::-1])
    made = _bubbles("bone", upright, distance=11)
    tb.render(
        made,
        folder / "ours-bunny.png",
        look="bone",
        size=(640, 480),
        cut="y=0.5",
        camera=(20.0, 12.0),
    )
    return True


def _bubbles(
    preset: str, mask: np.ndarray | None, *, sides: Sequence[int] = (), **settings: object
) -> Image:
    model = tb.method("bubbles", preset=preset, **settings).fit()
    return model.generate(tuple(sides) if mask is None else mask.shape, seed=_SEED, mask=mask)


def _pebble(sides: Sequence[int]) -> np.ndarray:
    z, y, x = (
        2 * (index + 0.5) / side - 1 for index, side in zip(np.indices(sides), sides, strict=True)
    )
    return np.abs(x) ** 2.4 + np.abs(y) ** 2.2 + np.abs(z) ** 2 < 1 - 0.12 * np.sin(
        4 * x + 2 * y
    ) * np.cos(3 * z)


def _still(image: Image, look: str, **settings: object) -> np.ndarray:
    return tb.render(image, look=look, size=_SIZE, **settings).values


def _sheet(stills: Sequence[np.ndarray], path: Path) -> None:
    Pillow.fromarray(np.concatenate(list(stills), axis=1)).save(path)

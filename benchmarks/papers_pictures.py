"""Pictures for the figures of the five papers that are pictures: small, and made by the package."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

import trabecula as tb
from common import SCANS, busy, pictures, table
from papers_saved import PICTURES, ROOT
from texture import wholes
from trabecula.mesh.voxels import fit_mesh

WIDE = 840
"""Pixels that a picture may be wide."""

COLOURS = 48


@dataclass(frozen=True)
class Sheet:
    """A picture that is kept: the files that a run drew, beside one another, or blocks of one."""

    files: tuple[str, ...]
    blocks: tuple[int, ...] = ()
    """Heights of the blocks that a tall sheet is cut into, pixels; the last one repeats."""
    wide: tuple[int, ...] = ()
    """Pixels that are kept of each block: its first panel; the last one repeats. None: all."""
    columns: int = 4
    pixels: int = WIDE
    """Pixels that the picture may be wide."""
    colours: int = COLOURS


FIRST = {"blocks": (208, 316), "wide": (176, 262)}
"""A `montage` of three slices a volume, the first of 60^3, the others of 120^3: the first slices.
"""
EQUAL = {"blocks": (328, 316), "wide": (262,)}
"""The same where all are of 120^3."""

KEPT: dict[str, dict[str, Sheet]] = {
    "by_example_2017": {
        "2017-bone": Sheet(("by-example-bone-a.png",), **FIRST),
        "2017-foam": Sheet(("by-example-sample-foam.png",), **FIRST),
    },
    "weights": {"2017-weights": Sheet(("texture-weights.png",), **FIRST)},
    "stills": {"2017-stills": Sheet(("2017-stills.png",))},
    "gan_losses": {"2021-losses": Sheet(("gan-losses-bone-b.png", "gan-losses-Berea.png"))},
    "gan_paper": {"2021-full-width": Sheet(("training.png",), colours=64)},
    "by_example_2021": {"2021-curves": Sheet(("curves-bone-a.png",))},
    "gan_shipped": {
        "2021-bone": Sheet(("gan-bone.png",), **EQUAL),
        "2021-berea": Sheet(("gan-berea.png",), **EQUAL),
    },
    "heuristics": {
        "2014-heuristics": Sheet(
            (
                "image-paper-ceramics.png",
                "image-paper-composite.png",
                "image-paper-gravel.png",
            )
        )
    },
    "upsampling": {"2014-upsampling": Sheet(("image-upsampling-ceramics.png",))},
    "relaxations": {"2014-relaxations": Sheet(("image-relaxations-gravel.png",))},
    "colour": {"2014-colour": Sheet(("image-colour.png",))},
    "indicators": {
        "2014-textures": Sheet(("image-sandstone.png", "image-copolymer.png")),
    },
    "views": {"2014-views": Sheet(("image-views.png",))},
    "section": {"liu-section": Sheet(("graded-section.png",), blocks=(283, 277), columns=5)},
    "lattice": {
        "liu-lattices": Sheet(
            (
                "graded-cantilever-no-turns.png",
                "graded-type-2-(frames)-no-turns.png",
                "graded-wheel-no-turns.png",
            )
        )
    },
    "bubble_figures": {
        f"baravalle-figure-{number}": Sheet((f"figure-{number}.png",), pixels=480, colours=8)
        for number in (1, 2, 3, 5, 6)
    },
    "bubble_stills": {
        f"baravalle-{name}": Sheet((f"paper-{name}.png",))
        for name in ("breads", "slices", "materials", "rivals")
    },
}
"""Run to the pictures that are kept of it, by their names here. Figures 4 and 7 of Baravalle et al.
are of a form whose terms keep them out of the repository.
"""


def keep(run: str, folder: Path) -> None:
    """Keep small versions of what a run drew into a folder."""
    for name, sheet in KEPT.get(run, {}).items():
        found = [folder / file for file in sheet.files if (folder / file).is_file()]
        if found:
            PICTURES.mkdir(parents=True, exist_ok=True)
            _small(_tiled(_beside(found), sheet), sheet, PICTURES / f"{name}.png")


def _beside(files: Sequence[Path]) -> Pillow.Image:
    """Pictures beside one another, each as tall as the lowest."""
    pictures = []
    for file in files:
        with Pillow.open(file) as opened:
            pictures.append(opened.convert("RGB"))
    tall = min(picture.height for picture in pictures)
    scaled = [
        picture.resize((round(picture.width * tall / picture.height), tall))
        if picture.height > tall
        else picture
        for picture in pictures
    ]
    sheet = Pillow.new("RGB", (sum(picture.width for picture in scaled), tall))
    left = 0
    for picture in scaled:
        sheet.paste(picture, (left, 0))
        left += picture.width
    return sheet


def _tiled(picture: Pillow.Image, sheet: Sheet) -> Pillow.Image:
    """The blocks of a tall sheet in rows."""
    if not sheet.blocks:
        return picture
    top, tiles, widths = 0, [], sheet.wide or (picture.width,)
    while top < picture.height - 2 * _MARGIN:
        tall, wide = (each[min(len(tiles), len(each) - 1)] for each in (sheet.blocks, widths))
        tiles.append(picture.crop((0, top, wide, min(top + tall, picture.height))))
        top += tall
    tall, wide, corner = max(sheet.blocks), max(widths), picture.getpixel((0, 0))
    rows = -(-len(tiles) // sheet.columns)
    whole = Pillow.new("RGB", (wide * min(sheet.columns, len(tiles)), tall * rows), corner)
    for number, tile in enumerate(tiles):
        row, column = divmod(number, sheet.columns)
        whole.paste(tile, (column * wide, row * tall + tall - tile.height))
    return whole


_MARGIN = 20


def _small(picture: Pillow.Image, sheet: Sheet, target: Path) -> None:
    scale = min(1.0, sheet.pixels / picture.width)
    size = (round(picture.width * scale), round(picture.height * scale))
    small = picture.resize(size, Pillow.Resampling.LANCZOS) if scale < 1 else picture
    small.quantize(sheet.colours, dither=Pillow.Dither.NONE).save(target, optimize=True)


def stills() -> None:
    """Figures 6, 7, 10 and 13 of 2017 as stills: bone and foam beside what is made from 60^3, foam
    in a form, and bone pruned, smoothed and thickened.
    """
    folder = pictures()
    if folder is None:
        print("(name a folder for the stills with --out)")
        return
    row = table("still", "s", "components")
    found, rows = wholes(), []
    for name, look in (("bone a", "bone"), ("sample foam", "foam")):
        exemplar = tb.crop(found.get(name, tb.sample("bone")), 60)
        images = {"exemplar, 60^3": exemplar}
        for words, settings in (("default", {}), ("best", {"preset": "best"})):
            seconds, made = busy(
                lambda e=exemplar, s=settings: tb.method("texture", **s).fit(e).generate(96, seed=0)
            )
            images[words] = made
            row(f"{name}, {words}", f"{seconds:.1f}", tb.measure.components(made))
        rows.append([_still(image, look) for image in images.values()])
    others = {"foam in a form": _form, "pruned": _pruned, "smoothed, thickened": _thickened}
    last = []
    for words, (make, look) in {
        words: (job, "foam" if words.endswith("form") else "bone") for words, job in others.items()
    }.items():
        seconds, made = busy(lambda m=make: m(found))
        row(words, f"{seconds:.1f}", tb.measure.components(made))
        last.append(_still(made, look, cut="none", camera=(20.0, 30.0)))
    rows.append(last)
    sheet = np.concatenate([np.concatenate(line, axis=1) for line in rows])
    Pillow.fromarray(sheet).save(folder / "2017-stills.png")


def _form(found: dict[str, tb.Image]) -> tb.Image:
    """Foam in a form, figure 7: a cow, or a ball where there is no mesh."""
    path = SCANS / "mesh_spot.ply"
    if path.is_file():
        form = fit_mesh(tb.read_mesh(path), shape=150, spacing=1.0)
        mask = tb.voxelise(form, spacing=1.0).values > 0
    else:
        places = np.indices((96,) * 3) - 47.5
        mask = np.sqrt((places**2).sum(axis=0)) < 47
    foam = tb.crop(found["sample foam"], 60)
    upright = np.ascontiguousarray(mask.transpose(1, 0, 2))
    return tb.finish.connect(
        tb.method("texture").fit(foam).generate(upright.shape, mask=upright, seed=0)
    )


def _pruned(found: dict[str, tb.Image]) -> tb.Image:
    bone = tb.crop(found.get("bone a", found["sample bone"]), 60)
    made = tb.method("texture").fit(bone).generate(80, seed=0)
    return tb.finish.connect(tb.finish.prune(made, exemplar=bone))


def _thickened(found: dict[str, tb.Image]) -> tb.Image:
    """Bone with struts of five voxels at least, figure 13."""
    pruned = _pruned(found)
    edge = pruned.spacing[0]
    return tb.finish.thicken(tb.finish.smooth(pruned, sigma=edge), thickness=5 * edge)


def _still(image: tb.Image, look: str, **settings: object) -> np.ndarray:
    return tb.render(image, look=look, size=(380, 300), **settings).values


def bubble_stills() -> None:
    """Figures 9 to 14 of Baravalle et al. as the gallery draws them."""
    folder = pictures()
    if folder is None:
        print("(name a folder for the stills with --out)")
        return
    sys.path.append(str(ROOT / "docs"))
    from steps.paper import draw_figures

    row = table("figures", "s")
    seconds, _ = busy(lambda: draw_figures(folder))
    row("9 to 14", f"{seconds:.1f}")

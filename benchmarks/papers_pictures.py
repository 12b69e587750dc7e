"""Pictures for the figures of the five papers that are pictures: small, and made by the package."""

from __future__ import annotations

import sys
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

KEPT: dict[str, dict[str, str]] = {
    "by_example_2017": {
        "by-example-2017-bone-a.png": "2017-bone",
        "by-example-2017-sample-foam.png": "2017-foam",
    },
    "weights": {"texture-weights.png": "2017-weights"},
    "stills": {"2017-stills.png": "2017-stills"},
    "gan_models": {"gan-bone.png": "2021-bone", "gan-berea.png": "2021-berea"},
    "heuristics": {
        "image-paper-ceramics.png": "2014-heuristics-ceramics",
        "image-paper-gravel.png": "2014-heuristics-gravel",
    },
    "upsampling": {"image-upsampling-ceramics.png": "2014-upsampling"},
    "relaxations": {"image-relaxations-gravel.png": "2014-relaxations"},
    "colour": {"image-colour.png": "2014-colour"},
    "indicators": {
        "image-sandstone.png": "2014-sandstone",
        "image-copolymer.png": "2014-copolymer",
        "image-composite.png": "2014-composite",
    },
    "views": {"image-views.png": "2014-views"},
    "section": {"graded-section.png": "liu-section"},
    "lattice": {
        "graded-cantilever-no-turns.png": "liu-cantilever",
        "graded-type-2-(frames)-no-turns.png": "liu-frames",
        "graded-wheel-no-turns.png": "liu-wheel",
    },
    "bubble_figures": {
        f"figure-{number}.png": f"baravalle-figure-{number}" for number in range(1, 8)
    },
    "bubble_stills": {
        "paper-breads.png": "baravalle-breads",
        "paper-slices.png": "baravalle-slices",
        "paper-materials.png": "baravalle-materials",
        "paper-rivals.png": "baravalle-rivals",
    },
}
"""Run to the pictures that it draws and that are kept: their files, and their names here."""


def keep(run: str, folder: Path) -> list[str]:
    """Keep small versions of what a run drew into a folder; return their names."""
    kept = []
    for file, name in KEPT.get(run, {}).items():
        if (folder / file).is_file():
            PICTURES.mkdir(parents=True, exist_ok=True)
            _small(folder / file, PICTURES / f"{name}.png")
            kept.append(name)
    return kept


def _small(source: Path, target: Path) -> None:
    with Pillow.open(source) as opened:
        image = opened.convert("RGB")
    scale = min(1.0, WIDE / image.width)
    size = (round(image.width * scale), round(image.height * scale))
    small = image.resize(size, Pillow.Resampling.LANCZOS) if scale < 1 else image
    small.quantize(COLOURS, dither=Pillow.Dither.NONE).save(target, optimize=True)


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
        for words, settings in (("preset paper", {"preset": "paper"}), ("default", {})):
            seconds, made = busy(
                lambda e=exemplar, s=settings: (
                    tb.method("texture", **s).fit(e).generate(120, seed=0)
                )
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
    upright = np.ascontiguousarray(mask.transpose(1, 0, 2)[::-1])
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

"""`mrf` as its paper compares: the heuristics that make one density of the views', and the ways to
relax.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import trabecula as tb
from common import busy, table
from image import draw, exemplars, likeness_of_volume, side_of
from trabecula.core.errors import TrabeculaError
from trabecula.synth.api.registry import methods

PICTURES = ("ceramics", "composite", "gravel", "bread 2")
CROP = 64
HEURISTICS = ("h1a", "h1b", "h2a", "h2b")
BRIEF: dict[str, Any] = {"sweeps": (3, 3, 12), "correction": 0.0}
"""Sweeps after which draws have not yet collapsed."""
RELAXATIONS: dict[str, dict[str, Any]] = {
    "annealing, h2b": {"relaxation": "annealing", "proposals": 8, **BRIEF},
    "gibbs, h2b": {"relaxation": "gibbs", "final_heat": (0.1,), **BRIEF},
}
AS_WRITTEN: dict[str, Any] = {
    "bandwidth": 1.0,
    "start": (1.0,),
    "xi": -3.0,
    "every": False,
    "levels": 256,
}
"""Section V.A to the letter, where the preset deviates from it."""


def image_paper() -> None:
    """32^3 from 64^2 (grey in 32 levels) with the paper's setting: heuristics H1a .. H2b by ICM,
    then annealing and Gibbs with H2b.

    `by classes` updates the sites in a regular order, `as written` takes h_opt and temperature 1
    besides, and `shares` holds the levels' shares. The last row is the method's default. Measures
    as in case `image_likeness`; `period` is the share of voxels that equal the one 4 on along all
    three axes.
    """
    if "mrf" not in methods():
        print("(no method 'mrf' yet: left out)")
        return
    side = side_of(32)
    row = table(
        "picture, setting",
        "histogram",
        "autocorr.",
        "orientation",
        "S2 cov",
        "axes",
        "period",
        "s",
        wide=34,
    )
    runs: dict[str, Mapping[str, Any]] = {
        f"icm, {name}": {"preset": "paper", "heuristic": name} for name in HEURISTICS
    }
    runs |= {name: {"preset": "paper", **settings} for name, settings in RELAXATIONS.items()}
    runs["icm, h2b, shares"] = {"preset": "paper", "shares": True}
    runs["by classes, h2b"] = {"preset": "paper", "order": "classes"}
    runs["as written, h2b"] = {"preset": "paper", **AS_WRITTEN}
    runs["as written, by classes"] = {"preset": "paper", **AS_WRITTEN, "order": "classes"}
    runs["default"] = {}
    for name, images in _smaller().items():
        volumes = {}
        for words, settings in runs.items():
            try:
                seconds, volume = busy(
                    lambda s=settings, i=images: (
                        tb.method("mrf", **s).fit(i[0]).generate(side, seed=0)
                    )
                )
            except TrabeculaError as error:
                print(f"{name}: {words}: {error}")
                continue
            volumes[words] = volume
            row(
                f"{name}: {words}",
                *likeness_of_volume(images, volume).cells(),
                f"{_period(volume.values):.2f}",
                f"{seconds:.1f}",
            )
        draw(f"paper {name}", images, volumes)


def _period(values: np.ndarray, step: int = 4) -> float:
    """The share of voxels that equal the one `step` on along z, y and x."""
    same = values[step:, step:, step:] == values[:-step, :-step, :-step]
    return float(np.mean(same if same.ndim == 3 else same.all(axis=-1)))


def _smaller() -> dict[str, Sequence[tb.Image]]:
    found = exemplars()
    names = [name for name in PICTURES if name in found] or list(found)[:1]
    return {
        name: [reduced(tb.crop(image, min(CROP, *image.shape))) for image in found[name][:1]]
        for name in names
    }


def reduced(image: tb.Image) -> tb.Image:
    """Reduce a grey picture to 32 levels, as for figure 7."""
    return (
        tb.Image(image.values // np.uint8(8) * np.uint8(8), "grey")
        if image.kind == "grey"
        else image
    )

"""`mrf` as its paper compares: the heuristics that make one density of the views', and the ways to
relax.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import trabecula as tb
from common import busy, table
from image import draw, exemplars, likeness_of_volume, side_of
from trabecula.core.errors import TrabeculaError
from trabecula.synth.api.registry import methods

PICTURES = ("ceramics", "composite", "gravel", "bread 2")
CROP = 64
HEURISTICS = ("h1a", "h1b", "h2a", "h2b")
RELAXATIONS: dict[str, dict[str, Any]] = {
    "icm": {"relaxation": "icm"},
    "annealing": {"relaxation": "annealing"},
    "gibbs": {"relaxation": "gibbs"},
}


def image_paper() -> None:
    """32^3 from 64^2 with the paper's setting: heuristics H1a .. H2b by ICM, then ICM, annealing
    and Gibbs with H2b.

    The last row is the method's default. Measures as in case `image_likeness`.
    """
    if "mrf" not in methods():
        print("(no method 'mrf' yet: left out)")
        return
    side = side_of(32)
    row = table(
        "picture, setting", "histogram", "autocorr.", "orientation", "S2 cov", "axes", "s", wide=34
    )
    runs: dict[str, Mapping[str, Any]] = {
        f"icm, {name}": {"preset": "paper", "heuristic": name} for name in HEURISTICS
    }
    runs |= {
        f"{name}, h2b": {"preset": "paper", **settings}
        for name, settings in RELAXATIONS.items()
        if name != "icm"
    }
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
            row(f"{name}: {words}", *likeness_of_volume(images, volume).cells(), f"{seconds:.1f}")
        draw(f"paper {name}", images, volumes)


def _smaller() -> dict[str, Sequence[tb.Image]]:
    found = exemplars()
    names = [name for name in PICTURES if name in found] or list(found)[:1]
    return {
        name: [tb.crop(image, min(CROP, *image.shape)) for image in found[name][:1]]
        for name in names
    }

"""Figures 5, 6, 7, 8 and 11 of Urs, Da Costa, Germain (2014) with `mrf`: cooling, up-sampling, ways
to relax, colour, two views and three.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, busy, table
from image import CROP, PICTURES, draw, likeness, likeness_of_volume
from image_paper import BRIEF, reduced
from trabecula.exemplar.views import take_slices
from trabecula.report.planes import SlicePlane

LABELS, GREY, COLOUR, ALONG = "ceramics", "gravel", "bread 2", "rods"
SIDE, SMALL, PIXELS = 64, 32, 64
MEASURES = ("histogram", "autocorr.", "orientation")
RARE = 0.001
"""A level that fewer voxels have is not counted as kept."""


def picture(name: str, pixels: int = PIXELS) -> tb.Image:
    """The middle of a picture; a slice of the sample where the folder is not here."""
    if not SCANS.is_dir():
        return tb.Image(tb.sample("foam").values[48], "labels")
    image = tb.read(SCANS / PICTURES[name][0])
    return reduced(tb.crop(image, min(pixels, *image.shape[:2])))


def image_cooling() -> None:
    """Figure 5: xi and the stop of ICM, H2b, 32^3 from 64^2; `sweeps` of each scale, finest first.

    The paper's texture takes about 18 iterations at xi = -1, 6 at xi = -3 with the stop at 95 %;
    the preset's xi is -8, since it counts the neighbours in space once each.
    """
    row = table("xi, stop", "sweeps", "in all", *MEASURES, "S2 cov", "s", wide=24)
    image, volumes = picture(LABELS), {}
    for xi, stop in ((-1.0, 1.0), (-3.0, 1.0), (-3.0, 0.95), (-8.0, 0.95)):
        settings = {"preset": "paper", "xi": xi, "stop": stop}
        seconds, volume = _make(image, SMALL, settings)
        sweeps = [len(scale["changed"]) for scale in _report(volume)][::-1]
        words = f"{xi:g}, {100 * stop:g} %"
        row(
            words,
            " ".join(map(str, sweeps)),
            sum(sweeps),
            *likeness_of_volume([image], volume).cells()[:4],
            f"{seconds:.1f}",
        )
        volumes[words] = volume
    draw("cooling", [image], volumes)


def image_upsampling() -> None:
    """Figure 6: 9 x 9 with 8/8 and with 1/8 up-sampling, 11 x 11 with 1/8; ICM, H2b, 32^3 from
    64^2.
    """
    ways = {"9 x 9, 8/8": (9, "all"), "9 x 9, 1/8": (9, "one"), "11 x 11, 1/8": (11, "one")}
    _rows(
        "upsampling",
        {LABELS: picture(LABELS)},
        {
            name: {"preset": "paper", "neighbourhood": width, "upsampling": way}
            for name, (width, way) in ways.items()
        },
        SMALL,
    )


def image_relaxations() -> None:
    """Figure 7: ICM beside annealing, H2b, 32 grey levels, 32^3 from 64^2, and the default.

    `levels` counts those of the picture that at least one voxel in a thousand has, `contrast` is
    the standard deviation over the picture's.
    """
    _rows(
        "relaxations",
        {GREY: picture(GREY)},
        {
            "icm, h2b": {"preset": "paper"},
            "annealing, h2b": {
                "preset": "paper",
                "relaxation": "annealing",
                "proposals": 8,
                **BRIEF,
            },
            "default": {},
        },
        SMALL,
    )


def image_colour() -> None:
    """Figure 8 and the 48 hours: colour, 64^2 to 32^3 (the paper: 64^3), 11 x 11, 3 scales, by the
    default (Gibbs) and by `kopf`.
    """
    image = picture(COLOUR)
    row = table("picture, way", *MEASURES, "s", wide=34)
    volumes = {}
    for method, settings in (("mrf", {"neighbourhood": 11, "scales": 3}), ("kopf", {})):
        seconds, volume = busy(
            lambda m=method, s=settings: tb.method(m, **s).fit(image).generate(SMALL, seed=0)
        )
        cells = likeness_of_volume([image], volume).cells()[:3]
        row(f"{COLOUR}, {method}", *cells, f"{seconds:.0f}")
        volumes[method] = volume
    draw("colour", [image], volumes)


def image_views() -> None:
    """Figures 11 and 12: a picture of rods as two views of the volume, and as all three, 32^3.

    Measures are over the slices of the views that were asked for.
    """
    image = picture(ALONG, CROP)
    row = table("views, method", *MEASURES, "S2 cov", "s", wide=24)
    volumes = {}
    for views in (("yx", "zx"), ("yx", "zx", "zy")):
        for method in ("mrf", "kopf"):
            seconds, volume = busy(
                lambda m=method, v=views: tb.method(m, views=v).fit(image).generate(SMALL, seed=0)
            )
            cells = _likeness_of_views(image, volume, views)
            row(f"{len(views)} views, {method}", *cells, f"{seconds:.1f}")
            volumes[f"{len(views)} views {method}"] = volume
    draw("views", [image], volumes)


def _likeness_of_views(image: tb.Image, volume: tb.Image, views: Sequence[str]) -> list[str]:
    slices = [each for plane in views for each in take_slices(volume, plane)]
    return likeness(SlicePlane(image, tuple(views), ""), slices).cells()[:4]


def _rows(
    name: str,
    images: Mapping[str, tb.Image],
    ways: Mapping[str, Mapping[str, Any]],
    side: int,
) -> None:
    row = table("picture, way", *MEASURES, "S2 cov", "levels", "contrast", "s", wide=30)
    for what, image in images.items():
        volumes = {}
        for words, settings in ways.items():
            seconds, volume = _make(image, side, settings)
            row(
                f"{what}, {words}",
                *likeness_of_volume([image], volume).cells()[:4],
                _levels(image, volume),
                f"{volume.values.std() / image.values.std():.2f}",
                f"{seconds:.1f}",
            )
            volumes[words] = volume
        draw(f"{name} {what}", [image], volumes)


def _make(image: tb.Image, side: int, settings: Mapping[str, Any]) -> tuple[float, tb.Image]:
    return busy(lambda: tb.method("mrf", **settings).fit(image).generate(side, seed=0))


def _report(volume: tb.Image) -> list[dict[str, Any]]:
    return volume.recipe.steps[-1]["report"]["scales"]


def _levels(image: tb.Image, volume: tb.Image) -> str:
    """How many of the picture's levels the volume has."""

    def held(values: np.ndarray) -> set[int]:
        levels, counts = np.unique(values, return_counts=True)
        return set(levels[counts >= RARE * values.size].tolist())

    own = held(image.values)
    return f"{len(own & held(volume.values))} of {len(own)}"

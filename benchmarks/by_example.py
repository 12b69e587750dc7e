"""The tables of the two papers that make material from a scan: every method on the same exemplars,
by the papers' measures.

D2 is 100 times the l2 norm of the difference of the two-point functions of the solid over that of
the exemplar's, r = 1 .. 50: table 1 of 2017 is that without the 100, table 1 of 2021 repeats its
figures with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

import trabecula as tb
from common import busy, pictures, table
from curves import draw_curves
from texture import wholes
from trabecula.view.slices import montage

SIDE = 120
REACH = 50
FLOATING = 10
"""A component of fewer voxels counts as floating (2021, section 6.2 c)."""

Maker = Callable[[tb.Image, int], tb.Image]
"""Exemplar and seed to 120^3."""


def _made_by(name: str, *, slices: bool = False, **settings: object) -> Maker:
    """A method with these settings, that learns from the exemplar, or from its middle slices."""

    def make(exemplar: tb.Image, seed: int) -> tb.Image:
        learnt = middle_slices(exemplar) if slices else exemplar
        return tb.method(name, **settings).fit(learnt).generate(SIDE, seed=seed)

    return make


def middle_slices(exemplar: tb.Image) -> list[tb.Image]:
    """Return the three orthogonal middle slices."""
    return [
        tb.Image(
            np.ascontiguousarray(exemplar.values.take(side // 2, axis)),
            exemplar.kind,
            spacing=tuple(edge for place, edge in enumerate(exemplar.spacing) if place != axis),
            unit=exemplar.unit,
            phases=exemplar.phases,
        )
        for axis, side in enumerate(exemplar.shape)
    ]


MAKERS: dict[str, tuple[Maker, Sequence[int]]] = {
    "texture, paper": (_made_by("texture", preset="paper"), (0, 1)),
    "texture": (_made_by("texture"), (0,)),
    "texture, best": (_made_by("texture", preset="best"), (0,)),
    "texture, fast": (_made_by("texture", preset="fast"), (0,)),
    "kopf, paper": (_made_by("kopf", preset="paper", slices=True), (0,)),
    "chen, paper": (_made_by("chen", preset="paper", slices=True), (0,)),
    "Gaussian field": (_made_by("noise", exact=True), (0,)),
}
"""Ways to make 120^3, each with its seeds; `kopf` and `chen` learn from the three middle slices."""

FROM_SLICES = ("kopf, paper", "chen, paper")


@dataclass(frozen=True)
class Figures:
    """What both papers report, and what they do not."""

    error: float
    """Of the porosity, per cent."""
    distance: float
    """D2."""
    components: int
    floating: int
    sizes: float
    """Wasserstein distance of the components' sizes, on a scale of this package's own."""
    largest: float
    thickness: float
    """Over the exemplar's, as the next."""
    euler: float
    coherence: float


def figures(exemplar: tb.Image, image: tb.Image) -> Figures:
    """Measure an image against its exemplar."""
    own, curve = (tb.measure.two_point(one, r_max=REACH)[1:] for one in (exemplar, image))
    error = tb.measure.porosity(image) / tb.measure.porosity(exemplar) - 1
    return Figures(
        error=100 * abs(error),
        distance=100 * float(np.linalg.norm(curve - own) / np.linalg.norm(own)),
        components=tb.measure.components(image),
        floating=tb.measure.floating(image, smaller_than=FLOATING),
        sizes=tb.measure.component_distance(image, exemplar),
        largest=tb.measure.largest_fraction(image),
        thickness=tb.measure.thickness(image) / tb.measure.thickness(exemplar),
        euler=_euler(image) / _euler(exemplar),
        coherence=tb.measure.coherence(exemplar, image, k=(4,))[4],
    )


def _euler(image: tb.Image) -> float:
    return float(tb.measure.euler_density(image)) * float(np.prod(image.spacing))


HEADS = (
    "porosity error %",
    "D2",
    "D2 range",
    "N_cc",
    "N_f",
    "D_w",
    "largest",
    "thickness",
    "Euler",
    "coherence(4)",
    "pruned",
    "s",
)


def compare(
    exemplars: Mapping[str, tuple[tb.Image, Sequence[tb.Image]]],
    makers: Mapping[str, tuple[Maker, Sequence[int]]],
) -> None:
    """Print a table: each method on each exemplar, means over seeds; first the exemplar's other
    parts.
    """
    row = table("exemplar, what", *HEADS, wide=36)
    for name, (exemplar, elsewhere) in exemplars.items():
        row(
            f"{name}, exemplar",
            f"{100 * tb.measure.porosity(exemplar):.2f}",
            *("", "", tb.measure.components(exemplar)),
            tb.measure.floating(exemplar, smaller_than=FLOATING),
            "",
            f"{tb.measure.largest_fraction(exemplar):.4f}",
            *([""] * 5),
        )
        if elsewhere:
            found = [figures(exemplar, part) for part in elsewhere]
            row(f"{name}, real elsewhere", *_cells(found), "", "")
        shown = {"exemplar": exemplar}
        for words, (make, seeds) in makers.items():
            found, pruned, spent = [], [], []
            for seed in seeds:
                seconds, image = busy(lambda m=make, e=exemplar, s=seed: m(e, s))
                found.append(figures(exemplar, image))
                pruned.append(_operations(exemplar, image) if words.startswith("texture") else "")
                spent.append(seconds)
                shown.setdefault(words, image)
            row(
                f"{name}, {words}",
                *_cells(found),
                " ".join(map(str, pruned)).strip(),
                f"{np.min(spent):.1f}",
            )
        if folder := pictures():
            file = name.replace(" ", "-").replace(",", "")
            montage(list(shown.values()), list(shown), folder / f"by-example-{file}.png")
            curves = {
                words: tb.measure.two_point(image, r_max=REACH) for words, image in shown.items()
            }
            path = folder / f"curves-{file}.png"
            draw_curves(curves, path, along="r, voxels", up="S2 of the solid")


def _cells(found: Sequence[Figures]) -> Iterator[str]:
    def mean(name: str) -> float:
        return float(np.mean([getattr(one, name) for one in found]))

    distances = [one.distance for one in found]
    yield f"{mean('error'):.2f}"
    yield f"{mean('distance'):.1f}"
    yield f"{min(distances):.1f} - {max(distances):.1f}"
    yield f"{mean('components'):.0f}"
    yield f"{mean('floating'):.0f}"
    yield f"{mean('sizes'):.3g}"
    yield f"{mean('largest'):.3f}"
    yield from (f"{mean(name):.2f}" for name in ("thickness", "euler"))
    yield f"{mean('coherence'):.2f}"


def _operations(exemplar: tb.Image, image: tb.Image) -> int:
    """Return how many branches pruning removes and grows."""
    report = tb.finish.prune(image, exemplar=exemplar).recipe.steps[-1]["report"]
    return int(report["removed"] + report["grown"])


def middle(scan: tb.Image, side: int) -> tuple[tb.Image, list[tb.Image]]:
    """The middle of a scan, and its eight corners, which share no voxel with it."""
    exemplar, low = tb.crop(scan, side), min(scan.shape) // 2 - side // 2
    if low <= REACH:
        return exemplar, []
    return exemplar, _corners(scan, low)


def corner(scan: tb.Image, side: int) -> tuple[tb.Image, list[tb.Image]]:
    """A corner of a scan, and three others, which share no voxel with it or one another."""
    exemplar = tb.crop(scan, [min(side, edge) for edge in scan.shape], corner=(0, 0, 0))
    if min(scan.shape) < 2 * side:
        return exemplar, []
    return exemplar, _corners(scan, side)[1:7:2]


def _corners(scan: tb.Image, side: int) -> list[tb.Image]:
    places = product(*((0, edge - side) for edge in scan.shape))
    return [tb.crop(scan, side, corner=place) for place in places]


def by_example_2017() -> None:
    """Table 1 of 2017: 120^3 from 60^3 of bone and foam, by every method (foam without those that
    learn from slices); means over seeds.

    `pruned` counts the branches that `finish.prune` removes and grows, seed by seed; `s` is the
    processor's, the least of the seeds'; the first row of an exemplar has its porosity in per cent.
    """
    found = wholes()
    bone = "bone a" if "bone a" in found else "sample bone"
    compare({bone: middle(found[bone], 60)}, MAKERS)
    fewer = {name: one for name, one in MAKERS.items() if name not in FROM_SLICES}
    compare({"sample foam": middle(found["sample foam"], 60)}, fewer)


def by_example_2021() -> None:
    """Table 1 of 2021 at its size: 120^3 from 100^3 of bone, one seed, without the networks (case
    `gan_shipped`) and without what learns from slices; columns as in `by_example_2017`.
    """
    found = wholes()
    bone = "bone a" if "bone a" in found else "sample bone"
    names = ("texture, paper", "texture", "texture, best", "Gaussian field")
    compare({bone: corner(found[bone], 100)}, {name: (MAKERS[name][0], (0,)) for name in names})

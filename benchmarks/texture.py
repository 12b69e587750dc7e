"""`texture`: fidelity beside band and baseline, the dial of novelty, repetition on itself, the
energy's course.

Speed and memory are in texture_speed.py.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, busy, pictures, table
from descriptors import GREY, scans
from trabecula.core.seeds import generator
from trabecula.report.descriptors import LabelDescriptors
from trabecula.report.evenness import choose_windows
from trabecula.report.reference import Reference, search_copies
from trabecula.report.verdict import Metric
from trabecula.synth.texture import CAPABILITIES
from trabecula.synth.texture.config import TextureConfig
from trabecula.view.slices import montage

SEEDS = (0, 1, 2)
SIDE = 120
NARROW = ("bone a",)
"""Exemplars of 60^3; the others, whose structures are wider, are of 100^3."""


Run = tuple[str, float, Sequence[int]]


def wholes() -> dict[str, tb.Image]:
    """Return the samples, and the scans that are here, by name."""
    found = {f"sample {name}": tb.sample(name) for name in tb.samples()}
    scanned = scans().items()
    return found | {name: scan for name, scan in scanned if f"sample {name}" not in found}


def exemplars() -> dict[str, tb.Image]:
    """Return exemplars of 60^3 or 100^3 by name: of the samples, and the centres of the scans."""
    narrow = (*NARROW, *(f"sample {name}" for name in tb.samples()))
    return {name: tb.crop(one, 60 if name in narrow else 100) for name, one in wholes().items()}


def chosen_exemplars(*names: str) -> dict[str, tb.Image]:
    """Those of these names that are here."""
    found = exemplars()
    return {name: found[name] for name in names if name in found}


def fitted(exemplar: tb.Image, settings: Mapping[str, Any]) -> Any:
    """`texture` with these settings, or a preset among them, and what it learnt."""
    return tb.method("texture", **settings).fit(exemplar)


def presets(*names: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The presets of these names that exist, with the default, as settings."""
    for name in names:
        if name == "default":
            yield name, {}
        elif name in CAPABILITIES.presets:
            yield name, {"preset": name}
        else:
            print(f"(no preset {name!r} yet: left out)")


def has_setting(name: str) -> bool:
    """Whether `texture` has a setting; says so where it has not."""
    known = name in {field.name for field in dataclasses.fields(TextureConfig)}
    if not known:
        print(f"(no setting {name!r} yet: left out)")
    return known


def reference_of(exemplar: tb.Image) -> Reference:
    """What `tb.verify` holds an image against, measured once for all images of a table."""
    reach = min(50, min(exemplar.shape) // 2 - 1)
    windows = choose_windows(exemplar, [exemplar])
    return Reference(
        exemplar, LabelDescriptors(r_max=reach, level="default", windows=windows), copying=True
    )


def judged(reference: Reference, image: tb.Image) -> dict[str, Metric]:
    """The metrics of `tb.verify`."""
    copies = search_copies(reference.exemplar, image)
    return reference.judge(reference.measure(image), copies)


def out_of_band(metrics: Mapping[str, Metric]) -> tuple[int, int]:
    """How many figures are out of band, and how many are judged."""
    passed = [one.passed for one in metrics.values() if one.passed is not None]
    return passed.count(False), len(passed)


# How a figure is told: as it is, as a whole number, times 100, or over the exemplar's own.
_PLAIN, _WHOLE, _HUNDRED, _RATIO = "plain", "whole", "hundred", "ratio"
FIGURES = {
    "S2 rel": ("two_point_relative", _PLAIN),
    "S2 x100": ("two_point_distance", _HUNDRED),
    "S2 cov": ("two_point_covariance", _PLAIN),
    "parts": ("components", _WHOLE),
    "largest": ("largest_fraction", _PLAIN),
    "thickness": ("thickness", _RATIO),
    "Euler": ("euler_density", _RATIO),
    "pore size": ("pore_size", _RATIO),
    "spread": ("fraction_spread_large", _RATIO),
    "lineal": ("lineal_path_distance", _PLAIN),
    "shape": ("shape_index_distance", _PLAIN),
    "coh(4)": ("coherence", _PLAIN),
}


def told(metric: Metric | None, how: str) -> str:
    """A metric's value in a few characters, with `!` where it lies outside the band."""
    if metric is None or metric.value is None:
        return "-"
    value = _scaled(metric.value, metric, how)
    return _short(value) + ("!" if metric.passed is False else "")


def band_of(metric: Metric | None, how: str) -> str:
    """The real band: its upper end where it begins at 0, its lower end where it ends at 1, else
    both.
    """
    if metric is None or metric.real_band is None:
        return "-"
    low, high = sorted(_scaled(end, metric, how) for end in metric.real_band)
    if metric.real_band[0] == 0:
        return f"<{high:.3g}"
    if metric.real_band[1] == 1 and how == _PLAIN:
        return f">{low:.4g}"
    return f"{low:.2g}..{high:.2g}" if how != _WHOLE else f"{low}..{high}"


def _scaled(value: float, metric: Metric, how: str) -> float:
    if how == _WHOLE:
        return round(value)
    if how == _RATIO:
        return value / metric.exemplar if metric.exemplar else float("nan")
    return value * 100 if how == _HUNDRED else value


def _short(value: float) -> str:
    if isinstance(value, int) or abs(value) >= 100:
        return f"{value:.0f}"
    return (
        f"{value:.2f}"
        if abs(value) >= 2
        else f"{value:.4f}"
        if abs(value) < 0.1
        else f"{value:.3f}"
    )


def cells(metrics: Mapping[str, Metric], names: Sequence[str] = tuple(FIGURES)) -> list[str]:
    """The cells of a row of `FIGURES`."""
    return [told(metrics.get(FIGURES[name][0]), FIGURES[name][1]) for name in names]


def fidelity() -> None:
    """120^3 of every exemplar, three seeds: figures beside the real band and a thresholded Gaussian
    field of that size.

    `thickness`, `Euler` and `pore size` are over the exemplar's own, `!` marks what lies outside
    the band, `expected` are the exemplar's parts at the result's volume, `floating` is after
    `finish.connect`.
    """
    row = table("exemplar, what, seed", *FIGURES, "expected", "floating", wide=36)
    kinds = list(presets("default", "best"))
    for name, exemplar in exemplars().items():
        reference = reference_of(exemplar)
        baseline = judged(
            reference, tb.method("noise", exact=True).fit(exemplar).generate(SIDE, seed=0)
        )
        row(
            f"{name}, real band",
            *(band_of(baseline.get(figure), how) for figure, how in FIGURES.values()),
            "",
            "",
        )
        row(f"{name}, Gaussian field", *cells(baseline), "", "")
        for kind, settings in kinds:
            model = fitted(exemplar, settings)
            for seed in SEEDS:
                material = model.generate(SIDE, seed=seed)
                metrics = judged(reference, material)
                floating = tb.measure.floating(tb.finish.connect(material))
                row(
                    f"{name}, {kind}, {seed}",
                    *cells(metrics),
                    f"{metrics['components'].exemplar:.0f}",
                    floating,
                )


KINDS: dict[str, dict[str, str]] = {
    "structure": {"layout": "structure"},
    "default": {},
    "leaves": {"search": "leaves"},
}
"""Settings by name: the default of before, that of now, and what `--effort` tries first."""

RUNS: tuple[Run, ...] = (
    ("structure", 1.25, (1, 2, 3)),
    ("default", 1.25, (1, 2, 3)),
    ("leaves", 1.25, (1, 2, 3)),
    ("default", 2.0, (1,)),
)
"""One of `KINDS`, sides over the exemplar's, and seeds."""


def materials() -> None:
    """1.25 times and twice the side of the central 96^3 of every exemplar: how many figures of
    `verify` lie outside their bands, some of them, and the names of those outside.
    """
    judge_materials(96, RUNS)


def crops() -> None:
    """The same of 80^3 from the central 64^3, seed 1, the default alone: all materials in few
    minutes.
    """
    judge_materials(64, (("default", 1.25, (1,)),))


def judge_materials(side: int, runs: Sequence[Run]) -> None:
    """Print a row for every run from the central `side`^3 of every exemplar, and the figures out of
    band.
    """
    names = ("S2 cov", "shape", "thickness", "Euler", "pore size", "coh(4)")
    row = table("exemplar, what, sides, seed", "out", "of", *names, "CPU s", wide=36)
    for name, whole in wholes().items():
        exemplar = tb.crop(whole, [min(side, edge) for edge in whole.shape])
        reference = reference_of(exemplar)
        for kind, times, seeds in runs:
            shape = [int(edge * times) for edge in exemplar.shape]
            model = fitted(exemplar, KINDS[kind])
            for seed in seeds:
                seconds, material = busy(lambda m=model, s=seed, n=shape: m.generate(n, seed=s))
                metrics = judged(reference, material)
                decided = {key: metric.passed for key, metric in metrics.items()}
                out = [key for key, passed in decided.items() if passed is False]
                count = sum(passed is not None for passed in decided.values())
                told = (len(out), count, *cells(metrics, names), f"{seconds:.1f}")
                row(f"{name}, {kind}, {times:g}, {seed}", *told)
                print("    " + " ".join(out), flush=True)


def novelty() -> None:
    """The dial between novelty and fidelity: copying at full (k = 1, 4, 8) and half resolution (k =
    4), and what is kept.

    Maps of sources are drawn where TRABECULA_BENCH_OUT names a folder.
    """
    if not has_setting("novelty"):
        return
    kept = ("S2 rel", "S2 cov", "largest", "thickness", "pore size", "Euler", "lineal")
    row = table("exemplar, novelty", "coh(1)", "coh(4)", "coh(8)", "half(4)", *kept, wide=24)
    for name, exemplar in chosen_exemplars("bone a", "sample foam", "Berea").items():
        reference = reference_of(exemplar)
        for dial in (0.0, 0.25, 0.5, 0.75, 1.0):
            material = fitted(exemplar, {"novelty": dial}).generate(SIDE, seed=0)
            share = tb.measure.coherence(exemplar, material)
            half = tb.measure.coherence(exemplar, material, k=(4,), half=True)[4]
            copied = [f"{value:.3f}" for value in (*share.values(), half)]
            row(f"{name}, {dial:.2f}", *copied, *cells(judged(reference, material), kept))
            draw_sources(exemplar, material, f"novelty {dial:.2f}", f"sources-{name}-{dial:.2f}")


def draw_sources(exemplar: tb.Image, material: tb.Image, title: str, name: str) -> None:
    """Middle slices of exemplar and result, and of where the result was taken from, as a PNG in the
    folder of pictures.

    A colour of the map is a shift from a voxel to its source: an even patch is one piece of the
    exemplar, and its border a seam. Black voxels have no source.
    """
    folder = pictures()
    if folder is None:
        return
    position = tb.measure.sources(exemplar, material).position
    shift = position - np.moveaxis(np.indices(material.shape), 0, -1)
    sides = np.array(exemplar.shape)
    colours = (70 + 185 * (shift % sides) / sides).astype(np.uint8)
    colours[position[..., 0] < 0] = 0
    taken = tb.Image(colours, "colour", spacing=material.spacing, unit=material.unit)
    sheet = folder / f"{name.replace(' ', '-')}.png"
    montage(
        [exemplar, material, taken], ["exemplar", title, "shift to the source"], sheet, side=300
    )


PAPER_FIGURES = {"bone": (2.86, 8.97), "foam Ni": (2.11, 13.67)}
"""Porosity error in % and D2 of the 2017 method, from table 1 of Zhang, Yang, Li, Wu, Wang (2021);
D2 of bone and of two foams is also table 1 of 2017.
"""
PAPER_SECONDS = 1200
"""Section 5.1: 120^3 from 60^3."""


def paper() -> None:
    """`preset=paper` beside the paper's figures: 120^3 from 60^3, three seeds; of the first seed
    also at the exemplar's own iso-value, as the paper has it.

    D2 is 100 times the relative l2 of S2, r = 1 .. 29. Grey values are cut at the exemplar's
    threshold (section 3).
    """
    kept = ("largest", "thickness", "Euler")
    row = table("exemplar, seed", "error %", "D2", *kept, "coh(4)", "s", wide=36)
    for name, (error, distance) in PAPER_FIGURES.items():
        row(f"the paper, {name}", error, distance, "", "", "", "", PAPER_SECONDS)
    ways = [(seed, "fraction") for seed in SEEDS] + [(SEEDS[0], "middle")]
    for name, exemplar in _paper_exemplars().items():
        cut = _cut_like(exemplar)
        reference = reference_of(cut(exemplar))
        for seed, iso_value in ways:
            model = fitted(exemplar, {"preset": "paper", "iso_value": iso_value})
            seconds, material = busy(lambda m=model, s=seed: m.generate(SIDE, seed=s))
            metrics = judged(reference, cut(material))
            row(
                f"{name}, {seed}" + (", own iso-value" if iso_value == "middle" else ""),
                f"{100 * _value(metrics, 'porosity_error'):.2f}",
                f"{100 * _value(metrics, 'two_point_relative'):.1f}",
                *cells(metrics, (*kept, "coh(4)")),
                f"{seconds:.0f}",
            )


def _value(metrics: Mapping[str, Metric], name: str) -> float:
    value = metrics[name].value
    return float("nan") if value is None else value


def _paper_exemplars() -> dict[str, tb.Image]:
    """Return 60^3 of bones, a rock and particles where there are scans, and of the samples."""
    names = ("bone a", "bone with cortex", "grey bone, Otsu", "bone b", "Berea", "NMC")
    found = wholes()
    file, edge, length = GREY["grey bone"]
    if (SCANS / file).is_file():
        found["grey bone, grey"] = tb.read(SCANS / file, spacing=edge, unit=length)
    chosen = (*names, "grey bone, grey", "sample foam", "sample bone")
    return {name: tb.crop(found[name], 60) for name in chosen if name in found}


def _cut_like(exemplar: tb.Image) -> Callable[[tb.Image], tb.Image]:
    """Cut grey images at Otsu's threshold of the exemplar; leave labels."""
    if exemplar.kind == "labels":
        return lambda image: image
    threshold = tb.segment(exemplar).recipe.steps[-1]["threshold"]
    return lambda image: tb.segment(image, threshold)


PAPER_DRIFT = (0.1243, 0.1514, 0.1191, 0.1511)
"""Section 5.1: relative l2 of the correlation function of rounds 1 to 4 against the original."""


def repeat() -> None:
    """Section 5, figure 9: four rounds, each made from a random 80 % (by volume) of the last
    result, against the original.

    `copied` is coherence(4) with the piece that the round was made from.
    """
    repeat_with({}, "bone a", "sample foam")


def repeat_paper() -> None:
    """The same by the paper's preset, of bone."""
    repeat_with({"preset": "paper"}, "bone a")


def repeat_with(settings: Mapping[str, Any], *names: str) -> None:
    """Repeat results on themselves, by `texture` with these settings."""
    kept = ("S2 rel", "parts", "largest", "thickness", "Euler", "pore size", "coh(4)")
    row = table("exemplar, round", "paper", *kept, "expected", "copied", wide=24)
    for name, original in chosen_exemplars(*names).items():
        source, reference = original, reference_of(original)
        for number, paper in enumerate(PAPER_DRIFT, start=1):
            material = fitted(source, settings).generate(SIDE, seed=number)
            metrics = judged(reference, material)
            copied = tb.measure.coherence(source, material, k=(4,), samples=500)[4]
            expected = f"{metrics['components'].exemplar:.0f}"
            row(f"{name}, {number}", paper, *cells(metrics, kept), expected, f"{copied:.3f}")
            source = _some_of(material, 0.8, round_=number)


def _some_of(image: tb.Image, share: float, *, round_: int) -> tb.Image:
    """A box with this share of the voxels, at a random place."""
    draw = generator(round_, "benchmarks/repeat")
    sides = [round(side * share ** (1 / 3)) for side in image.shape]
    corner = [
        int(draw.integers(0, side - kept + 1))
        for side, kept in zip(image.shape, sides, strict=True)
    ]
    return tb.crop(image, sides, corner=corner)


def energy() -> None:
    """Figure 5: the paper's pieces with and without adaptive weights, 60^3 from 40^3, three seeds.

    `last` and `least` are sums of squared distances of neighbourhoods, which have no weights in
    them, so that runs can be compared; `rises` counts the rounds in which they rose. Of the first
    seed also the curves, over their first round.
    """
    name, exemplar = next(iter(chosen_exemplars("bone a", "sample bone").items()))
    piece = tb.crop(exemplar, 40)
    row = table(f"{name}: seed, level, width, weights", "rounds", "last", "least", "rises", wide=40)
    rounds = {"plain": 0, "adaptive": 0}
    for seed in SEEDS:
        runs = {label: _courses(piece, adaptive=label == "adaptive", seed=seed) for label in rounds}
        for place in runs["plain"]:
            for label, courses in runs.items():
                course = courses[place]
                rises = np.count_nonzero(np.diff(course) > 0)
                row(
                    f"{seed}, {place}, {label}",
                    len(course),
                    f"{course[-1]:.3e}",
                    f"{min(course):.3e}",
                    rises,
                )
                rounds[label] += len(course)
                if seed == SEEDS[0]:
                    print("    " + " ".join(f"{value / course[0]:.2f}" for value in course))
    for label, count in rounds.items():
        row(f"all, {label}", count, "", "", "")


def _courses(exemplar: tb.Image, *, adaptive: bool, seed: int) -> dict[str, list[float]]:
    """Level and width -> the sum of squares of every round."""
    material = fitted(exemplar, {"preset": "paper", "adaptive": adaptive}).generate(60, seed=seed)
    levels = material.recipe.steps[-1]["report"]["levels"]
    return {
        f"1/{2 ** level['level']}, {level['width']}^3": [
            round_["squares"] for round_ in level["energy"]
        ]
        for level in levels
    }

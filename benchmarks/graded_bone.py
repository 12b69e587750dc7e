"""Bone graded by four kinds of field: fractions, connectivity, and whether windows look as the
scan's windows of equal fraction do; how stiff it is, and whether it is new.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import trabecula as tb
from common import asked, busy, pictures, table
from descriptors import scans
from trabecula import fields
from trabecula.synth.api.model import Model
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.texture.final_shape import settle_shape
from trabecula.view.slices import montage

SHAPE = (96, 96, 128)
BONES = ("bone a", "bone b", "bone with cortex")
KINDS = ("ramp", "radial", "simp", "drawn")
FIGURES = ("thickness", "chord_length", "specific_surface", "anisotropy")
PART = (52, 96, 96)
SIDE = 96
ASKED = 0.165
"""Solid fraction of the windows whose stiffness is solved."""
SIZE, STEP = 20, 6
"""Windows of the fraction."""
WIDE, NEAR, ALIKE, LEAST = 40, 25, 0.04, 12
"""Windows of the other figures, voxels a side; each is held against the NEAR windows of the scan of
the nearest fraction, at most ALIKE away, where there are LEAST."""


def graded_bone_fields() -> None:
    """Three scans of bone, 96^3 of each, graded by a ramp, a radial field, a cantilever's density
    and a drawn one, 96 x 96 x 128; by `texture`, or by the methods of TRABECULA_BENCH_METHODS
    (`gan`: the shipped model of bone a).

    `frac`: fraction of windows of 20^3 less the field's mean in them, and of the whole. Of each
    figure: mean ratio of windows of 40^3 to the scan's windows of equal fraction, and the share of
    them within 2.6 standard deviations of those.
    """
    row = table("case", "frac mean", "frac max", "whole", "parts", *FIGURES, "seconds", wide=34)
    every = scans()
    for name in (bone for bone in BONES if bone in every):
        scan = every[name]
        exemplar, own = tb.crop(scan, 96), figures_of(np.asarray(scan.values), step=WIDE)
        held = fields.windowed(exemplar, size=SIZE, names=["volume_fraction"])["volume_fraction"]
        ends = [float(value) for value in np.quantile(held, [0.05, 0.95])]
        for method in asked("METHODS") or ["texture"]:
            model = model_of(method, name, exemplar)
            if model is None:
                continue
            low, high = within(model, *ends) if method == "gan" else ends
            model.generate((32, 32, 48), seed=1, target={"volume_fraction": 0.2})  # kernels
            shown = []
            for kind in KINDS:
                limits = (0.1, 0.3) if (name, kind) == (BONES[2], "radial") else (low, high)
                field = field_of(kind, *limits)
                request = tb.Request(SHAPE, seed=1, target={"volume_fraction": field})
                seconds, made = busy(lambda m=model, r=request: m.generate(r))
                off = errors(made.values, field)
                row(
                    f"{name}, {kind}, {method}",
                    f"{off.mean():.4f}",
                    f"{off.max():.4f}",
                    f"{made.values.mean() - field.mean(dtype=float):+.4f}",
                    tb.measure.components(made),
                    *beside(figures_of(np.asarray(made.values), step=28), own),
                    f"{seconds:.1f}",
                )
                shown.append(made.values[SHAPE[0] // 2])
            folder = pictures()
            if folder:
                sections = [tb.Image(values, "labels") for values in shown]
                label = f"graded-{name}-{method}".replace(" ", "-")
                tb.write(montage(sections, list(KINDS)), folder / f"{label}.png")


def graded_bone_stiffness() -> None:
    """Stiffness along x over the solid's, of windows of 64^3 with a solid fraction of .165: of two
    scans, and of what is graded from 96^3 by a ramp and by an even field, two seeds; by `texture`,
    or by the methods of TRABECULA_BENCH_METHODS.
    """
    row = table("case", "windows", "mean", "least", "most", wide=34)
    every = scans()
    for name in (bone for bone in BONES[:2] if bone in every):
        exemplar = tb.crop(every[name], 96)
        row(f"{name}, the scan", *stiffness_of(windows_at(every[name], 32)[:12]))
        held = fields.windowed(exemplar, size=SIZE, names=["volume_fraction"])["volume_fraction"]
        ends = [float(value) for value in np.quantile(held, [0.05, 0.95])]
        even = np.linspace(ASKED, ASKED + 1e-4, SHAPE[2]) + np.zeros(SHAPE)
        for method in asked("METHODS") or ["texture"]:
            model = model_of(method, name, exemplar)
            if model is None:
                continue
            low, high = within(model, *ends) if method == "gan" else ends
            for kind, field in (("ramp", field_of("ramp", low, high)), ("even", even)):
                target = {"volume_fraction": field.astype(np.float32)}
                made = [model.generate(SHAPE, seed=seed, target=target) for seed in (1, 2)]
                chosen = [window for one in made for window in windows_at(one, 16)[:4]]
                row(f"{name}, {kind}, {method}", *stiffness_of(chosen))


def graded_bone_moduli() -> None:
    """Stiffness of 96^3 over the solid's, mean of the three axes, at the exemplar's own fraction:
    of the exemplar, and of what is made from it without a target and with an even field of that
    fraction, new (the default) and by moved interfaces (`grading="feedback"`), two seeds each.
    """
    row = table("case", "exemplar", "no target", "even", "feedback", wide=24)
    every = {name: scan for name, scan in scans().items() if name in BONES}
    every["sample:bone"] = tb.sample("bone")
    for name, scan in every.items():
        exemplar = tb.crop(scan, SIDE)
        even = np.full((SIDE,) * 3, (np.asarray(exemplar.values) > 0).mean(), np.float32)
        target = {"volume_fraction": even}
        ways: list[tuple[dict[str, Any], dict[str, Any]]] = [
            ({}, {}),
            ({}, target),
            ({"grading": "feedback"}, target),
        ]
        found = []
        for settings, wanted in ways:
            model = tb.method("texture", **settings).fit(exemplar)
            made = [model.generate(SIDE, seed=seed, target=wanted) for seed in (1, 2)]
            found.append(", ".join(f"{_modulus(one):.4f}" for one in made))
        row(name, f"{_modulus(exemplar):.4f}", *found)


def _modulus(image: tb.Image) -> float:
    """Return the stiffness along an axis over the solid's, mean of three."""
    return float(np.diag(np.asarray(tb.measure.stiffness(image).matrix))[:3].mean())


def model_of(method: str, bone: str, exemplar: tb.Image) -> Model | None:
    """Return the model of a method for an exemplar; of `gan` the shipped one, where there is one of
    that bone.
    """
    if method != "gan":
        return tb.method(method).fit(exemplar)
    return tb.load_model("bone") if bone == BONES[0] else None


def within(model: Model, low: float, high: float) -> tuple[float, float]:
    """Return limits of a volume fraction within those of a model's porosities."""
    least, most = model.porosities() or (0.0, 1.0)
    return max(low, 1 - most), min(high, 1 - least)


def windows_at(image: tb.Image, step: int) -> list[tb.Image]:
    """Return windows of 64^3 whose solid fraction is within .012 of ASKED, the nearest along x at
    every place across it, in a random order.
    """
    solid, found = np.asarray(image.values) > 0, []
    for z, y in np.ndindex(*((side - 64) // step + 1 for side in solid.shape[:2])):
        column = solid[z * step : z * step + 64, y * step : y * step + 64]
        along = [column[..., x : x + 64] for x in range(0, solid.shape[2] - 63, 8)]
        nearest = min(along, key=lambda window: abs(window.mean() - ASKED))
        if abs(nearest.mean() - ASKED) < 0.012:
            found.append(tb.Image(np.ascontiguousarray(nearest, np.uint8), "labels"))
    np.random.default_rng(0).shuffle(found)
    return found


def stiffness_of(windows: list[tb.Image]) -> list[str]:
    """Return how many windows there are, and the mean, least and greatest stiffness along x."""
    each = [float(np.asarray(tb.measure.stiffness(one).matrix)[0, 0]) for one in windows]
    return [str(len(each)), *(f"{value:.4f}" for value in (np.mean(each), min(each), max(each)))]


def graded_bone_copies() -> None:
    """Graded bone and Berea beside what is new and what is copied: coherence with the exemplar,
    96^3, over 4 voxels, the same at half resolution, and the patches of 52 x 96 x 96 voxels.

    New is another part of the scan. Copied are the exemplar itself, its interfaces moved as those
    of a graded result are, and `novelty=0` without a target.
    """
    row = table("case", "over 4", "half", "patch, mean", "largest", wide=44)
    every = scans()
    for name in (scan for scan in (*BONES, "Berea") if scan in every):
        scan, exemplar = every[name], tb.crop(every[name], 96)
        beside_it = (scan.shape[0] - 96) // 2
        if beside_it >= PART[0]:
            other = tb.crop(scan, (PART[0], 96, 96), corner=(0, 0, 0))
            row(f"{name}, another part of the scan", *copying(exemplar, other))
        held = fields.windowed(exemplar, size=SIZE, names=["volume_fraction"])["volume_fraction"]
        low, high = (float(value) for value in np.quantile(held, [0.05, 0.95]))
        row(f"{name}, itself, interfaces moved", *copying(exemplar, moved(exemplar, low, high)))
        plain = tb.method("texture", novelty=0.0).fit(exemplar)
        row(f"{name}, novelty 0, no target", *copying(exemplar, plain.generate(96, seed=1)))
        model = tb.method("texture").fit(exemplar)
        for kind in ("ramp", "radial"):
            target = {"volume_fraction": field_of(kind, low, high)}
            made = model.generate(SHAPE, seed=1, target=target)
            row(f"{name}, graded, {kind}", *copying(exemplar, made))


def moved(image: tb.Image, low: float, high: float) -> tb.Image:
    """Return labels whose interfaces are moved as those of a graded result are, to a ramp."""
    inside = np.asarray(image.values) > 0
    votes = np.where(inside, 120, -120).astype(np.int16)[None] * np.int16(256)
    ramp = np.asarray(fields.ramp(image.shape, axis="x", start=low, end=high)).astype(np.float32)
    upper, _ = settle_shape(votes, Region(image.shape), ramp, None, unit=30.0)
    return tb.Image(upper.astype(np.uint8), "labels", phases=image.phases)


def copying(exemplar: tb.Image, image: tb.Image) -> list[str]:
    """Return coherence over 4 voxels, at full and at half resolution, and the voxels of patches."""
    whole = tb.measure.coherence(exemplar, image, k=(4,))[4]
    half = tb.measure.coherence(exemplar, image, k=(2,), half=True)[2]
    patches = tb.measure.coherent_patches(tb.measure.sources(exemplar, tb.crop(image, PART)))
    return [f"{whole:.3f}", f"{half:.2f}", f"{patches.mean:.0f}", str(patches.largest)]


def field_of(kind: str, low: float, high: float) -> np.ndarray:
    """Return a field of volume fractions between two limits, of `SHAPE`."""
    _, y, x = np.indices(SHAPE)
    if kind == "ramp":
        return np.asarray(fields.ramp(SHAPE, axis="x", start=low, end=high))
    if kind == "simp":
        density = fields.rescale(fields.simp("cantilever", low=0.3, high=0.85), low=low, high=high)
        return np.asarray(fields.resample(density, SHAPE))
    if kind == "radial":
        middle = [(side - 1) / 2 for side in SHAPE]
        share = np.hypot(y - middle[1], x - middle[2]) / (min(SHAPE[1:]) / 2)
    else:  # drawn: two dense places
        share = np.exp(-((y - 30) ** 2 + (x - 35) ** 2) / 648)
        share += np.exp(-((y - 65) ** 2 + (x - 95) ** 2) / 968)
    return (low + (high - low) * np.clip(share, 0, 1)).astype(np.float32)


def errors(values: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Return differences of the fraction of windows from the field's mean in them."""
    means = []
    for part in (np.asarray(values) > 0, field):
        sums = np.pad(part.astype(np.float64), ((1, 0),) * 3)
        for axis in range(3):
            sums = sums.cumsum(axis)
            sums = sums.take(np.arange(SIZE, sums.shape[axis]), axis) - sums.take(
                np.arange(sums.shape[axis] - SIZE), axis
            )
        means.append(sums[::STEP, ::STEP, ::STEP] / SIZE**3)
    return np.abs(means[0] - means[1])


def figures_of(values: np.ndarray, *, step: int) -> np.ndarray:
    """Return the fraction and `FIGURES` of windows, (n, 5)."""
    found = []
    for place in np.ndindex(tuple((side - WIDE) // step + 1 for side in values.shape)):
        box = tuple(slice(at * step, at * step + WIDE) for at in place)
        window = tb.Image(np.ascontiguousarray(values[box] > 0).astype(np.uint8), "labels")
        fraction = float(window.values.mean())
        if not 0.01 < fraction < 0.99:
            continue
        found.append([fraction, *(_mean(getattr(tb.measure, name)(window)) for name in FIGURES)])
    return np.array(found)


def _mean(value: Any) -> float:
    """Return the mean of a figure that may be one a direction."""
    return float(np.mean(list(value.values()) if isinstance(value, dict) else value))


def beside(made: np.ndarray, own: np.ndarray) -> list[str]:
    """Return, of every figure, the mean ratio to the scan's windows of equal fraction and the share
    of windows in their band.
    """
    cells = []
    for column in range(1, made.shape[1]):
        ratios, inside = [], []
        for window in made:
            apart = np.abs(own[:, 0] - window[0])
            near = own[np.argsort(apart)[:NEAR]]
            near = near[np.abs(near[:, 0] - window[0]) < ALIKE, column]
            if len(near) < LEAST:
                continue
            reach = 2.6 * near.std(ddof=1) * np.sqrt(1 + 1 / len(near))
            ratios.append(window[column] / near.mean())
            inside.append(abs(window[column] - near.mean()) <= reach)
        cells.append(f"{np.mean(ratios):.2f} ({np.mean(inside):.2f})" if ratios else "-")
    return cells

"""One slice of a scan, and what only a volume shows: `kopf` from the slice's planes, and as the
process that the slice resembles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

import trabecula as tb
from common import busy, table
from image import draw, side_of
from image_truth import Truth, chosen_scans, curves, figures

SCANS = ("Berea", "NMC", "bone a", "cement, Otsu", "soil, Otsu", "cathode, coarse")
VARIANTS: Mapping[str, Mapping[str, str]] = {
    "planes": {},
    "process": {"process": "auto"},
    "at the scan's porosity": {"process": "auto"},
}
SEEDS = 3
ERRORS = ("S2 radial", "axis", "diagonal")
NAMES = ("Euler", "largest pore", "largest solid", "thickness", "pore size", "surface", "k")
BOUNDS = {"Euler": 1.5, "thickness": 1.1, "pore size": 1.1, "surface": 1.1, "k": 1.3}
"""Factors that a figure may differ from the scan's by; `largest pore` by .05."""


def image_processes() -> None:
    """96^3 from the middle slice across each axis, three seeds, with `kopf` from planes, with
    `process=auto`, and with that and the scan's porosity as target: medians over the seeds of a
    slice and over all volumes of a scan, beside the scan's (mean of its corners of 96^3); of how
    many volumes each figure is near the scan's.

    S2 is the covariance's error, relative l2 over r = 0 .. 32: radial, the worst axis, the
    diagonals. Euler is per 1e6 voxels, k in voxels^2 of the centre 64^3, mean of the axes. Near:
    Euler number within a factor of 1.5, permeability 1.3, thickness, pore size and surface 1.1;
    the largest pore within .05. A permeability of 0 is near where the scan's is below .001.
    """
    side, seeds = side_of(96), range(SEEDS)
    row = table("scan, slice, by", *ERRORS, *NAMES, "s", wide=44)
    near = {variant: dict.fromkeys(("largest pore", *BOUNDS), 0) for variant in VARIANTS}
    chosen = chosen_scans(SCANS)
    for name, scan in chosen.items():
        plain = tb.Image(scan.values, "labels", phases=scan.phases)
        truth = Truth.of(plain, side)
        targets = {"at the scan's porosity": {"porosity": tb.measure.porosity(plain)}}
        boxes = [_figures(box) for box in _corners(plain, side)]
        scanned = {key: float(np.mean([box[key] for box in boxes])) for key in NAMES}
        row(f"{name}: the scan", *["-"] * 3, *(f"{scanned[key]:.4g}" for key in NAMES), "-")
        every: dict[str, list[dict[str, float]]] = {variant: [] for variant in VARIANTS}
        for axis in range(3):
            values = np.ascontiguousarray(plain.values.take(plain.shape[axis] // 2, axis))
            picture = tb.Image(values, "labels", phases=plain.phases)
            volumes = {}
            for variant, settings in VARIANTS.items():
                found = []
                for seed in seeds:
                    model = tb.method("kopf", **settings).fit(picture)
                    target = targets.get(variant, {})
                    seconds, made = busy(
                        lambda m=model, s=seed, t=target: m.generate(side, seed=s, target=t)
                    )
                    errors = dict(zip(ERRORS, truth.errors(curves(made)), strict=True))
                    found.append({**errors, **_figures(made), "s": seconds})
                    volumes.setdefault(variant, made)
                words = f"{name}, {'zyx'[axis]}: {_told(made, variant)}"
                row(words, *_medians(found))
                every[variant] += found
            draw(f"process {name} {'zyx'[axis]}", [picture], volumes)
        for variant, found in every.items():
            row(f"{name}: {variant}, median", *_medians(found))
            for key in near[variant]:
                near[variant][key] += sum(_is_near(key, one[key], scanned[key]) for one in found)
    count = 3 * SEEDS * len(chosen)
    for variant, numbers in near.items():
        told = ", ".join(f"{key} {number}" for key, number in numbers.items())
        print(f"{variant}: near the scan's, of {count}: {told}")


def _medians(found: Sequence[Mapping[str, float]]) -> list[str]:
    return [f"{np.median([one[key] for one in found]):.4g}" for key in (*ERRORS, *NAMES, "s")]


def _corners(scan: tb.Image, side: int) -> list[tb.Image]:
    sides = [min(side, have) for have in scan.shape]
    ends = [sorted({0, have - own}) for have, own in zip(scan.shape, sides, strict=True)]
    return [tb.crop(scan, sides, corner=corner) for corner in product(*ends)]


def _figures(image: tb.Image) -> dict[str, float]:
    return {**figures(image), "surface": tb.measure.specific_surface(image)}


def _told(made: tb.Image, variant: str) -> str:
    report = made.recipe.steps[-1].get("report", {}).get("like", {})
    if "process" not in report:
        return "planes" if variant == "planes" else "planes (no process)"
    return f"{report['process']} {report['distances'][report['process']]:.2f}"


def _is_near(name: str, have: float, want: float) -> bool:
    if name == "largest pore":
        return abs(have - want) <= 0.05
    if name == "k" and want < 1e-3:
        return have < 1e-3
    return have * want > 0 and abs(math.log(have / want)) <= math.log(BOUNDS[name])

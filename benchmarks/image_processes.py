"""One slice of a scan, and what only a volume shows: `kopf` from the slice's planes, and as the
process that the slice resembles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product

import numpy as np

import trabecula as tb
from common import asked, busy, table
from descriptors import scans
from image import draw, side_of
from image_truth import Truth, curves, figures
from trabecula.core.checks import check_name

SCANS = ("Berea", "NMC", "bone a", "cement, Otsu", "soil, Otsu", "cathode, coarse")
VARIANTS: Mapping[str, Mapping[str, str]] = {
    "planes": {},
    "process": {"process": "auto"},
}
NAMES = ("Euler", "largest pore", "largest solid", "thickness", "pore size", "surface", "k")
BOUNDS = {"Euler": 1.5, "thickness": 1.1, "pore size": 1.1, "surface": 1.1, "k": 1.3}
"""Factors that a figure may differ from the scan's by; `largest pore` by .05."""


def image_processes() -> None:
    """96^3 from the middle slice across each axis, seed 0, with `kopf` from planes and
    `process=auto`: figures of the volume, those of the scan (mean of its eight corners of 96^3)
    above them, and of how many slices each is near the scan's.

    S2 is the covariance's error, relative l2 over r = 0 .. 32: radial, the worst axis, the
    diagonals. Euler is per 1e6 voxels, k in voxels^2 of the centre 64^3, mean of the axes. Near:
    Euler number within a factor of 1.5, permeability 1.3, thickness, pore size and surface 1.1;
    the largest pore within .05. A permeability of 0 is near where the scan's is below .001.
    """
    side = side_of(96)
    row = table("scan, slice, by", "S2 radial", "axis", "diagonal", *NAMES, "s", wide=44)
    near: dict[str, dict[str, int]] = {variant: {} for variant in VARIANTS}
    for name, scan in _chosen().items():
        plain = tb.Image(scan.values, "labels", phases=scan.phases)
        truth = Truth.of(plain, side)
        boxes = [_figures(box) for box in _corners(plain, side)]
        scanned = {key: float(np.mean([box[key] for box in boxes])) for key in NAMES}
        row(f"{name}: the scan", *["-"] * 3, *(f"{scanned[key]:.4g}" for key in NAMES), "-")
        for axis in range(3):
            values = np.ascontiguousarray(plain.values.take(plain.shape[axis] // 2, axis))
            picture = tb.Image(values, "labels", phases=plain.phases)
            volumes = {}
            for variant, settings in VARIANTS.items():
                model = tb.method("kopf", **settings).fit(picture)
                seconds, made = busy(lambda m=model: m.generate(side, seed=0))
                volumes[variant], found = made, _figures(made)
                errors = [f"{error:.3f}" for error in truth.errors(curves(made))]
                told = [f"{found[key]:.4g}" for key in NAMES]
                words = f"{name}, {'zyx'[axis]}: {_told(made, variant)}"
                row(words, *errors, *told, f"{seconds:.1f}")
                for key in ("largest pore", *BOUNDS):
                    near[variant].setdefault(key, 0)
                    near[variant][key] += _is_near(key, found[key], scanned[key])
            draw(f"process {name} {'zyx'[axis]}", [picture], volumes)
    count = 3 * len(_chosen())
    for variant, numbers in near.items():
        told = ", ".join(f"{key} {number}" for key, number in numbers.items())
        print(f"{variant}: near the scan's, of {count}: {told}")


def _chosen() -> dict[str, tb.Image]:
    found = scans()
    for name in asked("ONLY"):
        check_name(name, found, name="scan")
    wanted = asked("ONLY") or SCANS
    return {name: found[name] for name in wanted if name in found} or dict(list(found.items())[:1])


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

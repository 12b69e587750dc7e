"""`gan`: the models that come with the package, the paper's table 1 at a small width, and seconds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, busy, pictures, table, tell
from descriptors import GREY, LABELS
from trabecula.models import shipped
from trabecula.view.slices import montage

SAMPLES = 10
SIDE = 120
BOX = 64
"""Permeability is solved in a centre box of so many voxels a side, of a few samples."""

LEARNT_FROM = {"bone": "bone a", "berea": "Berea", "nmc": "NMC", "cement": "cement"}
TABLE_1 = {
    "3dgan": (1.51, 5.95, "40/17"),
    "patchgan": (1.49, 5.83, "30/23"),
    "gram": (1.16, 5.79, "26/19"),
    "structural": (0.71, 3.27, "8/5"),
    "all": (0.59, 3.05, "6/3"),
}
"""The paper's Bone_0, means of 10 samples: porosity error in percent, D2 (not of this package's scale), components / floating."""

NARROW = {"width": 4, "batch": 4, "latent": 16}
"""Of the paper's networks, for a processor; the paper's: 64, 100, 100."""

_SHORT = (
    "porosity_error",
    "two_point_distance",
    "two_point_relative",
    "components",
    "largest_fraction",
    "specific_surface",
    "euler_density",
)


def exemplar(name: str) -> tb.Image | None:
    """The scan that a shipped model was learnt from, where it is here."""
    scan = LEARNT_FROM.get(name, "")
    file, edge, unit = {**LABELS, **GREY}.get(scan, ("", 1.0, "voxel"))
    return tb.read(SCANS / file, spacing=edge, unit=unit) if file and SCANS.is_dir() else None


def models() -> None:
    """Shipped models, 10 samples of 120^3 each: figures beside the exemplar's and the real band; diversity; permeability."""
    for name in shipped():
        scan = exemplar(name)
        if scan is None:
            continue
        model = tb.load_model(name)
        samples = [model.generate(SIDE, seed=seed) for seed in range(SAMPLES)]
        tell(f"\n{name}", f"{SAMPLES} samples of {SIDE}^3")
        _certified(scan, samples)
        if scan.kind == "labels":
            found, apart = tb.measure.diversity(samples[:4]), ~np.eye(4, dtype=bool)
            tell(
                "diversity", f"distance {found.distance[apart].min():.3f}", f"copied {found.coherence[apart].max():.3f}"
            )
            for what, image in (("exemplar", scan), *((f"seed {i}", sample) for i, sample in enumerate(samples[:3]))):
                physics = tb.measure.describe_physics(image, box=BOX)
                tell(what, "permeability", {axis: f"{value:.4g}" for axis, value in physics["permeability"].items()})
        _drawn(name, scan, samples)


def speed() -> None:
    """Seconds of the processor that a shipped model takes for 120^3, 200^3 and 420^3, one thread."""
    for name in shipped():
        model = tb.load_model(name)
        model.generate(64, seed=0)
        for side in (SIDE, 200, 420):
            seconds, made = busy(lambda m=model, n=side: m.generate(n, seed=1))
            tell(name, f"{side}^3", f"{seconds:.2f} s", f"{1e9 * seconds / made.values.size:.0f} ns a voxel")


def ablation() -> None:
    """Table 1 of the paper at width 4, equal time: TRABECULA_BENCH_MINUTES each (2), bone and Berea, beside compact."""
    minutes = float(os.environ.get("TRABECULA_BENCH_MINUTES", "2"))
    for name in ("bone", "berea"):
        scan = exemplar(name)
        if scan is None:
            continue
        scan = tb.crop(scan, 100)
        row = table(name, "iterations", *_SHORT, "paper", wide=12)
        for preset, paper in {**TABLE_1, "compact": None}.items():
            settings: dict[str, Any] = {"minutes": minutes, "iterations": 0, "looks": 1}
            settings |= {} if preset == "compact" else NARROW
            model = tb.method("gan", preset=preset, **settings).fit(scan)
            made = [model.generate(96, seed=seed) for seed in range(3)]
            certificates = tb.verify(scan, *made, level="quick")
            means = [f"{_mean(certificates, key):.4g}" for key in _SHORT]
            row(preset, model.history["iterations"], *means, "" if paper is None else " ".join(map(str, paper)))


def smoke() -> None:
    """200 iterations of the paper's whole loss on networks of width 2: losses fall, nothing is infinite, seconds each."""
    scan = exemplar("bone") or tb.sample("bone")
    settings = {**NARROW, "width": 2, "batch": 2, "iterations": 200, "looks": 4, "device": "cpu"}
    for reading in ("deconvolution", "deconvolution+conv"):
        method = tb.method("gan", preset="paper", generator=reading, **settings)
        seconds, model = busy(lambda m=method: m.fit(tb.crop(scan, 100)))
        tell(reading, f"{seconds / 200:.2f} s an iteration", model.history["figures"])


def _certified(scan: tb.Image, samples: Sequence[tb.Image]) -> None:
    certificates = tb.verify(scan, *samples)
    row = table("figure", "exemplar", "band", "mean", "least", "most", "passed", wide=22)
    for key, metric in certificates[0].metrics.items():
        values = [one.metrics[key].value for one in certificates]
        if not all(isinstance(value, (int, float, np.number)) for value in values):
            continue
        band = "" if metric.real_band is None else f"{metric.real_band[0]:.4g} .. {metric.real_band[1]:.4g}"
        passed = sum(bool(one.metrics[key].passed) for one in certificates)
        there = "" if metric.exemplar is None else f"{float(metric.exemplar):.4g}"
        row(key, there, band, *(f"{value:.4g}" for value in (np.mean(values), min(values), max(values))), passed)


def _mean(certificates: Sequence[Any], key: str) -> float:
    return float(np.mean([one.metrics[key].value for one in certificates]))


def _drawn(name: str, scan: tb.Image, samples: Sequence[tb.Image]) -> None:
    """The exemplar's middle slices below those of three samples."""
    folder = pictures()
    if folder is None:
        return
    titles = ["exemplar", *(f"seed {seed}" for seed in range(3))]
    montage([tb.crop(scan, SIDE), *samples[:3]], titles, folder / f"gan-{name}.png")

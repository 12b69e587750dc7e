"""Figure 13 of the paper in small: the weights of the gram and of the structural loss from .01 to
10, as means and as the sums that the paper prints.
"""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import trabecula as tb
from common import asked, busy, table, tell
from gan import exemplar
from trabecula.core.errors import TrainingError

WEIGHTS = (0.01, 0.1, 1.0, 10.0)
SIDE, SAMPLES, REACH = 64, 3, 30

SMALL: dict[str, Any] = {
    "discriminator": "score",
    "adversarial": "standard",
    "penalty": 0.0,
    "sliced": 0.0,
    "warmup": 0.2,
    "width": 8,
    "crop": 32,
    "batch": 2,
    "specks": 0,
    "minutes": 0,
    "looks": 4,
    "device": "cpu",
}
"""The paper's discriminator and losses at an eighth of its width before the generator and the
warm-up of `compact`, on crops of 32^3."""


def gan_weights() -> None:
    """Figure 13 at width 8 and TRABECULA_BENCH_ITERATIONS (120): porosity error, D2 and gradient
    shares for each weight, as means and as sums; `--only bone` or `berea`.
    """
    iterations = int(os.environ.get("TRABECULA_BENCH_ITERATIONS", "120"))
    name = (asked("ONLY") or ["bone"])[0]
    scan = exemplar(name) or tb.sample("bone")
    learnt = tb.crop(scan, min(100, *scan.shape), corner=(0, 0, 0))
    heads = ("porosity error %", "D2", "largest", "share of the gradient", "s")
    row = table(f"{name}: loss, reduction, weight", *heads, wide=34)
    row("adversarial only", *_cells(learnt, {}, "", iterations))
    for loss in ("gram", "structural"):
        for reduction in ("mean", "sum"):
            for weight in WEIGHTS:
                settings = {loss: weight, "reduction": reduction}
                cells = _cells(learnt, settings, loss, iterations)
                row(f"{loss}, {reduction}, {weight:g}", *cells)


def _cells(learnt: tb.Image, more: Mapping[str, Any], loss: str, iterations: int) -> list[str]:
    """Train once, and measure samples against the exemplar."""
    shares: list[float] = []
    method = tb.method("gan", **SMALL, **more, iterations=iterations)
    try:
        seconds, model = busy(lambda: _fit(method, learnt, shares, f"{loss}_share"))
    except TrainingError as error:
        tell(error)
        return ["", "", "", "failed", ""]
    made = [model.generate(SIDE, seed=seed) for seed in range(SAMPLES)]
    own = tb.measure.two_point(learnt, r_max=REACH)[1:]
    curves = [tb.measure.two_point(one, r_max=REACH)[1:] for one in made]
    distances = [np.linalg.norm(one - own) / np.linalg.norm(own) for one in curves]
    porosity = np.mean([tb.measure.porosity(one) for one in made])
    error = abs(porosity / tb.measure.porosity(learnt) - 1)
    largest = np.mean([tb.measure.largest_fraction(one) for one in made])
    share = f"{np.median(shares):.3g}" if shares else "-"
    return [
        f"{100 * error:.2f}",
        f"{100 * float(np.mean(distances)):.1f}",
        f"{largest:.3f}",
        share,
        f"{seconds:.0f}",
    ]


def _fit(method: Any, learnt: tb.Image, shares: list[float], name: str) -> Any:
    """Train, and collect the shares of the gradient at the evaluations."""
    with tempfile.TemporaryDirectory() as folder:
        settings = {**vars(method.config), "run": folder}
        model = tb.method("gan", **settings).fit(learnt)
        with (Path(folder) / "metrics.csv").open() as stream:
            shares += [float(row[name]) for row in csv.DictReader(stream) if row.get(name)]
    return model

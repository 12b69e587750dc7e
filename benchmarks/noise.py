"""`noise`: seconds, memory and porosity of every kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import trabecula as tb
from common import busy, table, unit
from trabecula.synth.noise.pattern import trial_level
from trabecula.testing.peak import peak_bytes

POROSITY = 0.6
LENGTH = 10.0

CASES: dict[str, Mapping[str, Any]] = {
    "white": {"kind": "white"},
    "perlin": {"kind": "perlin", "length": LENGTH},
    "perlin, 3 octaves": {"kind": "perlin", "length": LENGTH, "octaves": 3},
    "worley": {"kind": "worley", "length": LENGTH},
    "voronoi": {"kind": "voronoi", "length": LENGTH},
    "voronoi, 20 voxels": {"kind": "voronoi", "length": 2 * LENGTH},
    "voronoi_edges": {"kind": "voronoi_edges", "length": LENGTH},
    "voronoi_cells": {"kind": "voronoi_cells", "length": LENGTH},
    "gaussian": {"length": LENGTH},
    "exponential": {"covariance": "exponential", "length": LENGTH},
}


def noise() -> None:
    """256^3 of every kind at cells or lengths of 10 voxels, porosity 0.6 asked for, one thread,
    kernels compiled, best of two.

    Seconds are the processor's; `fit` holds the trial that finds the level of a pattern. `bytes`
    are those held at most per voxel of a 256^3, beyond it. `porosity` is that of eight windows with
    cells of 3.3 voxels (of several octaves in the last), 96^3 each: mean and
    spread. The last row is the covariance of a scan of 96^3, followed as far as 40 voxels.
    """
    base = unit()
    row = table(
        f"kind (unit {base:.3f} s)",
        "fit s",
        "make s",
        "/ unit",
        "bytes",
        "porosity",
        "spread",
        wide=24,
    )
    for name, settings in CASES.items():
        model = _model(settings)
        fine = (
            {}
            if settings.get("kind") == "white"
            else {"length": 3.3 * 2 ** (settings.get("octaves", 1) - 1)}
        )
        made, spread = _windows({**settings, **fine})
        row(name, *_cost(lambda s=settings: _model(s), model, base), made, spread)
    bone = tb.sample("bone")
    model = tb.method("noise").fit(bone)
    row("the scan's covariance", *_cost(lambda: tb.method("noise").fit(bone), model, base), "", "")


def _model(settings: Mapping[str, Any]) -> Any:
    model = tb.method("noise", **{"porosity": POROSITY, **settings}).fit()
    model.window(8, [(0, 2)] * 3)
    return model


def _cost(fit: Any, model: Any, base: float) -> tuple[str, ...]:
    model.generate(24, seed=0)
    trial_level.cache_clear()
    learn = busy(fit)[0]
    make = min(busy(lambda: model.generate(256, seed=0))[0] for _ in range(2))
    held = peak_bytes(lambda: model.generate(256, seed=0)) / 256**3 - 1
    return f"{learn:.2f}", f"{make:.2f}", f"{make / base:.0f}", f"{held:.1f}"


def _windows(settings: Mapping[str, Any]) -> tuple[str, str]:
    model = _model(settings)
    shares = [
        1 - model.window(96, [(500 * i, 500 * i + 96), (0, 96), (0, 96)], seed=1).mean()
        for i in range(8)
    ]
    return f"{np.mean(shares):.4f}", f"{np.std(shares):.4f}"

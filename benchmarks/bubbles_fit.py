"""`bubbles`: settings found for scans and pictures, and how near they come, beside methods that
learn by example.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, busy, pictures, table, tell
from trabecula.report.plot import curve_plot, hatching
from trabecula.synth.bubbles.fit_objective import (
    MaterialDescriptors,
    descriptors_of,
    reduce_exemplar,
)
from trabecula.view.slices import slices

PARTS = ("pore_size", "thickness", "anisotropy", "porosity", "total")
METRICS = (
    "porosity",
    "pore_size",
    "thickness",
    "anisotropy",
    "two_point_covariance",
    "euler_density",
    "floating",
)


def _cement() -> tb.Image:
    """Air voids of cement: dark on grey."""
    return tb.crop(tb.segment(tb.read(SCANS / "cement_air_voids.tif")), 100)


def _bread() -> tb.Image:
    """A photograph of a slice of bread; what is dark is taken for holes."""
    colours = tb.read(SCANS / "bread_baguette2.png")
    grey = colours.values.astype(np.float32).mean(axis=-1)
    return tb.segment(tb.Image(grey, "grey", colours.spacing, colours.unit))


EXEMPLARS: dict[str, Callable[[], tb.Image]] = {"cement": _cement, "bread": _bread}


def bubbles_fit() -> None:
    """Air voids of cement (100^3) and a slice of bread (380^2): distances at the first guess,
    found, and for three new seeds.

    Distances are those of the search (fit_objective.py); below them figures of the certificate of
    results of the settings, of the exemplar's covariance and of its patches. With
    TRABECULA_BENCH_OUT named, plots of the distributions, and slices.
    """
    if not SCANS.is_dir():
        tell("the folder of scans is not here")
        return
    for name, read in EXEMPLARS.items():
        exemplar = read()
        seconds, model = busy(lambda e=exemplar: tb.method("bubbles").fit(e))
        row = table(f"{name}, {seconds:.0f} s", *PARTS)
        for label in ("start", "end"):
            row(label, *(f"{model.report[label][part]:.3f}" for part in PARTS))
        row(
            "new seeds",
            *(f"{np.mean([one[part] for one in model.report['checks']]):.3f}" for part in PARTS),
        )
        tell(", ".join(f"{key}={value}" for key, value in model.report["found"].items()))
        made = model.generate(exemplar.shape, seed=7)
        _beside(exemplar, made)
        _draw(name, exemplar, made, model.report)


def _beside(exemplar: tb.Image, made: tb.Image) -> None:
    """Figures of the certificate, of the exemplar and of what methods make of it."""
    others = {
        "bubbles": made,
        "noise": tb.method("noise").fit(exemplar).generate(exemplar.shape, seed=7),
    }
    if exemplar.ndim == 3:
        others["texture"] = (
            tb.method("texture", preset="fast").fit(exemplar).generate(exemplar.shape, seed=7)
        )
    certificates = tb.verify(exemplar, *others.values(), names=list(others), r_max=30)
    row = table("certificate", *others, "band")
    for metric in METRICS:
        if metric in certificates[0].metrics:
            found = [certificate.metrics[metric] for certificate in certificates]
            band = found[0].real_band
            row(
                metric,
                *(_number(one.value) for one in found),
                "" if band is None else f"{band[0]:.3g}..{band[1]:.3g}",
            )


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _draw(name: str, exemplar: tb.Image, made: tb.Image, report: dict[str, Any]) -> None:
    """Distributions of the exemplar and the fit, the course of the search, and a sheet of both."""
    folder = pictures()
    if folder is None:
        return
    seen = reduce_exemplar(exemplar)
    fit = descriptors_of(reduce_exemplar(made).image)
    plots = [
        _distribution("pore size", seen.measured, fit, "pores", exemplar.unit),
        _distribution("thickness of what is between", seen.measured, fit, "walls", exemplar.unit),
        curve_plot({"least distance": np.array(report["trace"])}, title="search", x_label="trials"),
    ]
    (folder / f"bubbles_fit_{name}.html").write_text(
        "<body>" + hatching() + "".join(plots), encoding="utf-8"
    )
    for label, image in (("exemplar", exemplar), ("fit", made)):
        slices(image, Path(folder) / f"bubbles_fit_{name}_{label}.png")


def _distribution(
    title: str, seen: MaterialDescriptors, fit: MaterialDescriptors | None, of: str, unit: str
) -> str:
    """The share of voxels in larger spheres than so many units."""
    curves = {"exemplar": getattr(seen, of), "fit": getattr(fit, of)}
    step = max(curve.max() for curve in curves.values()) / 100
    above = {
        key: np.array([(curve > step * n).mean() for n in range(102)])
        for key, curve in curves.items()
    }
    return curve_plot(above, title=title, x_label=f"diameter ({unit})", step=step)

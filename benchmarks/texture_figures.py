"""Figures 5, 8 and 12 of Zhang, Chen, Wang, Wang (2017) at their size, with `texture` and the two
methods that it is compared with.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import trabecula as tb
from by_example import SIDE, figures, middle_slices
from common import SCANS, busy, pictures, table
from descriptors import GREY
from texture import SEEDS, chosen_exemplars, fitted
from trabecula.view.slices import montage

PAPER_MINUTES = {"with": 20, "without": 30}
"""Section 5.1: 120^3 from 60^3, with and without adaptive weights."""

SMALL = 64
"""Edge of what is made for the histogram, which does not depend on it."""

BINS = 10
"""Section 5.3.2: of 25 grey levels each."""


def texture_weights() -> None:
    """Figures 5 and 8: 120^3 from 60^3 of bone by the paper's preset, with adaptive weights and
    without, three seeds.

    `rounds` are those of all levels and widths; the paper converges in ten less with the weights,
    in 20 minutes for 30.
    """
    heads = ("rounds", "porosity error %", "D2", "N_cc", "largest", "thickness", "Euler", "s")
    row = table("weights, seed", *heads, wide=24)
    name, exemplar = next(iter(chosen_exemplars("bone a", "sample bone").items()))
    shown = {name: exemplar}
    for label, adaptive in (("with", True), ("without", False)):
        for seed in SEEDS:
            model = fitted(exemplar, {"preset": "paper", "adaptive": adaptive})
            seconds, image = busy(lambda m=model, s=seed: m.generate(SIDE, seed=s))
            levels = image.recipe.steps[-1]["report"]["levels"]
            found = figures(exemplar, image)
            row(
                f"{label}, {seed}",
                sum(len(level["energy"]) for level in levels),
                f"{found.error:.2f}",
                f"{found.distance:.1f}",
                found.components,
                f"{found.largest:.4f}",
                f"{found.thickness:.2f}",
                f"{found.euler:.2f}",
                f"{seconds:.1f}",
            )
            shown.setdefault(f"{label} weights", image)
    if folder := pictures():
        montage(list(shown.values()), list(shown), folder / "texture-weights.png")


def texture_iso_value() -> None:
    """The paper's preset cut at the exemplar's own iso-value, as the paper has it: 120^3 from 60^3
    of bone and foam, one seed.
    """
    row = table("exemplar, seed", "porosity error %", "D2", "N_cc", "largest", "s", wide=24)
    for name, exemplar in chosen_exemplars("bone a", "sample foam").items():
        model = fitted(exemplar, {"preset": "paper", "iso_value": "middle"})
        for seed in SEEDS[:1]:
            seconds, image = busy(lambda m=model, s=seed: m.generate(SIDE, seed=s))
            found = figures(exemplar, image)
            row(
                f"{name}, {seed}",
                f"{found.error:.2f}",
                f"{found.distance:.1f}",
                found.components,
                f"{found.largest:.4f}",
                f"{seconds:.1f}",
            )


def texture_histogram() -> None:
    """Figure 12: the grey values of a bone of 60^3 and of 64^3 made from it, in ten bins.

    `off` is half the sum of the differences: the share of voxels in the wrong bin.
    """
    name = "grey bone"
    file, edge, unit = GREY[name]
    if not (SCANS / file).is_file():
        print("(no grey scan here: left out)")
        return
    exemplar = tb.crop(tb.read(SCANS / file, spacing=edge, unit=unit), 60)
    row = table("made by", "off", *(f"bin {number}" for number in range(1, BINS + 1)), "s", wide=16)
    own = _bins(exemplar)
    row("exemplar", "0", *(f"{share:.3f}" for share in own), "")
    ways: dict[str, tuple[str, dict[str, Any], bool]] = {
        "texture, paper": ("texture", {"preset": "paper"}, False),
        "texture": ("texture", {}, False),
        "kopf, paper": ("kopf", {"preset": "paper"}, True),
        "chen, paper": ("chen", {"preset": "paper"}, True),
    }
    shown = {"exemplar": exemplar}
    for words, (method, settings, flat) in ways.items():
        model = tb.method(method, **settings).fit(middle_slices(exemplar) if flat else exemplar)
        seconds, image = busy(lambda m=model: m.generate(SMALL, seed=0))
        shares = _bins(image)
        off = f"{np.abs(shares - own).sum() / 2:.4f}"
        row(words, off, *(f"{share:.3f}" for share in shares), f"{seconds:.1f}")
        shown[words] = image
    if folder := pictures():
        montage(list(shown.values()), list(shown), folder / "texture-histogram.png")


def _bins(image: tb.Image) -> np.ndarray:
    """Return the share of the voxels in each bin of 25 grey levels, the last of 31."""
    levels = np.minimum(np.asarray(image.values).astype(int) // 25, BINS - 1)
    return np.bincount(levels.ravel(), minlength=BINS) / levels.size

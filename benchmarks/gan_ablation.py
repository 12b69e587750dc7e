"""Tables 1 to 3 of the paper on what trains on a processor: the losses that the discriminator's
features offer, at equal processor time.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

import trabecula as tb
from by_example import Figures, figures
from common import asked, busy, pictures, table, tell
from descriptors import scans
from gan import exemplar
from trabecula.core.errors import TrainingError
from trabecula.synth.gan.config import GanConfig
from trabecula.view.slices import montage

LEARNT = 100
"""Edge of the exemplar, voxels, as the paper's: a corner of the scan."""

SIDE = 96
"""Edge of what is made, and of the other corners of the scan, which share no voxel with the
exemplar.
"""

SAMPLES = 5
_TURNS = 10

_SCORE: dict[str, Any] = {
    "discriminator": "score",
    "sliced": 0.0,
    "crop": 32,
    "batch": 4,
    "specks": 0,
}

VARIANTS: dict[str, tuple[dict[str, Any], str]] = {
    "adversarial only": (_SCORE, "1.51 5.95 40/17"),
    "PatchGAN": ({**_SCORE, "discriminator": "patch"}, "1.49 5.83 30/23"),
    "+ gram": ({**_SCORE, "gram": 0.1}, "1.16 5.79 26/19"),
    "+ structural": ({**_SCORE, "structural": 1.0}, "0.71 3.27 8/5"),
    "all": ({**_SCORE, "gram": 0.1, "structural": 1.0}, "0.59 3.05 6/3"),
}
"""Settings beside those of `compact`, and what the paper has for its Bone_0: porosity error in
percent, D2 (not of this package's scale), components / floating. The paper's discriminators at
width 16; generator, warm-up, relativistic loss and schedule of `compact`, crops of 32^3, and no
sliced distributions after the warm-up."""

PAIRED = ("adversarial only", "+ gram", "all")
"""What tables 2 and 3 compare: the baseline, the paper's without its structural loss, and with."""

MATERIALS = (
    "bone a",
    "bone b",
    "bone with cortex",
    "grey bone, Otsu",
    "sample:bone",
    "Berea",
    "NMC",
    "soil, Otsu",
)
"""Five bones and three other materials, as tables 2 and 3 have."""

_FIGURES = (
    "porosity_error",
    "two_point_distance",
    "two_point_relative",
    "components",
    "largest_fraction",
    "specific_surface",
    "euler_density",
)


def ablation() -> None:
    """Table 1 of the paper at compact width, bone and Berea: TRABECULA_BENCH_ITERATIONS (1000), or
    fewer of what is dearer; `--only bone` takes one of them.
    """
    most = int(os.environ.get("TRABECULA_BENCH_ITERATIONS", "1000"))
    for name in asked("ONLY") or ("bone", "berea"):
        scan = exemplar(name)
        if scan is None:
            continue
        learnt = tb.crop(scan, LEARNT, corner=(0, 0, 0))
        costs = _costs(learnt, list(VARIANTS))
        row = table(name, "ms an iter.", "iterations", *_FIGURES, "paper's bone", wide=18)
        row(
            "scan elsewhere",
            "",
            "",
            *_means(learnt, _corners(scan)),
            "",
        )
        shown = {"exemplar": tb.crop(learnt, SIDE)}
        for (variant, (settings, paper)), cost in zip(VARIANTS.items(), costs, strict=True):
            iterations = round(most * min(costs) / cost)
            made = _samples(variant, learnt, iterations, settings)
            if not made:
                continue
            row(variant, f"{1000 * cost:.0f}", iterations, *_means(learnt, made), paper)
            shown[variant] = made[0]
            if folder := pictures():
                montage(list(shown.values()), list(shown), folder / f"gan-ablation-{name}.png")


def materials() -> None:
    """Tables 2 and 3 at compact width: MATERIALS (TRABECULA_BENCH_ONLY), with the paper's losses
    and without them, as many iterations as take the processor equally long
    (TRABECULA_BENCH_ITERATIONS, 1000, of the cheapest), by the papers' measures.
    """
    most = int(os.environ.get("TRABECULA_BENCH_ITERATIONS", "1000"))
    found = {**scans(), "sample:bone": tb.sample("bone")}
    chosen = [name for name in asked("ONLY") or MATERIALS if name in found]
    heads = ("error %", "D2", "N_cc", "N_f", "largest", "thickness", "Euler")
    row = table("material, losses", "iterations", *heads, wide=36)
    costs: list[float] = []
    for name in chosen:
        scan = tb.crop_margins(found[name])
        learnt = tb.crop(scan, [min(LEARNT, side) for side in scan.shape], corner=(0, 0, 0))
        costs = costs or _costs(learnt, PAIRED)
        shown = {"exemplar": tb.crop(learnt, SIDE)}
        _paper_row(row, f"{name}, exemplar", "", [figures(learnt, learnt)])
        elsewhere = _corners(scan)
        if elsewhere:
            parts = [figures(learnt, part) for part in elsewhere]
            _paper_row(row, f"{name}, real elsewhere", "", parts)
        for variant, cost in zip(PAIRED, costs, strict=True):
            iterations = round(most * min(costs) / cost)
            made = _samples(variant, learnt, iterations, VARIANTS[variant][0])
            if not made:
                row(f"{name}, {variant}", iterations, "failed", *[""] * (len(heads) - 1))
                continue
            _paper_row(
                row, f"{name}, {variant}", iterations, [figures(learnt, one) for one in made]
            )
            shown[variant] = made[0]
        if folder := pictures():
            file = name.replace(" ", "-").replace(",", "").replace(":", "-")
            montage(list(shown.values()), list(shown), folder / f"gan-losses-{file}.png")


def _corners(scan: tb.Image) -> list[tb.Image]:
    """Corners of the scan that share no voxel with what was learnt."""
    corners = product(*((0, side - SIDE) for side in scan.shape))
    apart = [corner for corner in corners if max(corner) >= LEARNT]
    return [tb.crop(scan, SIDE, corner=corner) for corner in apart]


def _paper_row(row: Any, name: str, iterations: object, found: Sequence[Figures]) -> None:
    """Print means by the papers' measures."""

    def mean(key: str) -> float:
        return float(np.mean([getattr(one, key) for one in found]))

    row(
        name,
        iterations,
        f"{mean('error'):.2f}",
        f"{mean('distance'):.2f}",
        f"{mean('components'):.0f}",
        f"{mean('floating'):.0f}",
        f"{mean('largest'):.3f}",
        f"{mean('thickness'):.2f}",
        f"{mean('euler'):.2f}",
    )


def _samples(
    variant: str, learnt: tb.Image, iterations: int, settings: dict[str, Any]
) -> list[tb.Image]:
    """Train, and make samples; none where the training failed, which is printed."""
    try:
        model = tb.method(
            "gan", minutes=0, iterations=iterations, looks=4, device="cpu", **settings
        ).fit(learnt)
    except TrainingError as error:
        tell(variant, error)
        return []
    return [model.generate(SIDE, seed=seed) for seed in range(SAMPLES)]


def _costs(image: tb.Image, variants: Sequence[str]) -> list[float]:
    """Seconds of the processor that an iteration takes of each variant, warm-up included.

    The least of several turns: equal time is then a number of iterations.
    """
    import torch

    from trabecula.synth.gan.adversarial import AdversarialPair
    from trabecula.synth.gan.crops import exemplar_fields
    from trabecula.synth.gan.losses import CHUNK, TABLE, CandidateTable

    configs = [GanConfig(**VARIANTS[name][0]) for name in variants]
    fields = exemplar_fields(image, configs[0])
    players = [AdversarialPair(config, 1, torch.device("cpu")) for config in configs]
    for one in players:
        one.table = CandidateTable(
            fields.crops(min(TABLE, 4 * one.config.batch), 0, 2**40), chunk=CHUNK
        )
    draw = torch.Generator().manual_seed(0)
    spent = np.full((2, len(players)), np.inf)
    for turn in range(2 + _TURNS):
        real = fields.crops(configs[0].batch, 0, turn)
        for number, one in enumerate(players):
            warm, play = (
                busy(lambda p=one, r=real: p.warmup_step(r, draw)),
                busy(lambda p=one, r=real, t=turn: p.train_step(r, draw, t, 0.1)),
            )
            if turn >= 2:
                spent[:, number] = np.minimum(spent[:, number], (warm[0], play[0]))
    share = configs[0].warmup
    return list(share * spent[0].mean() + (1 - share) * spent[1])


def _means(exemplar: tb.Image, images: Sequence[tb.Image]) -> list[str]:
    certificates = tb.verify(exemplar, *images, level="quick")
    return [
        f"{np.mean([float(one.metrics[key].value) for one in certificates]):.4g}"
        for key in _FIGURES
    ]

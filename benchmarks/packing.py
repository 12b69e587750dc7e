"""`packing` beside `texture`: materials of bodies by their process, and scans."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from common import asked, busy, table
from forms import FORMS, ends
from texture import cells, judged, reference_of, wholes
from trabecula.core.errors import InputError

SEEDS = (1, 2, 3)
SIDE = 96
MADE = ("cemented grains", "beads", "suspension")
SCANS = (
    "soil, Otsu",
    "cement, Otsu",
    "NMC",
    "Berea",
    "cathode, coarse",
    "grey bone, Otsu",
    "bone a",
    "sample foam",
)
NAMES = ("shape", "S2 cov", "thickness", "Euler", "pore size", "coh(4)")


def packing() -> None:
    """120^3 from 96^3: figures of `verify`, `!` out of band, by `texture` and by `packing`; the
    phase, separation and fillet that trials chose, and seconds of learning and making.
    """
    row = table("material, what", "out", "of", *NAMES, "CPU s", wide=34)
    for name, exemplar in _materials():
        reference = reference_of(exemplar)
        for method in ("texture", "packing"):
            try:
                learning, model = busy(lambda m=method, e=exemplar: tb.method(m).fit(e))
            except InputError as error:
                print(f"    {name}, {method}: {error}")
                continue
            if method == "packing":
                phase = exemplar.phases[model.label]
                print(
                    f"    {phase}, separation {model.packed.separation:g}, fillet "
                    f"{model.packed.fillet:g}; {len(model.bodies.weights)} whole bodies, misfit "
                    f"{model.bodies.misfit:.3f}, score {model.packed.score:.2f}; learnt in "
                    f"{learning:.1f} s"
                )
            for seed in SEEDS:
                seconds, made = busy(lambda m=model, s=seed: m.generate(120, seed=s))
                metrics = judged(reference, made)
                passed = [one.passed for one in metrics.values() if one.passed is not None]
                told = (passed.count(False), len(passed), *cells(metrics, NAMES), f"{seconds:.2f}")
                row(f"{name}, {method}, {seed}", *told)


def _materials() -> Iterator[tuple[str, tb.Image]]:
    """Yield exemplars of two phases of 96^3 at most."""
    chosen = asked("ONLY") or (*MADE, *SCANS)
    for name in MADE:
        if name in chosen:
            whole = FORMS[name](np.random.default_rng(0)).astype(np.uint8)
            yield name, tb.Image(np.ascontiguousarray(ends(whole)[0]), "labels")
    there = wholes()
    for name in SCANS:
        if name in chosen and name in there:
            yield name, tb.crop(there[name], min(SIDE, *there[name].shape))

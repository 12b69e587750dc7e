"""`packing` and `fibres` beside `texture`: materials by their process, and scans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

import trabecula as tb
from common import asked, busy, table
from forms import FORMS, NAMES, ends, made_form
from texture import cells, judged, out_of_band, reference_of, wholes
from trabecula.core.errors import InputError

SEEDS = (1, 2, 3)
SIDE = 96
GRAINS = ("cemented grains", "beads", "suspension", "soil, Otsu", "cement, Otsu", "NMC", "Berea")
NO_GRAINS = ("cathode, coarse", "grey bone, Otsu", "bone a", "sample foam")
FIBRES = ("fibres", "polymer fibres, Otsu", "weave, Otsu")


def packing() -> None:
    """120^3 from 96^3 of grains and others: figures of `verify`, `!` out of band, by `texture` and
    by `packing`; the phase, separation and fillet that trials chose, and seconds of learning.
    """
    _beside("packing", (*GRAINS, *NO_GRAINS))


def fibres() -> None:
    """120^3 from 96^3 of fibres: the same by `texture` and by `fibres`, with the bend as well."""
    _beside("fibres", FIBRES)


def _beside(other: str, names: Sequence[str]) -> None:
    """Print rows of `texture` and another method."""
    row = table("material, what", "out", "of", *NAMES, "CPU s", wide=34)
    for name, exemplar in _materials(names):
        reference = reference_of(exemplar)
        for method in ("texture", other):
            try:
                learning, model = busy(lambda m=method, e=exemplar: tb.method(m).fit(e))
            except InputError as error:
                print(f"    {name}, {method}: {error}")
                continue
            if method == other:
                print(f"    {_chosen(model)}; learnt in {learning:.1f} s", flush=True)
            for seed in SEEDS:
                seconds, made = busy(lambda m=model, s=seed: m.generate(120, seed=s))
                metrics = judged(reference, made)
                told = (*out_of_band(metrics), *cells(metrics, NAMES), f"{seconds:.2f}")
                row(f"{name}, {method}, {seed}", *told)


def _chosen(model: Any) -> str:
    """What trials chose, and how sure it is that there are bodies or fibres."""
    packed = model.packed
    words = (
        f"{model.facts[0].phases[model.label]}, separation {packed.separation:g}, fillet "
        f"{packed.fillet:g}, score {packed.score:.2f}"
    )
    if hasattr(model, "bodies"):
        own = model.bodies
        return f"{words}; {len(own.weights)} whole bodies, misfit {own.misfit:.3f}"
    own = model.strands
    return f"{words}, bend {model.bend:g}; radius {own.mean_radius:.2f}, clarity {own.clarity:.2f}"


def _materials(names: Sequence[str]) -> Iterator[tuple[str, tb.Image]]:
    """Yield exemplars of two phases of 96^3 at most."""
    there = wholes()
    for name in asked("ONLY") or names:
        if name in FORMS:
            whole = made_form(name)
            yield name, tb.Image(np.ascontiguousarray(ends(whole)[0]), "labels")
        elif name in there:
            yield name, tb.crop(there[name], min(SIDE, *there[name].shape))

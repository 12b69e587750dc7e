"""Closed cells from a scan: `tessellation` beside `texture` and `packing`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from common import asked, busy, pictures, table
from forms import NAMES
from image_cells import truths
from texture import cells, judged, out_of_band, reference_of
from trabecula.core.errors import InputError
from trabecula.measure.labelling import label_components
from trabecula.view.slices import montage

SIDE = 96
METHODS = ("tessellation", "texture", "packing")


def closed_cells() -> None:
    """120^3 from 96^3 of closed cells, by methods (TRABECULA_BENCH_METHODS), seed 1: figures of
    `verify`, `!` out of band; the largest component's share of the cells, of the scan in the row of
    its name; seconds of learning and of making.
    """
    row = table("material, what", "out", "of", "largest", *NAMES, "learning s", "making s", wide=34)
    for name, exemplar in _materials():
        reference = reference_of(exemplar)
        row(name, "", "", f"{_largest(exemplar):.3f}", *[""] * (len(NAMES) + 2))
        shown = {"the scan": tb.Image(exemplar.values[SIDE // 2], "labels")}
        for method in asked("METHODS") or METHODS:
            try:
                learning, model = busy(lambda m=method, e=exemplar: tb.method(m).fit(e))
            except InputError as error:
                print(f"    {name}, {method}: {error}")
                continue
            seconds, made = busy(lambda m=model: m.generate(120, seed=1))
            metrics = judged(reference, made)
            row(
                f"{name}, {method}",
                *out_of_band(metrics),
                f"{_largest(made):.3f}",
                *cells(metrics, NAMES),
                f"{learning:.1f}",
                f"{seconds:.1f}",
            )
            shown[method] = tb.Image(made.values[60, :SIDE, :SIDE], "labels")
        folder = pictures()
        if folder:
            file = folder / f"closed-{name.replace(' ', '-').replace(':', '-')}.png"
            tb.write(montage(list(shown.values()), list(shown)), file)


def _materials() -> Iterator[tuple[str, tb.Image]]:
    """Yield exemplars of 96^3: cells are void, walls are solid."""
    made = {"sample:cells": lambda: tb.sample("cells"), **truths()}
    made["foam of bubbles"] = lambda: tb.method("bubbles", preset="foam").fit().generate(SIDE)
    for name in asked("ONLY") or made:
        image = tb.crop(made[name](), SIDE)
        walls = (image.values != 0).astype(np.uint8)
        yield name, tb.Image(walls, "labels", phases=("void", "solid"))


def _largest(image: tb.Image) -> float:
    """The largest component's share of the cells."""
    _, sizes = label_components(image.values == 0, connectivity=6)
    return float(sizes.max() / sizes.sum())

"""`evenness`: how the local fraction of results varies over windows, beside the exemplar's band,
for seeds, sizes and methods.

Windows and bands are those of the certificate: edges of about 3, 8 and 20 correlation lengths,
where they fit. An exemplar of a given side is the centre of its scan; pictures are the exemplar's
middle slice, for methods that learn from pictures.

`python benchmarks/evenness.py METHOD[:PRESET] EXEMPLAR SIDE TIMES SEED [SEED ...]` is one block of
the table.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import trabecula as tb
from common import busy, table
from descriptors import scans
from trabecula.measure.evenness import evenness, windows_for
from trabecula.report.evenness import SIZES, evenness_bands

SEEDS = tuple(range(1, 21))
BLOCKS = tuple(
    (name, 48, times) for name in ("sample bone", "Berea", "NMC") for times in (1.25, 2.0, 4.0)
)
"""Exemplar, its side, and how many times that the result is."""

FROM_PICTURES = ("mrf", "kopf", "chen", "sliced")
OTHERS = (*FROM_PICTURES, "quilt")
OTHER_SEEDS = (1, 2, 3)
HEADS = ("S2", "s", "windows: voxels, exemplar, result, band")


def evenness_table() -> None:
    """The default of `texture` for every block, then the other methods on the first."""
    for block in BLOCKS:
        show_block("texture", *block, SEEDS)
    for method in OTHERS:
        show_block(method, *BLOCKS[0], OTHER_SEEDS)


def exemplar_of(name: str, side: int) -> tb.Image:
    """The centre of a sample ("sample bone") or of a scan, grey ones cut at Otsu's threshold."""
    image = tb.sample(name.split()[1]) if name.startswith("sample ") else scans()[name]
    return tb.crop(image, side) if min(image.shape) > side else image


def show_block(method: str, name: str, side: int, times: float, seeds: Sequence[int]) -> None:
    """One exemplar and one size: a line a seed, and how many spreads lie in the exemplar's band."""
    exemplar = exemplar_of(name, side)
    kind, _, preset = method.partition(":")
    given = exemplar
    if kind in FROM_PICTURES:
        middle = exemplar.shape[0] // 2
        given = tb.Image(
            exemplar.values[middle], "labels", spacing=exemplar.spacing[1:], phases=exemplar.phases
        )
    row = table(f"{method}, {name} {side} x {times:g}", *HEADS)
    maker = tb.method(kind, **({"preset": preset} if preset else {}))
    model = maker.fit(given)
    edges = windows_for(exemplar)
    own = evenness(exemplar, windows=edges)
    sizes = SIZES[-len(own.fraction) :]
    true = tb.measure.covariance_form(tb.measure.two_point(exemplar, r_max=side // 3))
    inside = asked = 0
    for seed in seeds:
        seconds, made = busy(lambda seed=seed: model.generate(round(side * times), seed=seed))  # type: ignore[misc]
        found = evenness(made, windows=edges)
        bands = evenness_bands(own, found)
        cells = []
        for size, mine, theirs in zip(sizes, own.fraction, found.fraction, strict=True):
            band = bands.get(f"fraction_spread_{size}")
            cells.append(
                f"{mine.edge / exemplar.spacing[0]:.0f}: {mine.deviation:.4f} "
                f"{theirs.deviation:.4f}"
            )
            if band is not None:
                held = band[0] <= theirs.deviation <= band[1]
                inside, asked = inside + held, asked + 1
                cells[-1] += f" ({band[0]:.4f}..{band[1]:.4f}){'' if held else ' OUT'}"
        curve = tb.measure.covariance_form(tb.measure.two_point(made, r_max=side // 3))
        error = np.linalg.norm((curve - true)[1:]) / np.linalg.norm(true[1:])
        row(seed, f"{error:.3f}", f"{seconds:.1f}", "  ".join(cells))
    row("in band", f"{inside} of {asked}", "", "")


if __name__ == "__main__":
    words = sys.argv[1:]
    show_block(
        words[0], words[1], int(words[2]), float(words[3]), [int(word) for word in words[4:]]
    )

"""Ensembles against the material: mean and spread of every figure over members, beside those of
real parts.
"""

from __future__ import annotations

import trabecula as tb
from common import table
from descriptors import scans
from trabecula.report import EnsembleCertificate

SIDE, COUNT = 64, 24
"""Voxels of a member, half of the scan's shortest side where that is less; members."""

MATERIALS = ("bone a", "Berea", "NMC", "cement, Otsu", "soil, Otsu")
SAMPLE = "foam"
UNSPREAD = ("bone a",)
"""Materials whose members are made with the scan's own porosity as well."""


def ensembles() -> None:
    """24 members of 64^3 by `texture` from each scan, parts of volumes of 128^3 whose porosity is
    drawn, against the parts of that scan: ratio of standard deviations / shift of the mean in real
    standard deviations, and the verdict.
    """
    known = scans() | {SAMPLE: tb.sample(SAMPLE)}
    for name in [*MATERIALS, SAMPLE] if MATERIALS[0] in known else known:
        scan = known[name]
        model = tb.method("texture").fit(scan)
        side = min(SIDE, min(scan.shape) // 2)
        for spread in (1, 0) if name in UNSPREAD else (1,):
            members = list(tb.ensemble(model, side, count=COUNT, seed=1, spread=spread))
            show(f"{name}, {side}^3, spread {spread}", tb.verify_ensemble(scan, members))


def show(name: str, found: EnsembleCertificate) -> None:
    """Print the certificate of one ensemble, a figure a row."""
    print(f"\n{name}: {found.verdict}, {len(found.failed)} of {len(found.metrics)} figures fail")
    row = table("figure", "sd ratio", "shift", "verdict", wide=24)
    for figure, one in found.metrics.items():
        shift = "-" if one.shift is None else f"{one.shift:+.1f}"
        row(figure, "-" if one.ratio is None else f"{one.ratio:.2f}", shift, one.verdict)
    row("within a quarter", f"{found.within:.2f}", f"{found.chance:.2f}", "real: by chance")

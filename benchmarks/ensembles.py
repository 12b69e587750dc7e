"""Ensembles against the material: mean and spread of every figure over members, beside those of
real parts.
"""

from __future__ import annotations

import trabecula as tb
from common import table
from descriptors import scans
from trabecula.report import EnsembleCertificate

SIDE, COUNT, LEARNED = 64, 24, 128
"""Voxels of a member; members; voxels of the crop, from the middle of a scan, that is learned."""

MATERIALS = ("bone a", "Berea", "NMC", "cement, Otsu", "soil, Otsu")


def ensembles() -> None:
    """24 members of 64^3 by `texture` from a crop of each scan, with the spread that is drawn from
    it and without, against all of the scan: ratio of standard deviations / shift of the mean in
    real standard deviations, and the verdict.
    """
    known = scans()
    for name in MATERIALS if MATERIALS[0] in known else known:
        scan = known[name]
        model = tb.method("texture").fit(tb.crop(scan, [min(LEARNED, n) for n in scan.shape]))
        side = min(SIDE, min(scan.shape) // 2)
        for spread in (1, 0):
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

"""`properties`: material made to have a permeability, a stiffness, a surface or a size."""

from __future__ import annotations

import trabecula as tb
from common import busy, table
from descriptors import scans
from trabecula.core.errors import RequestError
from trabecula.measure.properties import measure_property
from trabecula.pipeline.property_target import match_property

SIDE = 96
MATERIALS = ("bone a", "Berea", "NMC", "sample foam")
TARGETS = {
    "diffusivity": 1.15,
    "permeability": 0.6,
    "stiffness": 0.7,
    "specific_surface": 1.1,
    "pore_size": 1.1,
}
"""What is asked for, over the scan's own."""


def properties() -> None:
    """Twenty targets, 96^3 by the default of `texture`, seed 0: five properties of four materials,
    each off the scan's own value. Seconds are of the processor, trials and solvers included.
    """
    known = {"sample foam": tb.sample("foam"), **scans()}
    row = table("target", "scan's own", "asked", "found", "off", "results", "s", wide=32)
    within = done = 0
    for name in MATERIALS:
        scan = known.get(name)
        if scan is None:
            continue
        centre = tb.crop(scan, min(128, *scan.shape))
        model = tb.method("texture").fit(centre)
        for what, factor in TARGETS.items():
            own = measure_property(centre, what)
            words = f"{name}, {what}"
            done += 1
            try:
                seconds, found = busy(
                    lambda w=what, a=factor * own, m=model: match_property(m, SIDE, {w: a})
                )
            except RequestError as error:
                row(words, f"{own:.4g}", f"{factor * own:.4g}", "refused", "", "", "")
                print(f"  {error}")
                continue
            within += abs(found.error) <= 0.05
            row(
                words,
                f"{own:.4g}",
                f"{found.asked:.4g}",
                f"{found.value:.4g}",
                f"{found.error:+.1%}",
                len(found.made),
                f"{seconds:.0f}",
            )
    print(f"\nwithin 5 %: {within} of {done}")

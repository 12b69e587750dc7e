"""How visible the joint between known voxels and what `texture` makes beside them is."""

from __future__ import annotations

import numpy as np

import trabecula as tb
from common import asked, busy, table
from descriptors import scans

SIDE, EXEMPLAR = 100, 96
HOLE = slice(26, 74)
HELD = 40
"""Planes that an extension continues."""
SCANS = ("bone a", "bone with cortex", "Berea", "NMC")
SEEDS = (1, 2)
SETTINGS: dict[str, dict[str, str]] = {"sliced layout": {"layout": "structure"}, "default": {}}


def texture_joints() -> None:
    """A hole of 48^3 in 100^3 of a scan, filled from 96^3 at its other end, and 60 planes added to
    40 of the same.

    `joint` is the share of voxels that change their phase across the joint, over that between
    neighbours within what was made; `next` the same for the three planes beyond it. The scan's own
    are of the same places.
    """
    row = table(
        "scan, case", "seed", "joint", "next", "made", "Euler", "coh(4)", "seconds", wide=34
    )
    every = scans()
    for name in (one for one in asked("ONLY") or SCANS if one in every):
        scan = every[name]
        exemplar = tb.crop(scan, EXEMPLAR, corner=(0, 0, 0))
        host = tb.crop(scan, SIDE, corner=[edge - SIDE for edge in scan.shape])
        for case, known in (("hole", _hole()), ("extension", _held())):
            row(f"{name}, {case}, the scan", "", *_told(host.values, case), "", "")
            for words, settings in SETTINGS.items():
                model = tb.method("texture", **settings).fit(exemplar)
                for seed in SEEDS:
                    request = tb.Request(host.shape, seed=seed, fixed=host, known=known)
                    seconds, made = busy(lambda m=model, r=request: m.generate(r))
                    new = made.values[(HOLE,) * 3] if case == "hole" else made.values[HELD:]
                    copied = tb.measure.coherence(exemplar, new, k=(4,), samples=300)[4]
                    told = (*_told(made.values, case), f"{copied:.3f}", f"{seconds:.1f}")
                    row(f"{name}, {case}, {words}", seed, *told)


def _hole() -> np.ndarray:
    known = np.ones((SIDE,) * 3, bool)
    known[HOLE, HOLE, HOLE] = False
    return known


def _held() -> np.ndarray:
    known = np.zeros((SIDE,) * 3, bool)
    known[:HELD] = True
    return known


def _told(values: np.ndarray, case: str) -> tuple[str, ...]:
    solid = np.asarray(values) > 0
    if case == "extension":
        made = solid[HELD:]
        changes = np.mean(np.diff(solid, axis=0), axis=(1, 2))
        joint, near = changes[HELD - 1], changes[HELD : HELD + 3].mean()
    else:
        made = solid[(HOLE,) * 3]
        sides = [_across_faces(solid, axis) for axis in range(3)]
        joint, near = np.mean([side[0] for side in sides]), np.mean([side[1] for side in sides])
    inside = np.mean([np.mean(np.diff(made, axis=axis)) for axis in range(3)])
    euler = tb.measure.euler_density(tb.Image(np.ascontiguousarray(made, np.uint8), "labels"))
    return f"{joint / inside:.2f}", f"{near / inside:.2f}", f"{inside:.4f}", f"{1e6 * euler:.0f}"


def _across_faces(solid: np.ndarray, axis: int) -> tuple[float, float]:
    """The share of changes across the two faces of the hole, and in the three planes inside."""
    turned = np.moveaxis(solid, axis, 0)[:, HOLE, HOLE]
    changes = np.mean(np.diff(turned, axis=0), axis=(1, 2))
    first, last = HOLE.start - 1, HOLE.stop - 1
    near = (*changes[first + 1 : first + 4], *changes[last - 3 : last])
    return float(changes[[first, last]].mean()), float(np.mean(near))

"""`conduction`: the volume and the spheres on which the field times its tortuosity codes."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import tifffile

from big import spend
from common import SCANS, table
from trabecula.engine.parallel import threads
from trabecula.measure import tortuosity

VOLUME = "tau_benchmark_500.tif"
PUBLISHED = 4.2431, 1.1513, 1.3905  # TauFactor 2, over-converged: along z, y, x
SPHERES = 128, 200, 256, 300
PACKED = math.sqrt(2) / 4  # radius over the cell's edge, where spheres touch


def conduction() -> None:
    """Tortuosity; processor seconds, seconds and peak memory of a process of one thread, and of one
    with two.
    """
    row = table("volume", "tau", "published", "steps", "CPU s", "s", "GB", "s of two", "GB")
    for axis, known in enumerate(PUBLISHED if (SCANS / VOLUME).exists() else ()):
        row(f"500^3, along {'zyx'[axis]}", *_cells(VOLUME, axis, f"{known:.4f}"))
    for side in SPHERES:
        row(f"spheres of {side}^3, along z", *_cells(side, 0, "-"))


def _cells(volume: str | int, axis: int, known: str) -> list[str]:
    one, two = (
        spend([sys.executable, __file__, str(volume), str(axis), str(count)]) for count in (1, 2)
    )
    found = one.found
    if two.found != found:
        raise RuntimeError(f"two threads found {two.found}, one {found}")
    tau = f"{found['tau']:.4f}" if found["converged"] else "not converged"
    spent = f"{one.busy:.1f}", f"{one.wall:.1f}", f"{one.peak / 1e9:.2f}"
    return [tau, known, str(found["steps"]), *spent, f"{two.wall:.1f}", f"{two.peak / 1e9:.2f}"]


def spheres(side: int) -> np.ndarray:
    """Return the void between spheres that touch, face-centred: one cell of a cube."""
    at = (np.arange(side) + 0.5) / side
    centres = [(0, 0, 0), (0, 0.5, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0)]
    void = np.ones((side,) * 3, np.uint8)
    for centre in centres:
        away = [np.abs(at - c) for c in centre]
        z, y, x = (np.minimum(one, 1 - one) ** 2 for one in away)
        void[z[:, None, None] + y[:, None] + x < PACKED**2] = 0
    return void


def _solve(volume: str, axis: int, count: int) -> None:
    """Print the tortuosity of a phase that is 1."""
    inside = (
        spheres(int(volume))
        if volume.isdigit()
        else (tifffile.imread(SCANS / volume) > 0).astype(np.uint8)
    )
    with threads(count):
        found = tortuosity(inside, axis=axis, phase=1)
    told = {"tau": found.value, "converged": found.converged, "steps": found.iterations}
    print(json.dumps(told))


if __name__ == "__main__":
    _solve(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))

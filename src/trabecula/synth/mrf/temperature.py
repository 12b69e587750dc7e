"""The pixel temperatures of the deterministic relaxation (equation 8)."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.mrf.gather import gather_places


@kernel
def cool(sites, offsets, there, held, xi, temperature):
    """t = max(0, (xi + sum of t over the neighbours in three dimensions) / their number); `held`
    sites keep theirs.

    What is not `there` is no neighbour; without entries all are.
    """
    flat, kept = temperature.ravel(), held.ravel()
    places = np.empty((1, len(offsets)), np.int64)
    for s in range(len(sites)):
        if kept[sites[s]]:
            continue
        gather_places(sites[s : s + 1], offsets, temperature.shape, there, places)
        total, number = np.float64(xi), 0
        for place in places[0]:
            if place >= 0:
                total += flat[place]
                number += 1
        flat[sites[s]] = max(0.0, total / max(number, 1))

"""Neighbourhoods chosen for another porosity than the picture's."""

from __future__ import annotations

import numpy as np

from trabecula.synth.mrf.patches import Patches

_SLOPES = np.linspace(-40, 40, 161)
_WHOLE = 1 << 20


def tilted(patches: Patches, void: int, porosity: float) -> Patches:
    """As many neighbourhoods as before, drawn evenly with weights exp(theta u), u the share of void
    in each.

    theta, of -40 .. 40, is such that their centres come as near to `porosity` as they can: places
    of the picture that are more porous than others teach more often.
    """
    centre = patches.centres == void
    share = ((patches.around == void).sum(1, dtype=np.int32) + centre) / (
        patches.around.shape[1] + 1
    )
    # Not by halving an interval: where few neighbourhoods are left, the porosity of their centres
    # is no rising function.
    misses = [abs(_porosity(_weights(share, theta), centre) - porosity) for theta in _SLOPES]
    ends = np.cumsum(_weights(share, _SLOPES[int(np.argmin(misses))]))
    count = len(share)
    places = (2 * np.arange(count) + 1) * int(ends[-1]) // (2 * count)
    return patches[np.searchsorted(ends, places, side="right")]


def _weights(share: np.ndarray, theta: float) -> np.ndarray:
    """Whole numbers, so that machines agree."""
    power = theta * share
    return np.rint(_WHOLE * np.exp(power - power.max())).astype(np.int64)


def _porosity(weights: np.ndarray, centre: np.ndarray) -> float:
    return float(weights[centre].sum() / weights.sum())

"""Mixtures of materials as droplets, each of one material: error diffusion.

The material with the largest share, the errors of its neighbours included, gets the droplet; the
rest of its share goes to the neighbours that follow (Floyd and Steinberg 1976, Proc. SID
17, 75), on rows in alternating directions. Random numbers keyed by the
droplet's place keep layers from repeating each other, so a layer is made alone and always alike.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.random import philox

_NOISE = 0.25  # of a droplet: enough to break up rows of droplets


def diffuse(inside: np.ndarray, shares: np.ndarray, key: np.uint64, layer: int) -> np.ndarray:
    """Choose a material for every droplet.

    Parameters
    ----------
    inside : (Y, X) bool
        Droplets that are placed.
    shares : (K, Y, X) float32
        Of the materials, adding up to 1.
    key : uint64
        Of the random numbers.
    layer : int

    Returns
    -------
    (Y, X) uint8
        Number of the material; 0 where nothing is placed.
    """
    chosen = np.zeros(inside.shape, np.uint8)
    errors = np.zeros((2, len(shares), inside.shape[1] + 2), np.float32)
    _diffuse(inside, shares, key, layer, np.float32(_NOISE), errors, chosen)
    return chosen


@kernel
def _diffuse(inside, shares, key, layer, noise, errors, chosen):
    count, height, width = shares.shape
    for y in range(height):
        now, after = y % 2, (y + 1) % 2
        errors[after] = 0
        step = 1 if y % 2 == 0 else -1
        for n in range(width):
            x = n if step == 1 else width - 1 - n
            if not inside[y, x]:
                continue
            words = philox(key, layer, y, x, 0)
            best, most = 0, np.float32(-np.inf)
            for k in range(count):
                random = np.float32(words[k % 4]) / np.float32(2**32) - np.float32(0.5)
                value = shares[k, y, x] + errors[now, k, x + 1] + noise * random
                if value > most:
                    best, most = k, value
            chosen[y, x] = best
            for k in range(count):
                rest = shares[k, y, x] + errors[now, k, x + 1]
                if k == best:
                    rest -= np.float32(1)
                errors[now, k, x + 1 + step] += rest * np.float32(7 / 16)
                errors[after, k, x + 1 - step] += rest * np.float32(3 / 16)
                errors[after, k, x + 1] += rest * np.float32(5 / 16)
                errors[after, k, x + 1 + step] += rest * np.float32(1 / 16)

"""Film: exposure, a filmic curve, and a filter that averages the noise away."""

from __future__ import annotations

from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs

REACH = 4
"""Pixels to each side that the filter looks at."""


def develop(light: np.ndarray, exposure: float) -> np.ndarray:
    """Return (H, W, 3) float 0..1 linear light of a picture, from radiance.

    Parameters
    ----------
    light : (H, W, 3) float
        1 is a white surface in full light.
    exposure : float
        Stops: each doubles the light.

    Notes
    -----
    The curve is Narkowicz's fit of the Academy's (2016): a toe, a nearly straight middle and a
    shoulder, so that highlights keep their drawing. A share of it acts on all channels alike, so
    that bright colours pale less.
    """
    seen = np.maximum(light, 0.0) * (EXPOSURE * 2.0**exposure)
    most = seen.max(axis=-1, keepdims=True)
    alike = seen * (_curve(most) / np.maximum(most, 1e-9))
    return np.clip(0.6 * _curve(seen) + 0.4 * alike, 0.0, 1.0)


EXPOSURE = 0.62


def _curve(x: np.ndarray) -> np.ndarray:
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)


def average_noise(halves: np.ndarray, features: np.ndarray, *, strength: float = 1.0) -> np.ndarray:
    """Return (2, H, W, 3): both halves of the samples, filtered.

    Parameters
    ----------
    halves : (2, H, W, 3) float
        Means of the even samples and of the odd ones.
    features : (H, W, 8) float
        Means of what paths meet first: normal, albedo, share of material, length.
    strength : float
        Differences of this many times the noise count as the same light.

    Notes
    -----
    A mean over neighbours whose normal, albedo and light are alike. What is compared is the light
    of the *other* half, by patches, so that a pixel's own noise does not choose its neighbours
    (Rousselle et al. 2012, Adaptive rendering with non-local means filtering,
    doi:10.1145/2366145.2366214).
    """
    out = np.empty_like(halves)
    spread = _box(((halves[0] - halves[1]) ** 2).mean(axis=-1) / 2, 2)
    for half in range(2):
        guide = np.ascontiguousarray(halves[1 - half])
        source = np.ascontiguousarray(halves[half])
        given = (source, guide, spread, features, strength, out[half])
        for_slabs(partial(_filter, *given), len(source))
    return out


def _box(values: np.ndarray, reach: int) -> np.ndarray:
    for axis in range(2):
        pads = [(reach + 1, reach) if each == axis else (0, 0) for each in range(2)]
        total = np.cumsum(np.pad(values, pads, mode="edge"), axis=axis)
        wide = 2 * reach + 1
        ahead = np.take(total, range(wide, total.shape[axis]), axis=axis)
        behind = np.take(total, range(total.shape[axis] - wide), axis=axis)
        values = (ahead - behind) / wide
    return values


@kernel
def _filter(source, guide, spread, features, strength, out, first, last):
    """Average the rows first..last of `source` by the likeness of `guide` and `features`."""
    height, width = guide.shape[0], guide.shape[1]
    for row in range(first, last):
        for column in range(width):
            total = 0.0
            red = green = blue = 0.0
            for j in range(max(row - REACH, 0), min(row + REACH + 1, height)):
                for i in range(max(column - REACH, 0), min(column + REACH + 1, width)):
                    apart = 0.0
                    for c in range(3):
                        apart += 6.0 * (features[row, column, c] - features[j, i, c]) ** 2
                        apart += 90.0 * (features[row, column, 3 + c] - features[j, i, 3 + c]) ** 2
                    apart += 20.0 * (features[row, column, 6] - features[j, i, 6]) ** 2
                    if apart > 6.0:
                        continue
                    differ, count = 0.0, 0
                    for b in range(-1, 2):
                        for a in range(-1, 2):
                            y, x = row + b, column + a
                            v, u = j + b, i + a
                            if (
                                min(y, v) < 0 or min(x, u) < 0 or max(y, v) >= height
                                or max(x, u) >= width
                            ):  # fmt: skip
                                continue
                            noise = spread[y, x] + min(spread[y, x], spread[v, u])
                            square = 0.0
                            for c in range(3):
                                square += (guide[y, x, c] - guide[v, u, c]) ** 2
                            differ += (square / 3 - noise) / (
                                1e-7 + strength * (spread[y, x] + spread[v, u])
                            )
                            count += 1
                    weight = np.exp(-apart - max(0.0, differ / count))
                    total += weight
                    red += weight * source[j, i, 0]
                    green += weight * source[j, i, 1]
                    blue += weight * source[j, i, 2]
            out[row, column, 0] = red / total
            out[row, column, 1] = green / total
            out[row, column, 2] = blue / total

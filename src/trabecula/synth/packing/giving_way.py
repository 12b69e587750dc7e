"""Bodies that stand and would overlap behind the joint: what is not seen of them gives way."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.distance import distance_transform
from trabecula.synth.packing.radial_shapes import radius_towards, table_directions
from trabecula.synth.shared.packed.neighbours import neighbour_pairs

_FULL = 8.0  # edges beyond the joint from where a radius gives way wholly: of 4 it was seen there
_ROUNDS = 3
_LEAST = 0.5  # of a radius that remains, a round


def give_way(
    places: np.ndarray,
    radii: np.ndarray,
    unseen: np.ndarray,
    steps: np.ndarray,
    separation: float,
) -> np.ndarray:
    """Shorten radii until bodies are as far apart as they should be, as far as they are not seen.

    Parameters
    ----------
    places : (n, 3) float64
        Edges, with voxel centres at whole numbers of steps.
    radii : (n, radial_shapes.SIZE) float32
    unseen : (Z, Y, X) bool
        Voxels that are not known.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    separation : float
        Distance of two bodies over the sum of their radii.

    Returns
    -------
    radii : (n, radial_shapes.SIZE) float32
    """
    ways = table_directions()
    shares = _shares(places, radii, ways, unseen, steps)
    reach = separation * radii.max(axis=1).astype(np.float64)
    # no box that repeats: with room on all sides no body has a neighbour across its faces
    first = places.min(axis=0) - 2 * reach.max()
    sides = places.max(axis=0) + 2 * reach.max() - first
    pairs = neighbour_pairs(places - first, reach, sides)
    for _ in range(_ROUNDS):
        scales = np.ones(radii.shape, np.float32)
        _give_way(pairs, places, radii, ways, shares, separation, scales)
        radii = radii * scales
    return radii


def _shares(
    places: np.ndarray,
    radii: np.ndarray,
    ways: np.ndarray,
    unseen: np.ndarray,
    steps: np.ndarray,
) -> np.ndarray:
    """Return how far every radius gives way, 0 where it ends in what is known."""
    beyond = distance_transform(unseen, spacing=steps.tolist())
    last = np.array(unseen.shape) - 1
    shares = np.empty(radii.shape, np.float32)
    for share, place, own in zip(shares, places, radii, strict=True):
        at = np.rint((place + own[:, None] * ways) / steps).astype(np.int64)
        share[:] = beyond[tuple(np.clip(at, 0, last).T)] / _FULL
    return np.minimum(shares, 1, out=shares)


@kernel
def _give_way(pairs, places, radii, ways, shares, separation, scales):
    """Lower the scales of the radii of both bodies of pairs that are too near, towards each
    other.
    """
    for k in range(len(pairs)):
        i, j = pairs[k]
        dz, dy, dx = (
            places[j, 0] - places[i, 0],
            places[j, 1] - places[i, 1],
            places[j, 2] - places[i, 2],
        )
        length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
        both = radius_towards(radii[i], dz, dy, dx) + radius_towards(radii[j], -dz, -dy, -dx)
        lack = 1 - max(length / (separation * both), _LEAST)
        if lack <= 0:
            continue
        for d in range(len(ways)):
            along = (ways[d, 0] * dz + ways[d, 1] * dy + ways[d, 2] * dx) / length
            body = i if along > 0 else j
            scale = 1 - lack * along * along * shares[body, d]
            scales[body, d] = min(scales[body, d], scale)

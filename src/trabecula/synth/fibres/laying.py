"""Fibres in a box that repeats: drawn, laid anywhere, and pushed apart.

A fibre is a chain of places (Altendorf and Jeulin 2011, doi:10.1103/PhysRevE.83.041804): its
direction wanders about a mean one. Places of two fibres push each other where they are nearer than
the sum of their radii times `separation`; moves are averaged along a fibre, so that it bends
gently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil

import numpy as np

from trabecula.core.seeds import generator
from trabecula.engine.compile import kernel
from trabecula.synth.fibres.strands import Strands
from trabecula.synth.shared.packed.depth import REACH, depth_field
from trabecula.synth.shared.packed.drawn import drawn_evenly
from trabecula.synth.shared.packed.neighbours import neighbour_pairs, offset_between
from trabecula.synth.shared.packed.pushing import push_apart, write_push

_STEPS = 150
_WANDER = 20.0  # mean radii along which a direction forgets itself
_BANDS = 9  # of directions, by their first component
_STIFF = 6.0  # mean radii along which moves are averaged, twice
_PUSH, _FARTHEST = 1.0, 0.5  # of what is lacking, a step; edges, at most
_NEAR = 1.15  # sums of radii times separation, and a slack in edges, within which places are near
_SLACK = 0.5
_STAGE = "fibres"

APART = 0.8
"""Mean radii between two places of a fibre."""


@dataclass(frozen=True, eq=False)
class Laid:
    """Fibres in a box that repeats; n fibres of k places. Lengths are in the smallest voxel edge.

    Attributes
    ----------
    places : (n, k, 3) float64
        Going on beyond the box.
    radii : (n,) float64
    sides : (3,) float64
    lacking : float
        What places lack of their distance, over the mean radius, mean of all.
    """

    places: np.ndarray
    radii: np.ndarray
    sides: np.ndarray
    lacking: float


def lay(
    strands: Strands,
    sides: Sequence[float] | np.ndarray,
    *,
    separation: float,
    bend: float,
    share: float,
    length: float,
    seed: int,
    quiet: bool = False,
) -> Laid:
    """Lay fibres.

    Parameters
    ----------
    strands : Strands
    sides : three floats
        Of the box, edges.
    separation : float
        Distance of two fibres over the sum of their radii.
    bend : float
        How far a fibre wanders from its mean direction.
    share : float
        Of the box that fibres fill, where they do not run through each other.
    length : float
        Of a fibre, over the longest side.
    seed : int
    quiet : bool
        Report no progress.
    """
    box = np.asarray(sides, np.float64)
    draw = generator(seed, _STAGE)
    long = length * float(box.max())
    count = max(1, round(share * float(np.prod(box)) / (strands.section * long)))
    radii = strands.radii[drawn_evenly(strands.weights, count, draw)]
    places = _chains(strands, box, count, long, bend, draw)
    every = places.shape[1]
    radius = np.repeat(radii, every)
    window = 2 * max(1, round(_STIFF / APART / 2)) + 1

    def near(flat: np.ndarray) -> np.ndarray:
        reach = _NEAR * separation * radius + _SLACK
        pairs = neighbour_pairs(np.mod(flat, box), reach, box)
        return np.asarray(pairs[pairs[:, 0] // every != pairs[:, 1] // every])

    def moved(flat: np.ndarray, moves: np.ndarray) -> np.ndarray:
        return flat + _averaged(moves.reshape(places.shape), window).reshape(-1, 3)

    flat, lacking = push_apart(
        places.reshape(-1, 3),
        near,
        lambda at, grown: partial(_push, at, radius, box, grown * separation),
        moved,
        steps=_STEPS,
        size=count * every * strands.mean_radius,
        label="" if quiet else "laying fibres",
    )
    return Laid(flat.reshape(places.shape), radii, box, lacking)


def _chains(
    strands: Strands,
    box: np.ndarray,
    count: int,
    long: float,
    bend: float,
    draw: np.random.Generator,
) -> np.ndarray:
    """Return chains of places (count, k, 3) that begin anywhere."""
    step = APART * strands.mean_radius
    every = max(2, ceil(long / step) + 1)
    ways = _drawn_ways(strands.directions, count, draw)
    ways = ways * np.where(draw.random((count, 1)) < 0.5, -1.0, 1.0)
    keep = 1 - APART / _WANDER
    drift = bend * draw.standard_normal((count, 3))
    places = np.empty((count, every, 3))
    places[:, 0] = draw.random((count, 3)) * box
    for k in range(1, every):
        turned = ways + drift
        turned /= np.sqrt((turned**2).sum(axis=1, keepdims=True))
        places[:, k] = places[:, k - 1] + step * turned
        fresh = bend * draw.standard_normal((count, 3))
        drift = keep * drift + np.sqrt(1 - keep**2) * fresh
    return places


def _drawn_ways(directions: np.ndarray, count: int, draw: np.random.Generator) -> np.ndarray:
    """Return `count` of the directions (n, 3), evenly spread over them, in random order."""
    ahead = directions * np.where(directions[:, 1:2] < 0, -1.0, 1.0)
    band = np.floor(_BANDS * (ahead[:, 0] + 1) / 2).astype(np.int64)
    along = ahead[:, 2] * np.where(band % 2, -1.0, 1.0)  # to and fro, so that ends of bands meet
    order = np.lexsort((along, band))
    marks = (np.arange(count) + draw.random()) / count * len(order)
    return np.asarray(ahead[draw.permutation(order[marks.astype(np.int64) % len(order)])])


def _averaged(moves: np.ndarray, window: int) -> np.ndarray:
    """Return moves (n, k, 3) averaged twice over a window along fibres, and not too far."""
    half, mean = window // 2, moves
    for _ in range(2):
        beyond = np.pad(mean, ((0, 0), (half, half), (0, 0)), mode="symmetric")
        sums = np.cumsum(np.pad(beyond, ((0, 0), (1, 0), (0, 0))), axis=1)
        mean = (sums[:, window:] - sums[:, :-window]) / window
    length = np.sqrt((mean**2).sum(axis=2, keepdims=True))
    return np.asarray(mean * np.minimum(1, _FARTHEST / np.maximum(length, 1e-12)))


def draw_fibres(laid: Laid, shape: Sequence[int], steps: np.ndarray, fillet: float) -> np.ndarray:
    """Return how deep voxels lie in the nearest fibre: as `depth_field`, of the pieces between two
    places of a fibre.
    """
    ways = np.diff(laid.places, axis=1).reshape(-1, 3)
    ends = laid.places[:, :-1].reshape(-1, 3)
    radii = np.repeat(laid.radii, laid.places.shape[1] - 1)
    half = 0.5 * np.sqrt((ways**2).sum(axis=1))
    return depth_field(
        partial(_draw, ends, ways, radii, steps),
        ends + ways / 2,
        radii + REACH + half,
        laid.sides,
        shape,
        steps,
        fillet,
    )


@kernel
def _push(places, radius, sides, separation, pairs, pushes, start, stop):
    """Write for pairs start..stop the move of the second place (3), and what the two lack of their
    distance.
    """
    for k in range(start, stop):
        i, j = pairs[k]
        dz, dy, dx = offset_between(places[i], places[j], sides)
        length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
        lack = max(separation * (radius[i] + radius[j]) - length, 0.0)
        write_push(pushes[k], _PUSH * lack, dz, dy, dx, length)
        pushes[k, 3] = lack


@kernel
def _draw(ends, ways, radii, steps, copies, field, margin, start, stop):
    """Raise planes start..stop of a field, whose voxel `margin` is the box's first, to the depth in
    copies of the pieces from their ends along their ways.
    """
    for k in range(len(copies.owners)):
        i, low, high = copies.owners[k], copies.starts[k], copies.stops[k]
        bz, by, bx = ways[i]
        square = bz * bz + by * by + bx * bx + 1e-12
        far = radii[i] + REACH
        pz, py, px = ends[i] + copies.shifts[k]
        for z in range(max(low[0], start), min(high[0], stop)):
            dz = (z - margin[0] + 0.5) * steps[0] - pz
            for y in range(low[1], high[1]):
                dy = (y - margin[1] + 0.5) * steps[1] - py
                for x in range(low[2], high[2]):
                    dx = (x - margin[2] + 0.5) * steps[2] - px
                    t = min(max((dz * bz + dy * by + dx * bx) / square, 0.0), 1.0)
                    ez, ey, ex = dz - t * bz, dy - t * by, dx - t * bx
                    off = ez * ez + ey * ey + ex * ex
                    if off < far * far:
                        depth = np.float32(radii[i] - np.sqrt(off))
                        if depth > field[z, y, x]:
                            field[z, y, x] = depth

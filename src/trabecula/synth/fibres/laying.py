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

from trabecula.core.progress import track
from trabecula.core.seeds import generator
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_items
from trabecula.synth.fibres.strands import Strands
from trabecula.synth.shared.packed.depth import REACH, depth_field
from trabecula.synth.shared.packed.drawn import drawn_evenly
from trabecula.synth.shared.packed.neighbours import add_pushes, neighbour_pairs, offset_between

_STEPS = 150
_GROWN = 0.5  # of the steps, until fibres push over their whole distance
_APART = 0.8  # mean radii between two places of a fibre
_WANDER = 20.0  # mean radii along which a direction forgets itself
_BANDS = 9  # of directions, by their first component
_STIFF = 6.0  # mean radii along which moves are averaged, twice
_PUSH, _FARTHEST = 1.0, 0.5  # of what is lacking, a step; edges, at most
_RENEW = 5  # steps with one list of neighbours
_NEAR = 1.15  # sums of radii times separation, and a slack in edges, within which places are near
_SLACK = 0.5
_DONE = 0.005  # of their radii that places lack on average, where steps end
_STAGE = "fibres"


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
    long, mean = length * float(box.max()), float(strands.weights @ strands.radii)
    section = np.pi * float(strands.weights @ strands.radii**2)
    count = max(1, round(share * float(np.prod(box)) / (section * long)))
    radii = strands.radii[drawn_evenly(strands.weights, count, draw)]
    places = _chains(strands, box, count, long, mean, bend, draw)
    every = places.shape[1]
    radius = np.repeat(radii, every)
    window = 2 * max(1, round(_STIFF / _APART / 2)) + 1
    pairs, lacking = np.empty((0, 2), np.int64), 0.0
    for number in range(_STEPS) if quiet else track(range(_STEPS), "laying fibres"):
        flat = places.reshape(-1, 3)
        if number % _RENEW == 0:
            reach = _NEAR * separation * radius + _SLACK
            found = neighbour_pairs(np.mod(flat, box), reach, box)
            pairs = found[found[:, 0] // every != found[:, 1] // every]
        grown = min(1.0, 0.5 + 0.5 * number / (_GROWN * _STEPS))
        pushes = np.empty((len(pairs), 4))
        given = (flat, radius, box, pairs, grown * separation, pushes)
        for_items(partial(_push, *given), len(pairs), least=512)
        lacking = float(pushes[:, 3].sum()) / (len(flat) * mean)
        if grown == 1 and lacking < _DONE:
            break
        moves = np.zeros_like(flat)
        add_pushes(pairs, pushes, moves)
        places = places + _averaged(moves.reshape(places.shape), window)
    return Laid(places, radii, box, lacking)


def _chains(
    strands: Strands,
    box: np.ndarray,
    count: int,
    long: float,
    mean: float,
    bend: float,
    draw: np.random.Generator,
) -> np.ndarray:
    """Return chains of places (count, k, 3) that begin anywhere."""
    step = _APART * mean
    every = max(2, ceil(long / step) + 1)
    ways = _drawn_ways(strands.directions, count, draw)
    ways = ways * np.where(draw.random((count, 1)) < 0.5, -1.0, 1.0)
    keep = 1 - _APART / _WANDER
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
    """Return how deep voxels lie in the nearest fibre, edges, negative outside.

    Parameters
    ----------
    laid : Laid
    shape : three ints
        Voxels from the first corner of its box on; the box repeats.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    fillet : float
        Standard deviation of the Gaussian that rounds it, edges.

    Returns
    -------
    depth : float32 array, (Z, Y, X)
    """
    return depth_field(
        lambda field, margin, a, b: _draw(
            laid.places, laid.radii, laid.sides, steps, margin, field, a, b
        ),
        shape,
        steps,
        fillet,
    )


@kernel
def _push(places, radius, sides, pairs, separation, pushes, start, stop):
    """Write for pairs start..stop the move of the second place (3), and what the two lack of their
    distance.
    """
    for k in range(start, stop):
        i, j = pairs[k]
        dz, dy, dx = offset_between(places[i], places[j], sides)
        length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
        lack = max(separation * (radius[i] + radius[j]) - length, 0.0)
        pushes[k, 0] = _PUSH * lack * dz / length
        pushes[k, 1] = _PUSH * lack * dy / length
        pushes[k, 2] = _PUSH * lack * dx / length
        pushes[k, 3] = lack


@kernel
def _draw(places, radii, sides, steps, margin, field, start, stop):
    """Raise planes start..stop of a field, whose voxel `margin` is the box's first, to the depth in
    fibres, which repeat with the box: of every piece between two places that within a ball around
    its middle.
    """
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    middle, low, high = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(places.shape[0]):
        far = radii[n] + REACH
        for k in range(places.shape[1] - 1):
            one = places[n, k]
            bz, by, bx = places[n, k + 1] - one
            square = bz * bz + by * by + bx * bx + 1e-12
            reach = far + 0.5 * np.sqrt(square)
            middle[0], middle[1], middle[2] = one[0] + bz / 2, one[1] + by / 2, one[2] + bx / 2
            for axis in range(3):
                least = -margin[axis] * steps[axis] - middle[axis] - reach
                most = (field.shape[axis] - margin[axis]) * steps[axis] - middle[axis] + reach
                first[axis] = np.int64(np.ceil(least / sides[axis]))
                last[axis] = np.int64(np.floor(most / sides[axis]))
            for a in range(first[0], last[0] + 1):
                for b in range(first[1], last[1] + 1):
                    for c in range(first[2], last[2] + 1):
                        pz = one[0] + a * sides[0]
                        py = one[1] + b * sides[1]
                        px = one[2] + c * sides[2]
                        for axis in range(3):
                            shift = (a, b, c)[axis] * sides[axis]
                            at = middle[axis] + shift
                            low[axis] = np.int64(np.floor((at - reach) / steps[axis]))
                            low[axis] = max(low[axis] + margin[axis], 0)
                            high[axis] = np.int64(np.ceil((at + reach) / steps[axis])) + 1
                            high[axis] = min(high[axis] + margin[axis], field.shape[axis])
                        for z in range(max(low[0], start), min(high[0], stop)):
                            dz = (z - margin[0] + 0.5) * steps[0] - pz
                            for y in range(low[1], high[1]):
                                dy = (y - margin[1] + 0.5) * steps[1] - py
                                for x in range(low[2], high[2]):
                                    dx = (x - margin[2] + 0.5) * steps[2] - px
                                    t = (dz * bz + dy * by + dx * bx) / square
                                    t = min(max(t, 0.0), 1.0)
                                    ez, ey, ex = dz - t * bz, dy - t * by, dx - t * bx
                                    off = ez * ez + ey * ey + ex * ex
                                    if off < far * far:
                                        depth = np.float32(radii[n] - np.sqrt(off))
                                        if depth > field[z, y, x]:
                                            field[z, y, x] = depth

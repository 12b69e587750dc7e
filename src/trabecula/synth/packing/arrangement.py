"""Bodies in a box that repeats: drawn, turned, dropped anywhere, and pushed apart.

Two bodies push each other along the line between their centres while these are nearer than the sum
of their radii along it times `separation`. Demands grow from half to all of that, so that bodies
pass each other first (after Jodrey and Tory 1985, doi:10.1103/PhysRevA.32.2347, whose balls shrink
instead).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import generator
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_items
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.packing.scan_bodies import ScanBodies
from trabecula.synth.shared.packed.drawn import drawn_evenly
from trabecula.synth.shared.packed.neighbours import add_pushes, neighbour_pairs, offset_between

STEPS = 300
_GROWN = 0.5  # of the steps, until bodies push over their whole distance
_PUSH = 0.35  # of what is lacking, for each of two bodies, a step
_FARTHEST = 0.25  # of its mean radius that a body moves, a step
_RENEW = 5  # steps with one list of neighbours
_NEAR = 1.15  # sums of the largest radii, within which bodies are neighbours
_DONE = 0.005  # of their radii that bodies lack on average, where steps end
_STAGE = "packing"


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Bodies in a box that repeats; n bodies. Lengths are in the smallest voxel edge.

    Attributes
    ----------
    radii : (N, radial_shapes.SIZE) float32
        Of the shapes.
    shapes : (n,) int64
        The shape of every body.
    turns : (n, 3, 3) float64
        From a body's own directions to those of the box.
    places : (n, 3) float64
    sides : (3,) float64
    lacking : float
        What neighbours lack of their distance, over their radii, mean of all bodies.
    """

    radii: np.ndarray
    shapes: np.ndarray
    turns: np.ndarray
    places: np.ndarray
    sides: np.ndarray
    lacking: float


def arrange(
    bodies: ScanBodies,
    sides: Sequence[float] | np.ndarray,
    *,
    separation: float,
    any_way: bool,
    density: float,
    seed: int,
    quiet: bool = False,
) -> Arrangement:
    """Pack bodies.

    Parameters
    ----------
    bodies : ScanBodies
    sides : three floats
        Of the box, edges.
    separation : float
        Distance of two bodies over the sum of their radii.
    any_way : bool
        Whether they are turned any way; else they are mirrored along the axes.
    density : float
        Bodies per volume.
    seed : int
    quiet : bool
        Report no progress.
    """
    box = np.asarray(sides, np.float64)
    draw = generator(seed, _STAGE)
    count = max(1, round(density * float(np.prod(box))))
    shapes = drawn_evenly(bodies.weights, count, draw)
    turns = _turns(count, any_way, draw)
    places = draw.random((count, 3)) * box
    largest = bodies.radii.max(axis=1)[shapes].astype(np.float64)
    mean = bodies.radii.mean(axis=1)[shapes].astype(np.float64)
    pairs = np.empty((0, 2), np.int64)
    lacking = 0.0
    steps = range(STEPS)
    for number in steps if quiet else track(steps, "packing bodies"):
        if number % _RENEW == 0:
            pairs = neighbour_pairs(places, _NEAR * separation * largest, box)
        grown = min(1.0, 0.5 + 0.5 * number / (_GROWN * STEPS))
        pushes = np.empty((len(pairs), 4))
        given = (places, shapes, turns, bodies.radii, box, pairs, grown * separation, pushes)
        for_items(partial(_push, *given), len(pairs), least=512)
        moves = np.zeros_like(places)
        add_pushes(pairs, pushes, moves)
        lacking = float(pushes[:, 3].sum() / mean.sum())
        if grown == 1 and lacking < _DONE:
            break
        length = np.sqrt((moves**2).sum(axis=1))
        moves *= np.minimum(1, _FARTHEST * mean / np.maximum(length, 1e-12))[:, None]
        places = np.mod(places + moves, box)
    return Arrangement(bodies.radii, shapes, turns, places, box, lacking)


def _turns(count: int, any_way: bool, draw: np.random.Generator) -> np.ndarray:
    """Return random rotations (n, 3, 3), or mirrorings of the axes."""
    if not any_way:
        signs = np.where(draw.random((count, 3)) < 0.5, -1.0, 1.0)
        return np.asarray(signs[:, :, None] * np.eye(3))
    four = draw.standard_normal((count, 4))
    w, x, y, z = (four / np.sqrt((four**2).sum(axis=1, keepdims=True))).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


@kernel
def _push(places, shapes, turns, radii, sides, pairs, separation, pushes, start, stop):
    """Write for pairs start..stop the move of the second body (3), and what the two lack of their
    distance.
    """
    for k in range(start, stop):
        i, j = pairs[k]
        dz, dy, dx = offset_between(places[i], places[j], sides)
        length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
        one, two = turns[i], turns[j]
        wanted = separation * (
            radius_towards(
                radii[shapes[i]],
                one[0, 0] * dz + one[1, 0] * dy + one[2, 0] * dx,
                one[0, 1] * dz + one[1, 1] * dy + one[2, 1] * dx,
                one[0, 2] * dz + one[1, 2] * dy + one[2, 2] * dx,
            )
            + radius_towards(
                radii[shapes[j]],
                -two[0, 0] * dz - two[1, 0] * dy - two[2, 0] * dx,
                -two[0, 1] * dz - two[1, 1] * dy - two[2, 1] * dx,
                -two[0, 2] * dz - two[1, 2] * dy - two[2, 2] * dx,
            )
        )
        lack = max(wanted - length, 0.0)
        pushes[k, 0] = _PUSH * lack * dz / length
        pushes[k, 1] = _PUSH * lack * dy / length
        pushes[k, 2] = _PUSH * lack * dx / length
        pushes[k, 3] = lack

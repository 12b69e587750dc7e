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
from typing import NamedTuple

import numpy as np

from trabecula.core.seeds import generator
from trabecula.engine.compile import kernel
from trabecula.synth.packing.beside import Beside
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.packing.scan_bodies import ScanBodies
from trabecula.synth.shared.packed.drawn import drawn_evenly
from trabecula.synth.shared.packed.neighbours import neighbour_pairs, offset_between
from trabecula.synth.shared.packed.pushing import push_apart, write_push

_STEPS, _STEPS_BESIDE = 300, 600  # at most; beside bodies that stand others settle more slowly
_PUSH = 0.35  # of what is lacking, for each of two bodies, a step
_FARTHEST = 0.25  # of its mean radius that a body moves, a step
_NEAR = 1.15  # sums of the largest radii, within which bodies are neighbours
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
    count : int
        Bodies that moved: the first ones; the others stand.
    cut : int
        Of those that moved, such as reach into a known part by more than a voxel.
    """

    radii: np.ndarray
    shapes: np.ndarray
    turns: np.ndarray
    places: np.ndarray
    sides: np.ndarray
    lacking: float
    count: int
    cut: int = 0


class _Start(NamedTuple):
    """Bodies before they are pushed apart, the first `moving` of which move (see `Arrangement`)."""

    radii: np.ndarray
    shapes: np.ndarray
    turns: np.ndarray
    places: np.ndarray
    moving: int


def arrange(
    bodies: ScanBodies,
    sides: Sequence[float] | np.ndarray,
    *,
    separation: float,
    any_way: bool,
    density: float,
    seed: int,
    beside: Beside | None = None,
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
    beside : Beside, optional
        The free part of the box, and bodies that stand in it.
    quiet : bool
        Report no progress.
    """
    box = np.asarray(sides, np.float64)
    draw = generator(seed, _STAGE)
    start = _scatter if beside is None else partial(_scatter_beside, beside)
    radii, shapes, turns, places, count = start(bodies, box, density, any_way, draw)
    largest = radii.max(axis=1)[shapes].astype(np.float64)
    mean = radii.mean(axis=1)[shapes].astype(np.float64)

    def near(at: np.ndarray) -> np.ndarray:
        pairs = neighbour_pairs(at, _NEAR * separation * largest, box)
        return pairs[pairs.min(axis=1) < count]

    def moved(at: np.ndarray, moves: np.ndarray) -> np.ndarray:
        if beside is not None:
            moves[count:] = 0
            moves[:count] += beside.push(at[:count], shapes, turns, radii)[0]
        length = np.sqrt((moves**2).sum(axis=1))
        moves *= np.minimum(1, _FARTHEST * mean / np.maximum(length, 1e-12))[:, None]
        return np.asarray(np.mod(at + moves, box))

    places, lacking = push_apart(
        places,
        near,
        lambda at, grown: partial(_push, at, shapes, turns, radii, box, grown * separation),
        moved,
        steps=_STEPS if beside is None else _STEPS_BESIDE,
        size=float(mean.sum()),
        label="" if quiet else "packing bodies",
    )
    cut = 0
    if beside is not None:
        cut = int((beside.push(places[:count], shapes, turns, radii)[1] > 1).sum())
    return Arrangement(radii, shapes, turns, places, box, lacking, count, cut)


def _scatter(
    bodies: ScanBodies, box: np.ndarray, density: float, any_way: bool, draw: np.random.Generator
) -> _Start:
    """Return bodies anywhere in a box."""
    count = max(1, round(density * float(np.prod(box))))
    shapes = drawn_evenly(bodies.weights, count, draw)
    turns = _turns(count, any_way, draw)
    return _Start(bodies.radii, shapes, turns, draw.random((count, 3)) * box, count)


def _scatter_beside(
    beside: Beside,
    bodies: ScanBodies,
    box: np.ndarray,
    density: float,
    any_way: bool,
    draw: np.random.Generator,
) -> _Start:
    """Return bodies in the free part of a box, as many as it wants beside those that stand, and
    these.
    """
    stand = beside.standing
    taken = bodies.density * beside.covered / bodies.fraction
    count = max(0, round(density * beside.volume - taken))
    shapes = drawn_evenly(bodies.weights, count, draw)
    turns = _turns(count, any_way, draw)
    places = beside.drop(bodies.radii.mean(axis=1)[shapes], draw)
    still = np.broadcast_to(np.eye(3), (len(stand.places), 3, 3))
    return _Start(
        np.concatenate([bodies.radii, stand.radii]),
        np.append(shapes, len(bodies.radii) + np.arange(len(stand.places))),
        np.concatenate([turns, still]),
        np.concatenate([places, np.mod(stand.places, box)]),
        count,
    )


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
def _push(places, shapes, turns, radii, sides, separation, pairs, pushes, start, stop):
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
        write_push(pushes[k], _PUSH * lack, dz, dy, dx, length)
        pushes[k, 3] = lack

"""Growth by particles in rounds (Baravalle et al. 2016, section 3, algorithms 1 and 2).

A particle has the voxels that it occupies and a contour of voxels that it may take next. In a round
every position of every contour asks for its voxel at once. It gets it where no other particle
stands within the separation; of those that ask for voxels within the separation of each other the
one of lower rank, drawn anew for every particle and round. So no order of work shows. An occupied
voxel adds its neighbours to the contour: all, or where there is a flow the one along the flow and
each of the others with the probability `randomness`. A particle whose contour is empty is dead.

In the kernels volumes are (Z, Y, X), pictures (1, Y, X); positions are flat indices. `near` holds,
for every voxel, the one bubble within the separation, FREE, or SHARED between several; `claim` the
bubble that asks for it in this round.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.random import below, philox
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.growth import Growth

FREE, SHARED = -1, -2


@inline
def _neighbour(place, step, sides, wraps):
    """Return the flat index `step` away from a place (z, y, x), or -1 outside."""
    index = 0
    for axis in range(3):
        at = place[axis] + step[axis]
        side = sides[axis]
        if at < 0 or at >= side:
            if not wraps[axis]:
                return -1
            at %= side
        index = index * side + at
    return index


@inline
def _place(index, sides):
    """Return z, y, x of a flat index."""
    across = sides[1] * sides[2]
    return index // across, index // sides[2] % sides[1], index % sides[2]


@kernel
def draw_ranks(rank, key):
    """Draw the ranks of the bubbles for a round: by chance, no two alike."""
    for i in range(len(rank)):
        rank[i] = np.int64(philox(key, i, 0, 0, 0)[0]) << 31 | i


@kernel
def ask_voxels(positions, bubbles, rank, near, claim, keep):
    """Register the lowest rank that asks for the voxel of every contour position.

    `keep` is False where none can. The same request twice is kept once: the second finds the first.
    """
    for k in range(len(positions)):
        v, i = positions[k], bubbles[k]
        keep[k] = (near[v] == FREE or near[v] == i) and claim[v] != i
        if keep[k] and (claim[v] == FREE or rank[i] < rank[claim[v]]):
            claim[v] = i


@kernel
def grant(positions, bubbles, rank, claim, ball, sides, wraps, keep, won):
    """Give a voxel where no other bubble of lower rank asks for one within the separation."""
    for k in range(len(positions)):
        v, i = positions[k], bubbles[k]
        won[k] = keep[k] and claim[v] == i
        if not won[k]:
            continue
        place = _place(v, sides)
        for b in range(len(ball)):
            w = _neighbour(place, ball[b], sides, wraps)
            if w >= 0 and claim[w] >= 0 and claim[w] != i and rank[claim[w]] < rank[i]:
                won[k] = False
                break


@kernel
def occupy_voxels(positions, bubbles, won, near, ball, sides, wraps, open_):
    """Give winners their voxels, and close those within the separation to all other bubbles."""
    for k in range(len(positions)):
        if not won[k]:
            continue
        i = bubbles[k]
        open_[positions[k]] = 1
        place = _place(positions[k], sides)
        for b in range(len(ball)):
            w = _neighbour(place, ball[b], sides, wraps)
            if w >= 0 and near[w] != i:
                near[w] = i if near[w] == FREE else SHARED


@kernel
def spread_contours(
    positions,
    bubbles,
    won,
    directions,
    allowed,
    threshold,
    steps,
    sides,
    wraps,
    open_,
    key,
    found,
    owner,
):
    """Add neighbours of the winners to their contours: the one along the flow, others by chance.

    This is algorithm 2; without a direction every neighbour is added (algorithm 1). Returns the
    number written to `found` and `owner`.
    """
    count = 0
    ahead = np.zeros(3, np.int64)
    for k in range(len(positions)):
        if not won[k]:
            continue
        v = positions[k]
        place = _place(v, sides)
        flows = _ahead(directions, v, ahead, key)
        for s in range(len(steps)):
            w = _neighbour(place, steps[s], sides, wraps)
            if w < 0 or open_[w] or not allowed[w]:
                continue
            along = steps[s, 0] == ahead[0] and steps[s, 1] == ahead[1] and steps[s, 2] == ahead[2]
            if flows and not along and philox(key, v & 0xFFFFFFFF, v >> 32, s, 0)[0] >= threshold:
                continue
            found[count] = w
            owner[count] = bubbles[k]
            count += 1
    return count


@inline
def _ahead(directions, v, ahead, key):
    """Draw the neighbour along the flow so that steps follow its direction on average.

    Returns False without a flow. The nearest neighbour of the solution, as in the paper, would turn
    all directions into multiples of 45 degrees.
    """
    if directions.shape[0] == 0:
        return False
    axes = directions.shape[1]
    most = 0
    for a in range(axes):
        most = max(most, abs(int(directions[v, a])))
    words = philox(key, v & 0xFFFFFFFF, v >> 32, 0, 1)
    ahead[:] = 0
    for a in range(axes):
        size = np.int64(directions[v, a])
        if most > 0 and below(words[a], most) < abs(size):
            ahead[3 - axes + a] = 1 if size > 0 else -1
    return most > 0


_SCALE = 2**32
_MANY = 2**31  # rounds: contours are empty long before


@dataclass(frozen=True)
class Grown:
    """Particles after their last round.

    Attributes
    ----------
    air : bool array
        What they occupy.
    rounds : int
        How many there were.
    alive : int
        Particles whose contours were not empty at the end.
    """

    air: np.ndarray
    rounds: int
    alive: int


def grow_particles(
    seeds: np.ndarray,
    shape: tuple[int, ...],
    *,
    seed: int,
    separation: float = 1.0,
    randomness: float = 1.0,
    directions: np.ndarray | None = None,
    room: np.ndarray | None = None,
    periodic: Sequence[bool] = (),
    rounds: int | None = None,
    porosity: float | None = None,
) -> Grown:
    """Grow particles from seeds.

    Parameters
    ----------
    seeds : (n, d) int array
        Voxels that they start from, d = 2 or 3; those outside of the room, or within the separation
        of others, may get none.
    shape : d int
    seed : int
    separation : float
        Voxels of mass between particles, at least: none stands nearer than separation + 1 to
        another.
    randomness : float
        0 .. 1: the probability of a neighbour that the flow does not lead to.
    directions : (..., d) int8 array, optional
        The flow at every voxel, in any scale; zeros where there is none.
    room : bool array, optional
        Where particles may be. Default: everywhere.
    periodic : d bool
    rounds : int, optional
        Stop after so many. Default: when every contour is empty.
    porosity : float, optional
        Stop when this share of the room is air, to the voxel.

    Raises
    ------
    InputError
        The porosity is not reached; the message has the highest one in reach.
    """
    field = _ParticleField(shape, separation, periodic, room, directions)
    inside = seeds if room is None else seeds[room[tuple(seeds.T)]]
    contour = np.ravel_multi_index(tuple(inside.T), shape), np.arange(len(inside), dtype=np.int32)
    total = int(np.prod(shape)) if room is None else int(np.count_nonzero(room))
    goal = None if porosity is None else round(porosity * total)
    threshold = np.uint64(round(randomness * _SCALE))
    rank = np.empty(len(inside), np.int64)
    last, taken = 0, 0
    for last in track(
        range(_MANY if rounds is None else rounds), "bubbles", total=rounds or max(shape)
    ):
        draw_ranks(rank, key(seed, f"particles/rank/{last}"))
        left = None if goal is None else goal - taken
        got, contour = field.advance(contour, rank, threshold, key(seed, f"particles/{last}"), left)
        taken += got
        if len(contour[0]) == 0 or taken == goal:
            break
    if goal is not None and taken < goal:
        raise InputError(
            f"a porosity of {porosity:.4f} is not reached: bubbles that stay {separation:g} "
            f"voxels apart fill {taken / max(total, 1):.4f} at most; make the separation smaller, "
            "let them grow longer, or ask for less"
        )
    return Grown(field.air.reshape(shape).view(bool), last + 1, len(np.unique(contour[1])))


class _ParticleField:
    """Occupied voxels, claims and room of a run."""

    def __init__(
        self,
        shape: tuple[int, ...],
        separation: float,
        periodic: Sequence[bool],
        room: np.ndarray | None,
        directions: np.ndarray | None,
    ) -> None:
        flat = 3 - len(shape)
        self.sides = np.array((1,) * flat + tuple(shape), np.int64)
        self.wraps = np.array((False,) * flat + tuple(periodic or (False,) * len(shape)))
        self.ball = _offsets(int(separation + 1), len(shape), separation + 1)
        self.steps = _offsets(1, len(shape), 2)
        work = Workspace(particle_stages(shape, flows=directions is not None))
        work.enter("rounds")
        if room is None:
            self.allowed = work.full("allowed", True)
        else:
            self.allowed = work.adopt("allowed", np.ascontiguousarray(room).ravel())
        self.directions = np.zeros((0, len(shape)), np.int8)
        if directions is not None:
            vectors = np.ascontiguousarray(directions).reshape(-1, len(shape))
            self.directions = work.adopt("directions", vectors)
        self.near, self.claim = work.full("near", FREE), work.full("claim", FREE)
        self.air = work.zeros("air")

    def advance(
        self,
        contour: tuple[np.ndarray, np.ndarray],
        rank: np.ndarray,
        threshold: np.uint64,
        words: np.uint64,
        left: int | None,
    ) -> tuple[int, tuple[np.ndarray, np.ndarray]]:
        """Do one round; return the number of voxels taken, and the contour for the next round."""
        positions, bubbles = contour
        keep, won = np.empty(len(positions), bool), np.empty(len(positions), bool)
        ask_voxels(positions, bubbles, rank, self.near, self.claim, keep)
        grant(positions, bubbles, rank, self.claim, self.ball, self.sides, self.wraps, keep, won)
        self.claim[positions] = FREE
        if left is not None and np.count_nonzero(won) > left:
            # The last round: ranks, then places, decide who still gets a voxel.
            order = np.lexsort((positions, rank[bubbles], ~won))
            won[order[left:]] = False
        occupy_voxels(
            positions, bubbles, won, self.near, self.ball, self.sides, self.wraps, self.air
        )
        count = int(np.count_nonzero(won))
        found = np.empty(count * len(self.steps), np.int64)
        owner = np.empty(count * len(self.steps), np.int32)
        lattice = (self.steps, self.sides, self.wraps, self.air)
        flow = (self.directions, self.allowed, threshold)
        new = spread_contours(positions, bubbles, won, *flow, *lattice, words, found, owner)
        lost = keep & ~won
        return count, (
            np.concatenate([positions[lost], found[:new]]),
            np.concatenate([bubbles[lost], owner[:new]]),
        )


def _offsets(reach: int, axes: int, below: float) -> np.ndarray:
    """Return the steps (n, 3) to neighbours nearer than `below`, without the place itself."""
    steps = [
        step
        for step in product(range(-reach, reach + 1), repeat=axes)
        if 0 < np.hypot.reduce(step) < below
    ]
    return np.array([(0,) * (3 - axes) + step for step in steps], np.int64).reshape(-1, 3)


_CONTOURS = 100  # bytes a voxel of contours, and of the positions that they ask for


def particle_stages(shape: tuple[int, ...], *, flows: bool) -> tuple[Stage, ...]:
    """Declare the arrays of the rounds."""
    voxels = math.prod(shape)
    arrays = {
        "allowed": Array(voxels, bool),
        "near": Array(voxels, np.int32),
        "claim": Array(voxels, np.int32),
        "air": Array(voxels, np.uint8),
        "directions": Array((voxels, len(shape)), np.int8) if flows else None,
    }
    return (Stage("rounds", arrays, _CONTOURS * voxels),)


def grow_request(
    growth: Growth, config: BubblesConfig, request: Request, porosity: float | None
) -> Grown:
    """Grow the bubbles of a request by particles, in its mask and its room."""
    shape, ndim = request.shape, len(request.shape)
    box = tuple((0, side) for side in shape)
    flow = growth.flow if config.randomness < 1 else None
    room = growth.room(box if ndim == 3 else ((0, 1), *box))
    room = (
        request.mask
        if room is None
        else room.reshape(shape) & (True if request.mask is None else request.mask)
    )
    return grow_particles(
        _starts(growth, shape),
        shape,
        seed=request.seed,
        separation=growth.law.wall,
        randomness=config.randomness,
        directions=None if flow is None else flow.directions(box),
        room=room,
        periodic=request.periodic,
        rounds=None if config.time is None else round(growth.law.latest),
        porosity=porosity,
    )


def _starts(growth: Growth, shape: Sequence[int]) -> np.ndarray:
    """Return the voxels (N, d) from which the bubbles of a request start."""
    deep = (1,) * (3 - len(shape)) + tuple(shape)
    places = growth.world(tuple((0, side) for side in deep))[1][1]
    voxels = np.floor(places).astype(np.int64)
    inside = ((voxels >= 0) & (voxels < deep)).all(1)
    return voxels[inside][:, 3 - len(shape) :]

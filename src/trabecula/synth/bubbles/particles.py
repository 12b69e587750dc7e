"""Growth by particles, as Baravalle et al. (2016) state it (section 3, algorithms 1 and 2), in
rounds.

A particle has the voxels that it occupies and a contour of voxels that it may take next. In a round
every position of every contour asks for its voxel at once. It gets it where no other particle
stands within the separation; of those that ask for voxels within the separation of each other the
one of lower rank, drawn anew for every particle and round. So no order of work shows. What is taken
adds its neighbours to the contour: all, or where there is a flow the one that the flow leads to and
each of the others with the probability `randomness`. A particle whose contour is empty is dead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.synth.bubbles.particle_kernels import FREE, ask, draw, judge, occupy, spread

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


def grown(
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
    """Let particles grow.

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
        The porosity is not reached; the message tells the most that is.
    """
    field = _Field(shape, separation, periodic, room, directions)
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
        draw(rank, key(seed, f"particles/rank/{last}"))
        left = None if goal is None else goal - taken
        got, contour = field.round(contour, rank, threshold, key(seed, f"particles/{last}"), left)
        taken += got
        if len(contour[0]) == 0 or taken == goal:
            break
    if goal is not None and taken < goal:
        raise InputError(
            f"a porosity of {porosity:.4f} is not reached: bubbles that stay {separation:g} voxels apart fill "
            f"{taken / max(total, 1):.4f} at most; make the separation smaller, let them grow longer, or ask for less"
        )
    return Grown(field.air.reshape(shape).view(bool), last + 1, len(np.unique(contour[1])))


class _Field:
    """What stands where."""

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
        size = int(self.sides.prod())
        self.allowed = np.ones(size, bool) if room is None else np.ascontiguousarray(room).ravel()
        empty = np.zeros((0, len(shape)), np.int8)
        self.directions = (
            empty
            if directions is None
            else np.ascontiguousarray(directions).reshape(size, len(shape))
        )
        self.near, self.claim = np.full(size, FREE, np.int32), np.full(size, FREE, np.int32)
        self.air = np.zeros(size, np.uint8)

    def round(
        self,
        contour: tuple[np.ndarray, np.ndarray],
        rank: np.ndarray,
        threshold: np.uint64,
        words: np.uint64,
        left: int | None,
    ) -> tuple[int, tuple[np.ndarray, np.ndarray]]:
        """How many voxels were taken, and the contour for the next round."""
        positions, bubbles = contour
        keep, won = np.empty(len(positions), bool), np.empty(len(positions), bool)
        ask(positions, bubbles, rank, self.near, self.claim, keep)
        judge(positions, bubbles, rank, self.claim, self.ball, self.sides, self.wraps, keep, won)
        self.claim[positions] = FREE
        if left is not None and np.count_nonzero(won) > left:
            # The last round: the order of ranks, then of places, says who is still served.
            order = np.lexsort((positions, rank[bubbles], ~won))
            won[order[left:]] = False
        occupy(positions, bubbles, won, self.near, self.ball, self.sides, self.wraps, self.air)
        count = int(np.count_nonzero(won))
        found, owner = (
            np.empty(count * len(self.steps), np.int64),
            np.empty(count * len(self.steps), np.int32),
        )
        new = spread(
            positions, bubbles, won, self.directions, self.allowed, threshold, self.steps, self.sides, self.wraps, self.air,
            words, found, owner,
        )  # fmt: skip
        lost = keep & ~won
        return count, (
            np.concatenate([positions[lost], found[:new]]),
            np.concatenate([bubbles[lost], owner[:new]]),
        )


def _offsets(reach: int, axes: int, below: float) -> np.ndarray:
    """Steps (n, 3) to what lies nearer than `below`, but for the place itself."""
    steps = [
        step
        for step in product(range(-reach, reach + 1), repeat=axes)
        if 0 < np.hypot.reduce(step) < below
    ]
    return np.array([(0,) * (3 - axes) + step for step in steps], np.int64).reshape(-1, 3)

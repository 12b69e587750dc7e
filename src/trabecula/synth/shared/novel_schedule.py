"""Where new material begins, and the passes from there to the finest level (`novel_layout`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.image import Image

COARSEST = 2
"""The level that is laid out, at most: 4 times coarser than the result."""

LEAST = 8
"""Voxels that the exemplar and the result need on that level along every axis."""

WIDTH, WIDEST = 6, 8
"""Of the neighbourhoods of passes, voxels: those that keep interfaces and forget where these led,
and those that keep bodies."""

_FINE = {"rounds": 1.0, "structure": 1.5}
"""Voxels that the structure's length has at least on level 2, by layout: where it has fewer, bodies
lose their form, or are copied whole."""

_ROOMY = 20
"""Voxels that the exemplar has there along every axis for wide neighbourhoods."""

_NARROW_BELOW = 2.0
"""Voxels of the structure's length below which a wide neighbourhood on level 1 holds several
bodies, and rounds from noise copy them together."""

# rounds of search and vote from noise: on level 2, then on level 1; on level 1 where it comes first
_FROM_NOISE, _THEN, _FIRST = 10, 8, 8
_BY_LEAVES = 16  # of each of them, where leaves are searched
_MOVED = 16  # more rounds on the coarsest level at hardly any novelty
_WIDE_FROM = 5  # so many of them let finer levels have wide neighbourhoods


@dataclass(frozen=True)
class Start:
    """Where new material begins.

    Attributes
    ----------
    level : int
        That is laid out; 0 where there is no room for one.
    width : int
        Of the neighbourhoods that rounds from noise begin with, voxels.
    """

    level: int
    width: int = WIDEST


@dataclass(frozen=True)
class Pass:
    """Rounds of search and vote on one level, each followed by `steps` on the two-point function.

    `beyond` says how far the last round aims beyond the target, in what the rounds before fell
    short of it: the next pass takes some of that back. Nothing comes after the last pass, which is
    on target. `roughest` is the most interface that a step may leave, over the target's: of a pass
    that goes beyond, a vote smooths some away. The first round starts from random matches, or from
    those of the pass before where they are `carried`, and searches `first` times as long. With
    `by_leaves` every round searches the leaf of each neighbourhood (`halving_tree`), and then
    sweeps once: of beads the mean distance in round 8 is 1.04 times the least there is, 1.10 times
    after sweeps alone.
    """

    level: int
    width: int
    step: int
    rounds: int
    steps: int
    beyond: float = 1.0
    roughest: float = 1.0
    first: int = 3
    carried: bool = False
    by_leaves: bool = False

    def sweeps(self, number: int, each: int) -> int:
        """Count the sweeps of round `number`, with `each` in the settings."""
        if self.by_leaves:
            return 2
        return each if number else each * self.first


def passes(
    novelty: float, start: Start, layout: str, *, by_leaves: bool = False, beside: bool = False
) -> tuple[Pass, ...]:
    """List the passes from the level that is laid out to the finest one.

    Less than full novelty lets more neighbourhoods of the exemplar into the layout, and after
    sliced rounds widens those of finer levels. `by_leaves`, from noise, bodies come nearer to the
    exemplar's: coarse levels have more rounds with a better search, and the finest one begins with
    wide neighbourhoods. In a hole `beside` known voxels there are no steps: it is too small to
    have the two-point function of the material, and interfaces would be cut into combs for it.
    """
    moved = round(_MOVED * (1 - novelty))
    whole, sliced = is_whole(layout), is_sliced(layout)
    if sliced:
        coarser = _after_slices(start.level, moved, whole=whole)
        wide = moved >= _WIDE_FROM or (whole and start.level == 1)
        first = WIDTH if wide else 5
    else:
        coarser = _from_noise(start, moved, by_leaves=by_leaves)
        first = WIDEST if by_leaves else WIDTH
    finest = (
        Pass(0, first, 2, 2, 2, beyond=1.7, roughest=1.1),
        Pass(0, WIDTH, 2, 1, 1, beyond=0.0),
    )
    if whole:
        finest = (
            replace(finest[0], steps=4, first=2),
            replace(finest[1], steps=2, first=1, carried=True),
        )
    every = (*coarser, *finest)
    if beside:
        return tuple(replace(p, steps=0, beyond=0.0) for p in every)
    return every


def _from_noise(start: Start, moved: int, *, by_leaves: bool) -> tuple[Pass, ...]:
    """List the passes that make bodies of noise."""
    if start.level < COARSEST:
        rounds = _BY_LEAVES if by_leaves else _FIRST
        return (Pass(1, start.width, 2, rounds + moved, 1, by_leaves=by_leaves),)
    rounds, then = (_BY_LEAVES, _BY_LEAVES) if by_leaves else (_FROM_NOISE, _THEN)
    return (
        Pass(2, start.width, 1, rounds + moved, 1, by_leaves=by_leaves),
        Pass(1, WIDEST, 2, then, 1, by_leaves=by_leaves),
    )


def _after_slices(top: int, moved: int, *, whole: bool) -> tuple[Pass, ...]:
    """List the passes on coarse levels that follow sliced rounds."""
    if top == COARSEST:
        wide = WIDEST if moved >= _WIDE_FROM else WIDTH
        then = Pass(1, wide, 1, 4, 4)
        return (Pass(2, WIDEST, 1, moved, 2), then) if moved else (then,)
    return (Pass(1, WIDEST, 2, 4 + moved, 4),) if whole else ()


def is_whole(layout: str) -> bool:
    """Return whether a layout is on the level of the structure, and its steps see all directions of
    a torus; the oldest is not, and does not.
    """
    return layout != "coarse"


def is_sliced(layout: str) -> bool:
    """Return whether sliced rounds make the coarse level; else it begins with noise."""
    return layout != "rounds"


def structure_length(exemplars: Sequence[Image]) -> float:
    """Return 4 phi (1 - phi) / s in voxels, with the share phi of the first phase and the surface s
    between phases per volume: the mean of the mean chords of two phases, weighted crosswise.
    Infinite without a surface, as of several exemplars of one phase each.
    """
    first = min(int(image.values.min()) for image in exemplars)
    size = sum(image.values.size for image in exemplars)
    share = sum(int(np.count_nonzero(image.values == first)) for image in exemplars) / size
    surface = sum(
        float(np.mean(np.diff(image.values, axis=axis) != 0)) * image.values.size / size
        for image in exemplars
        for axis in range(image.ndim)
    )
    return 4 * share * (1 - share) / surface if surface else math.inf


def start_of(exemplars: Sequence[Image], layout: str) -> Start:
    """Return where material begins that is like these exemplars, for their size and structure (of
    grey values or colours: for their size).
    """
    smallest = min(min(image.shape) for image in exemplars)
    length = structure_length(exemplars) if exemplars[0].kind == "labels" else math.inf
    level = COARSEST
    if is_whole(layout) and length < _FINE[layout] * 2**COARSEST:
        level = 1
    if not is_sliced(layout) and smallest < _ROOMY * 2**COARSEST:
        level = 1
    while level and smallest // 2**level < LEAST:
        level -= 1
    return Start(level, WIDTH if length < _NARROW_BELOW else WIDEST)


def has_room(shape: tuple[int, ...], top: int) -> bool:
    """Return whether a result is large enough to be laid out on level `top`."""
    return min(shape) >= LEAST * 2**top

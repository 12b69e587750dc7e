"""A run: places in raster order; at each the best candidates are laid down and judged until one may stay.

What a place needs in turn: the window of what is made, the words of its overlap, the candidates near its target with their
mismatches, and then, candidate by candidate, the seam and the verdict.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import checkpoint
from trabecula.synth.quilt.begin import canvas_for, frame_for
from trabecula.synth.quilt.bodies import FINE, SOLID, Bodies, Judge, classes_for
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.cut import ALL, LEAST, MOST, seamed
from trabecula.synth.quilt.learnt import Learnt, void_of
from trabecula.synth.quilt.marks import EMPTY, FIXED, OUT
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.places import Own, targets_at
from trabecula.synth.quilt.pools import SCALE, WEIGHT, Descriptors, Pools
from trabecula.synth.quilt.ranking import Ranked, Ranker
from trabecula.synth.quilt.thin import thin_voxels
from trabecula.synth.quilt.trace import Trace
from trabecula.synth.quilt.windows import box_of, near_empty
from trabecula.synth.quilt.words import Query, query_of

_WIDER, _WIDEST = 4, 2  # times as many candidates where those looked at do not fit; so often
_FEWEST = 8  # candidates
_PATIENCE = 4  # candidates judged in the hope of one that begins no new body
_ISLAND = 0.02  # share of a box that a body may have and be painted over
_STAGE = "quilt"


class _Piece(NamedTuple):
    """A candidate as it would come to lie."""

    at: int
    mismatch: int
    difference: int
    window: np.ndarray
    why: str  # what speaks against it
    growth: int  # bodies that it adds


@dataclass
class _Tried:
    """How many candidates of a place were judged, and the best of those with something against them."""

    count: int = 0
    fallback: _Piece | None = None


@dataclass
class _Step:
    """What it takes to take a piece back."""

    place: int
    at: int
    corner: tuple[int, ...]
    old: np.ndarray
    of: np.ndarray
    book: tuple[np.ndarray, ...]


class Run:
    """The state of one run.

    Attributes
    ----------
    canvas : (Z, Y, X) uint8
        Labels; EMPTY, OUT and FIXED + label as `marks` says.
    trace : Trace
    """

    def __init__(self, learnt: Learnt, config: QuiltConfig, request: Request) -> None:
        self.learnt, self.config, self.request = learnt, config, request
        self.frame = frame_for(learnt, request)
        self.canvas = canvas_for(self.frame.shape, request)
        phases = learnt.images[0].phases
        self.void = void_of(phases)
        followed = classes_for(config.connected, self.void, len(phases))
        self.bodies = Bodies(self.canvas, self.frame.wraps, followed) if followed.any() else None
        self.solid = classes_for("solid", self.void, len(phases)) == SOLID
        window = tuple(side + 2 * m for side, m in zip(learnt.box, self.frame.margin, strict=True))
        self.judge = Judge(window, self.frame.margin, island=round(_ISLAND * np.prod(learnt.box)))
        self.window = window
        self.old, self.of = np.empty(window, np.uint8), np.zeros(window, np.int32)  # of the place in hand
        self.target = {name: np.reshape(t, self.frame.shape) if np.ndim(t) else t for name, t in request.target.items()}
        self.mask = None if request.mask is None else request.mask.reshape(self.frame.shape)
        self.own = None if self.target else Own.of(learnt, request.seed)
        names = list(request.target) if self.own is None else list(self.own.fields)
        self.descriptors = Descriptors.of(learnt, names, config.weights)
        self.pools = Pools(learnt, self.descriptors, request.seed)
        stage = key(request.seed, "quilt/choice")
        self.ranker = Ranker(
            learnt.words, self.pools, self.descriptors, config.alpha, config.variety, stage, bool(self.target)
        )
        self.trace = Trace()
        self.placed = np.full(int(np.prod(self.frame.counts)), -1, np.int32)
        self.log: deque[_Step] = deque(maxlen=max(1, config.backtrack))
        self.refused: dict[int, set[int]] = {}
        self.backs: dict[int, int] = {}

    def made(self) -> np.ndarray:
        """Lay all pieces; returns the labels, uint8 (Z, Y, X)."""
        counts = self.frame.counts
        layer = counts[1] * counts[2]
        for done in track(range(self._resumed(), counts[0]), "laying pieces"):
            number = done * layer
            while number < (done + 1) * layer:
                number = self._step(number)
            for memory in (self.log, self.refused, self.backs):
                memory.clear()
            if checkpoint.due():
                checkpoint.offer(
                    _STAGE, done + 1, canvas=self.canvas, placed=self.placed, **self._book(), **self.trace.arrays()
                )
        if self.bodies is not None:
            self._paint_over(self.bodies)
        for values in self.canvas:
            values[values == OUT] = self.void
        self.canvas &= FIXED - 1
        return self.canvas

    def _paint_over(self, bodies: Bodies) -> None:
        """Islands of solid become void, and void that is closed in the solid that there is most of."""
        islands = bodies.islands(self.judge.island)
        solid = np.bincount(self.learnt.stack.ravel(), minlength=2)
        solid[self.void] = 0
        for layer, of in zip(self.canvas, bodies.of, strict=True):
            lost = islands[of] & (layer < FIXED) & (bodies.classes[layer] > 0)
            self.trace.painted += int(np.count_nonzero(lost))
            layer[lost] = np.where(layer[lost] == self.void, np.uint8(solid.argmax()), np.uint8(self.void))

    def _step(self, number: int) -> int:
        """Lay the piece of a place, or take one back; returns the place to go on with."""
        corner = self.frame.corner(number)
        self.old = np.empty(self.window, np.uint8)
        self.frame.cut_out(self.canvas, corner, self.old, OUT)
        box = np.ascontiguousarray(box_of(self.old, self.frame.margin))
        if not (box == EMPTY).any():
            return number + 1
        if self.bodies is not None:
            self.frame.cut_out(self.bodies.of, corner, self.of, 0)
        near = near_empty(box, self.learnt.overlap) if self.request.fixed is not None else box < OUT
        query = query_of(self.learnt.words, box, near, self.learnt.strides[1:])
        piece, tried = self._chosen(number, corner, query)
        if piece.why and self.log and self.backs.get(number, 0) < self.config.backtrack:
            self.backs[number] = self.backs.get(number, 0) + 1
            return self._taken_back()
        self._lay(number, corner, piece)
        share = piece.mismatch / query.voxels if query.voxels else float("nan")
        off = piece.difference / (SCALE * WEIGHT) if self.target else float("nan")
        self.trace.add(corner, share, off, tried, piece.why)
        return number + 1

    def _chosen(self, number: int, corner: tuple[int, ...], query: Query) -> tuple[_Piece, int]:
        """The best candidate that may stay, or else the best with what speaks against it; and how many were judged."""
        pool = self.pools.of(phase_key(corner, self.learnt.periods))
        targets = (
            self.own.at(corner)
            if self.own
            else targets_at(self.target, self.frame, corner, self.learnt.middle, self.mask)
        )
        asked = self.descriptors.scaled(targets)
        before = self._pieces_before(number)
        count = min(self.config.candidates, max(_FEWEST, round(self.config.share * len(pool.at))))
        failed = set(self.refused.get(number, ()))
        tried = _Tried()
        for wider in range(_WIDEST + 1):
            found = self.ranker.ranked(
                query, pool, asked, place=number, count=count * _WIDER**wider, before=before, without=failed
            )
            last = found.complete or wider == _WIDEST
            if wider == 0 and not last and found.least() > self.config.mismatch * query.voxels:
                continue
            piece = self._first_that_may_stay(found, tried, failed)
            if piece is not None or last:
                break
        piece = piece or tried.fallback
        if piece is None:  # all that there are were taken back before
            self.refused.pop(number)
            return self._chosen(number, corner, query)
        return piece, tried.count

    def _first_that_may_stay(self, found: Ranked, tried: _Tried, failed: set[int]) -> _Piece | None:
        """The nearest candidate with nothing against it; if there is one soon, one that begins no new body."""
        good: _Piece | None = None
        for _ in range(self.config.tries):
            n = found.best()
            if n < 0 or (good is not None and tried.count >= _PATIENCE):
                break
            tried.count += 1
            for keep in (LEAST, MOST, ALL):  # what is laid only where nothing was tears nothing
                piece = self._laid_down(found, n, keep)
                if not piece.why and piece.growth <= 0:
                    return piece
                if not piece.why:
                    good = good or piece
                    break
                tried.fallback = tried.fallback or piece
            failed.add(int(found.at[n]))
            found.take_off(n)
        return good

    def _pieces_before(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the pieces before a place along z, y and x begin in the stack, and how far the place lies from them."""
        at, away = [], []
        place = np.unravel_index(number, self.frame.counts)
        by = int(np.prod(self.frame.counts))
        for axis, count in enumerate(self.frame.counts):
            by //= count
            if place[axis] > 0 and self.placed[number - by] >= 0:
                at.append(self.placed[number - by])
                away.append([self.frame.step[axis] if other == axis else 0 for other in range(3)])
        return np.array(at, np.int64), np.array(away, np.int64).reshape(-1, 3)

    def _laid_down(self, found: Ranked, n: int, keep: int) -> _Piece:
        """A candidate cut in along its seam, and judged."""
        at = int(found.at[n])
        piece = self.learnt.piece(at)
        window, _ = seamed(self.old, self.frame.margin, piece, keep=keep)
        why, growth = "", 0
        if self.bodies is not None:
            if self.judge.verdict(self.bodies, self.old, window, self.of) != FINE:
                why = "connectivity"
            growth = self.judge.growth
        if not why and self.config.feature > 1:
            size = self.config.feature
            rim = tuple(min(size - 1, m) for m in self.frame.margin)  # where the window cannot tell
            if thin_voxels(window, rim, size, self.solid) > thin_voxels(self.old, rim, size, self.solid):
                why = "feature size"
        return _Piece(at, int(found.mismatch[n]), int(found.difference[n]), window, why, growth)

    def _lay(self, number: int, corner: tuple[int, ...], piece: _Piece) -> None:
        """Write a piece into the output, and its bodies into the book."""
        book: tuple[np.ndarray, ...] = ()
        of = self.of.copy()
        if self.bodies is not None:
            book = self.judge.enter(self.bodies, self.old, piece.window, self.of)
            self.frame.put_back(self.bodies.of, corner, self.of)
        self.frame.put_back(self.canvas, corner, piece.window)
        self.placed[number] = piece.at
        self.log.append(_Step(number, piece.at, corner, self.old, of, book))

    def _taken_back(self) -> int:
        """Undo the last piece; its place has to do without it."""
        step = self.log.pop()
        self.frame.put_back(self.canvas, step.corner, step.old)
        if self.bodies is not None:
            self.frame.put_back(self.bodies.of, step.corner, step.of)
            self.bodies.restore(step.book)
        self.refused.setdefault(step.place, set()).add(step.at)
        self.trace.drop()
        return step.place

    def _book(self) -> dict[str, np.ndarray]:
        return {} if self.bodies is None else self.bodies.arrays()

    def _resumed(self) -> int:
        state = checkpoint.resumed(_STAGE)
        if state is None:
            return 0
        self.canvas[:], self.placed[:] = state.arrays["canvas"], state.arrays["placed"]
        self.trace = Trace.from_arrays(state.arrays)
        if self.bodies is not None:
            self.bodies.take_over(state.arrays)
        return state.number

"""RUN"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import checkpoint, memmap
from trabecula.synth.quilt.candidates import SCALE, WEIGHT, Descriptors, Pool, Pools, Ranked, Ranker
from trabecula.synth.quilt.canvas import (
    EMPTY,
    OUT,
    Own,
    box_of,
    canvas_for,
    frame_for,
    near_empty,
    paint_islands,
    targets_at,
    unmark,
)
from trabecula.synth.quilt.compatibility import Trace
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import FINE, SOLID, Bodies, Judge, classes_for, thin_voxels
from trabecula.synth.quilt.patch_library import Learnt, Query, query_of, void_of
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.seams import ALL, LEAST, MOST, Struts, seamed

_STAGE = "quilt laid"


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
    placed : int32, one entry a place
        1 + where the piece begins in the stack; 0 where none lies.
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
        self.target = {
            name: np.reshape(t, self.frame.shape) if np.ndim(t) else t
            for name, t in request.target.items()
        }
        self.mask = None if request.mask is None else request.mask.reshape(self.frame.shape)
        self.own = None if self.target else Own.of(learnt, request.seed)
        names = list(request.target) if self.own is None else list(self.own.fields)
        self.descriptors = Descriptors.of(learnt, names, config.weights)
        self.pools = Pools(learnt, self.descriptors, request.seed)
        stage = key(request.seed, "quilt/choice")
        ranker = Ranker(
            learnt.words,
            self.pools,
            self.descriptors,
            config.alpha,
            config.variety,
            config.sieve,
            stage,
            bool(self.target),
        )
        self.chooser = Chooser(learnt, config, ranker, self.bodies, self.frame.margin)
        self.trace = Trace(self.frame)
        self.placed = memmap.zeros(int(np.prod(self.frame.counts)), np.int32)
        self.log: deque[_Step] = deque(maxlen=max(1, config.backtrack))
        self.refused: dict[int, set[int]] = {}
        self.backs: dict[int, int] = {}

    def made(self) -> np.ndarray:
        """Lay all pieces; returns the labels, uint8 (Z, Y, X)."""
        counts = self.frame.counts
        for done in track(range(self._resumed(), counts[0]), "laying pieces"):
            self._lay_layer(done)
            if checkpoint.due():
                checkpoint.offer(
                    _STAGE,
                    done + 1,
                    canvas=self.canvas,
                    placed=self.placed,
                    **self._book(),
                    **self.trace.arrays(),
                )
        if self.bodies is not None:
            self.trace.painted = paint_islands(
                self.canvas,
                self.bodies.of,
                self.bodies.islands(self.chooser.judge.island),
                self.bodies.classes,
                void=self.chooser.struts.void,
                solid=self.chooser.struts.solid,
            )
        unmark(self.canvas, self.void)
        return self.canvas

    def _lay_layer(self, layer: int) -> None:
        """Lay the pieces of one layer of places; none is taken back later."""
        _, rows, places = self.frame.counts
        number, end = layer * rows * places, (layer + 1) * rows * places
        while number < end:
            number = self._step(number)
            if number % places == 0:
                memmap.release_pages()
                self.pools.forget()
        for memory in (self.log, self.refused, self.backs):
            memory.clear()

    def _step(self, number: int) -> int:
        """Lay the piece of a place, or take one back; returns the place to go on with."""
        corner = self.frame.corner(number)
        place = self._place(number, corner)
        if place is None:
            return number + 1
        may_go_back = bool(self.log) and self.backs.get(number, 0) < self.config.backtrack
        piece, tried = self.chooser.chosen(place, last_way=not may_go_back)
        if piece.why and may_go_back:
            self.backs[number] = self.backs.get(number, 0) + 1
            return self._taken_back()
        if place.refused == ():
            self.refused.pop(number, None)
        self._lay(place, corner, piece)
        share = piece.mismatch / place.query.voxels if place.query.voxels else float("nan")
        off = piece.difference / (SCALE * WEIGHT) if self.target else float("nan")
        self.trace.add(number, share, off, tried, piece.strut, piece.why)
        return number + 1

    def _place(self, number: int, corner: tuple[int, ...]) -> Place | None:
        """What there is to know of a place; None where nothing is to be made."""
        learnt, frame = self.learnt, self.frame
        old = np.empty(self.chooser.window, np.uint8)
        frame.cut_out(self.canvas, corner, old, OUT)
        box = np.ascontiguousarray(box_of(old, frame.margin))
        if not (box == EMPTY).any():
            return None
        of = np.zeros(old.shape, np.int32)
        if self.bodies is not None:
            frame.cut_out(self.bodies.of, corner, of, 0)
        near = near_empty(box, learnt.overlap) if self.request.fixed is not None else box < OUT
        targets = (
            self.own.at(corner)
            if self.own
            else targets_at(self.target, frame, corner, learnt.middle, self.mask)
        )
        return Place(
            number,
            old,
            of,
            query_of(learnt.words, box, near, learnt.strides[1:]),
            self.descriptors.scaled(targets),
            self.pools.of(phase_key(corner, learnt.periods)),
            self._pieces_before(number),
            self.refused.get(number, ()),
        )

    def _pieces_before(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the pieces before a place along z, y and x begin in the stack, and how far the
        place lies from them.
        """
        at, away = [], []
        place = np.unravel_index(number, self.frame.counts)
        by = int(np.prod(self.frame.counts))
        for axis, count in enumerate(self.frame.counts):
            by //= count
            if place[axis] > 0 and self.placed[number - by] > 0:
                at.append(self.placed[number - by] - 1)
                away.append([self.frame.step[axis] if other == axis else 0 for other in range(3)])
        return np.array(at, np.int64), np.array(away, np.int64).reshape(-1, 3)

    def _lay(self, place: Place, corner: tuple[int, ...], piece: Piece) -> None:
        """Write a piece into the output, and its bodies into the book."""
        book: tuple[np.ndarray, ...] = ()
        of = place.of
        if self.bodies is not None:
            of = place.of.copy()
            book = self.chooser.judge.enter(self.bodies, place.old, piece.window, place.of)
            self.frame.put_back(self.bodies.of, corner, place.of)
        self.frame.put_back(self.canvas, corner, piece.window)
        self.placed[place.number] = piece.at + 1
        self.log.append(_Step(place.number, piece.at, corner, place.old, of, book))

    def _taken_back(self) -> int:
        """Undo the last piece; its place has to do without it."""
        step = self.log.pop()
        self.frame.put_back(self.canvas, step.corner, step.old)
        if self.bodies is not None:
            self.frame.put_back(self.bodies.of, step.corner, step.of)
            self.bodies.restore(step.book)
        self.refused.setdefault(step.place, set()).add(step.at)
        self.trace.drop(step.place)
        return step.place

    def _book(self) -> dict[str, np.ndarray]:
        return {} if self.bodies is None else self.bodies.arrays()

    def _resumed(self) -> int:
        state = checkpoint.resumed(_STAGE)
        if state is None:
            return 0
        self.canvas, self.placed = state.arrays["canvas"], state.arrays["placed"]
        self.trace.take_over(state.arrays)
        if self.bodies is not None:
            self.bodies.take_over(state.arrays)
        return state.number


_WIDER, _WIDEST = 4, 2  # times as many candidates where those looked at do not fit; so often

_FEWEST = 8  # candidates

_OF_A_LATTICE, _OF_OTHERS = 4, 8  # candidates whose seams are compared

_PATIENCE = 4  # candidates judged in the hope of one that begins no new body

_ISLAND = 0.02  # share of a box that a body may have and be painted over


class Piece(NamedTuple):
    """A candidate as it would come to lie."""

    at: int
    mismatch: int
    difference: int
    window: np.ndarray
    why: str  # what speaks against it
    growth: int  # bodies that it adds
    strut: int = 0  # voxels of struts that were laid with it


@dataclass
class Place:
    """A place in hand.

    Attributes
    ----------
    number : int
    old, of : (z, y, x) uint8 and int32
        Its window, and the bodies in it.
    query : Query
        The words of its overlap.
    asked : (k,) int64
        Its targets, as `Descriptors.scaled` gives them.
    pool : Pool
    before : two arrays
        First voxels of the pieces laid before it, and how far it lies from them.
    refused : collection of int
        Pieces that were taken back here.
    """

    number: int
    old: np.ndarray
    of: np.ndarray
    query: Query
    asked: np.ndarray
    pool: Pool
    before: tuple[np.ndarray, np.ndarray]
    refused: Collection[int]


@dataclass
class _Tried:
    """How many candidates of a place were judged, the best of those with something against them,
    and how many had solid where.
    """

    solid: np.ndarray
    count: int = 0
    fallback: Piece | None = None


class Chooser:
    """What the candidates of all places are judged by.

    Attributes
    ----------
    bodies : Bodies or None
        None where nothing is to hang together.
    window : three ints
        Shape of a place's window.
    judge : Judge
    """

    def __init__(
        self,
        learnt: Learnt,
        config: QuiltConfig,
        ranker: Ranker,
        bodies: Bodies | None,
        margin: tuple[int, ...],
    ) -> None:
        self.learnt, self.config, self.ranker, self.bodies, self.margin = (
            learnt,
            config,
            ranker,
            bodies,
            margin,
        )
        self.seams = config.seams or (_OF_A_LATTICE if any(learnt.periods) else _OF_OTHERS)
        phases = learnt.images[0].phases
        self.solid = classes_for("solid", void_of(phases), len(phases)) == SOLID
        self.window = tuple(side + 2 * m for side, m in zip(learnt.box, margin, strict=True))
        self.judge = Judge(self.window, margin, island=round(_ISLAND * np.prod(learnt.box)))

    @cached_property
    def struts(self) -> Struts:
        """What struts are like."""
        return Struts.of(self.learnt, self.config.feature)

    def chosen(self, place: Place, *, last_way: bool) -> tuple[Piece, int]:
        """The best candidate that may stay, or else the best with what speaks against it; and how
        many were judged. `last_way`: with struts, rather than against what is to hang together.
        """
        config = self.config
        count = min(config.candidates, max(_FEWEST, round(config.share * len(place.pool.at))))
        failed, tried = set(place.refused), _Tried(np.zeros(self.learnt.box, np.int32))
        for wider in range(_WIDEST + 1):
            found = self.ranker.ranked(
                place.query,
                place.pool,
                place.asked,
                place=place.number,
                count=count * _WIDER**wider,
                before=place.before,
                without=failed,
            )
            last = found.complete or wider == _WIDEST
            if wider == 0 and not last and found.least() > config.mismatch * place.query.voxels:
                continue
            piece = self._first_that_may_stay(place, found, tried, failed)
            if piece is not None:
                return piece, tried.count
            if last:
                break
        if tried.fallback is None:  # all that there are were taken back before
            place.refused = ()
            return self.chosen(place, last_way=last_way)
        return (
            self._with_struts(place, tried) if last_way else None
        ) or tried.fallback, tried.count

    def _first_that_may_stay(
        self, place: Place, found: Ranked, tried: _Tried, failed: set[int]
    ) -> Piece | None:
        """A candidate with nothing against it; if there is one soon, one that begins no new body."""
        good: Piece | None = None
        for n, cut in self._by_seam(place, found):
            if good is not None and tried.count >= _PATIENCE:
                break
            tried.count += 1
            for keep in (LEAST, MOST, ALL):  # what is laid only where nothing was tears nothing
                window = cut if keep == LEAST else self._cut_in(place, int(found.at[n]), keep)[0]
                piece = self._judged(place, found, n, window)
                if not piece.why and piece.growth <= 0:
                    return piece
                if not piece.why:
                    good = good or piece
                    break
                tried.fallback = tried.fallback or piece
            tried.solid += self.solid[self.learnt.piece(int(found.at[n]))]
            failed.add(int(found.at[n]))
        return good

    def _by_seam(self, place: Place, found: Ranked) -> Iterator[tuple[int, np.ndarray]]:
        """The nearest candidates, so many at a time, of these the one with the least seam first;
        and the windows they make.
        """
        left = self.config.tries
        while left > 0:
            batch = found.taken_off(min(left, self.seams))
            if not len(batch):
                return
            left -= len(batch)
            windows, costs = zip(
                *(self._cut_in(place, int(found.at[n]), LEAST) for n in batch), strict=True
            )
            for k in np.argsort(costs, kind="stable"):
                yield int(batch[k]), windows[k]

    def _cut_in(self, place: Place, at: int, keep: int) -> tuple[np.ndarray, int]:
        """A candidate cut in along its seam, and what the cut costs."""
        return seamed(place.old, self.margin, self.learnt.piece(at), keep=keep)

    def _judged(self, place: Place, found: Ranked, n: int, window: np.ndarray) -> Piece:
        """A candidate with what speaks against it."""
        why, growth = "", 0
        if self.bodies is not None:
            if self.judge.verdict(self.bodies, place.old, window, place.of) != FINE:
                why = "connectivity"
            growth = self.judge.growth
        if not why and self._thins(place, window):
            why = "feature size"
        return Piece(
            int(found.at[n]), int(found.mismatch[n]), int(found.difference[n]), window, why, growth
        )

    def _thins(self, place: Place, window: np.ndarray) -> bool:
        """Whether a window has more that is too thin than it had."""
        size = self.config.feature
        if size == 1:
            return False
        rim = tuple(min(size - 1, m) for m in self.margin)  # where the window cannot tell
        return thin_voxels(window, rim, size, self.solid) > thin_voxels(
            place.old, rim, size, self.solid
        )

    def _with_struts(self, place: Place, tried: _Tried) -> Piece | None:
        """The best candidate with struts, so that it may stay; cut in as it is best, or else laid
        only where nothing was.
        """
        best = tried.fallback
        if self.bodies is None or best is None or best.why != "connectivity":
            return None
        share = (tried.solid / np.float32(max(tried.count, 1))).astype(np.float32)
        for keep in (LEAST, ALL):
            plain, _ = self._cut_in(place, best.at, keep)
            window = self.struts.laid(self.bodies, self.judge, place.old, plain, place.of, share)
            if window is not None and not self._thins(place, window):
                laid = int(np.count_nonzero(window != plain))
                return best._replace(window=window, why="", strut=laid)
        return None

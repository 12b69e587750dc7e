"""A run: places in raster order; at each the best candidates are laid down and judged until one may
stay.

What a place is made of: the window of what is there, the words of its overlap, its targets.
`choose` finds the piece for it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import checkpoint, memmap
from trabecula.synth.quilt.bit_packing import query_of
from trabecula.synth.quilt.candidate_pools import SCALE, WEIGHT, Descriptors, Pools
from trabecula.synth.quilt.canvas import canvas_for, frame_for
from trabecula.synth.quilt.choose import Chooser, Piece, Place
from trabecula.synth.quilt.cleanup import painted_over, unmark
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import Bodies, classes_for
from trabecula.synth.quilt.local_targets import Own, targets_at
from trabecula.synth.quilt.patch_library import Learnt, void_of
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.ranking import Ranker
from trabecula.synth.quilt.trace import Trace
from trabecula.synth.quilt.voxel_codes import EMPTY, OUT
from trabecula.synth.quilt.windows import box_of, near_empty

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
            island = self.chooser.judge.island
            self.trace.painted = painted_over(self.canvas, self.bodies, self.chooser.struts, island)
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
        state = checkpoint.resume(_STAGE)
        if state is None:
            return 0
        self.canvas, self.placed = state.arrays["canvas"], state.arrays["placed"]
        self.trace.take_over(state.arrays)
        if self.bodies is not None:
            self.bodies.take_over(state.arrays)
        return state.number

"""The choice at a place: the best candidates are cut in, and judged by the least seam first, until
one may stay.

A candidate's mismatch counts all voxels of the overlap that differ; what is to be seen is what the
seam goes through. So of the few with the least distance the one with the cheapest cut is taken.
What no candidate keeps struts have to.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trabecula.synth.quilt.bit_packing import Query
from trabecula.synth.quilt.candidate_pools import Pool
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import FINE, SOLID, Bodies, Judge, classes_for
from trabecula.synth.quilt.cut import ALL, LEAST, MOST, seamed
from trabecula.synth.quilt.feature_size import thin_voxels
from trabecula.synth.quilt.patch_library import Learnt, void_of
from trabecula.synth.quilt.ranking import Ranked, Ranker
from trabecula.synth.quilt.struts import Struts

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

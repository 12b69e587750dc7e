"""A run: places in raster order; at each the best candidates are cut in and judged until one is
accepted.

A candidate's mismatch counts all voxels of the overlap that differ; only those along the seam are
visible. So of the few with the least distance the one with the cheapest cut is taken. Where no
candidate keeps the structure connected, struts do.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.core.target import Target
from trabecula.engine import checkpoint, memmap
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_items
from trabecula.synth.quilt.candidates import (
    SCALE,
    WEIGHT,
    CandidateDescriptors,
    CandidatePool,
    CandidatePools,
    CandidateRanker,
    RankedCandidates,
)
from trabecula.synth.quilt.canvas import (
    EMPTY,
    OUT,
    ExemplarShares,
    PatchGrid,
    fill_canvas,
    inner_box,
    near_empty,
    paint_islands,
    patch_grid,
    targets_at,
    unmark,
)
from trabecula.synth.quilt.compatibility import RECORDS, PlacementTrace
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import (
    FINE,
    LABELLED_AT_ONCE,
    SOLID,
    ComponentTracker,
    ConnectivityCheck,
    join_bytes,
    join_rest,
    thin_voxels,
    voxel_classes,
)
from trabecula.synth.quilt.patch_library import (
    OverlapQuery,
    PatchLibrary,
    overlap_query,
    void_label,
)
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.seams import ALL, LEAST, MOST, StrutBuilder, cut_in

_STAGE = "quilt laid"

_OF_A_WINDOW = 160  # bytes a voxel of cutting and judging a window
_OF_A_PLACE = 72  # bytes of a component or two that begin there, 24 each in a table that doubles
_OF_GIVEN = 11  # bytes a voxel while components of given voxels are labelled, at most: of noise


@dataclass
class _PlacedPatch:
    """A placed patch, with what it takes to take it back."""

    place: int
    at: int
    corner: tuple[int, ...]
    old: np.ndarray
    numbers: np.ndarray
    table: tuple[np.ndarray, ...]


def run_stages(
    grid: PatchGrid, config: QuiltConfig, request: Request, *, mapped: bool = False
) -> tuple[Stage, ...]:
    """Declare the arrays of a run: canvas, components, and the record of every place.

    Parameters
    ----------
    grid : PatchGrid
    config : QuiltConfig
    request : Request
    mapped : bool
        Whether the arrays are memory-mapped.
    """
    places, voxels, plane = math.prod(grid.counts), math.prod(grid.shape), math.prod(grid.shape[1:])
    sides = [side + 2 * margin for side, margin in zip(grid.patch, grid.margin, strict=True)]
    held = {
        "canvas": Array(grid.shape, np.uint8),
        "numbers": Array(grid.shape, np.int32) if config.connected != "none" else None,
    }
    records = {
        "placed": Array(places, np.int32),
        **{name: Array(grid.counts, dtype) for name, dtype in RECORDS.items()},
    }
    entering, laying = 0, _OF_A_WINDOW * math.prod(sides)
    if request.fixed is not None:
        entering = _OF_GIVEN * (plane if mapped else min(voxels, max(plane, LABELLED_AT_ONCE)))
    elif request.mask is not None:
        entering = plane if mapped else voxels
    if mapped:  # the pages of a row of windows
        each = 1 if config.connected == "none" else 5
        laying += sides[0] * sides[1] * grid.shape[2] * each
    else:
        laying += _OF_A_PLACE * places
    stages = [
        Stage("enter given voxels", held, entering),
        Stage("lay patches", {**held, **records}, laying),
    ]
    if _may_join(config):
        working = join_bytes(grid.shape, max(grid.patch), mapped=mapped)
        rest = {"canvas": held["canvas"], **records}
        stages.append(Stage("join components", rest, working))
    return tuple(stages)


def _may_join(config: QuiltConfig) -> bool:
    """Return whether components are joined where places gave way."""
    return config.joins and config.connected == "solid"


class QuiltRun:
    """The state of one run.

    Parameters
    ----------
    library, config, request
    target : mapping, optional
        Targets by the names of the library's descriptors. Default: the request's.

    Attributes
    ----------
    canvas : (Z, Y, X) uint8
        Labels; EMPTY, OUT and FIXED + label as in `canvas`.
    placed : int32, one entry a place
        1 + where the patch begins in the stack; 0 without one.
    trace : PlacementTrace
    """

    def __init__(
        self,
        library: PatchLibrary,
        config: QuiltConfig,
        request: Request,
        target: Mapping[str, Target] | None = None,
    ) -> None:
        self.library, self.config, self.request = library, config, request
        target = request.target if target is None else target
        self.grid = patch_grid(library, request)
        self.work = Workspace(run_stages(self.grid, config, request))
        self.work.enter("enter given voxels")
        self.canvas = self.work.empty("canvas")
        fill_canvas(self.canvas, request)
        phases = library.images[0].phases
        self.void = void_label(phases)
        followed = voxel_classes(config.connected, self.void, len(phases))
        self.components: ComponentTracker | None = None
        if followed.any():
            numbers = self.work.zeros("numbers")
            self.components = ComponentTracker(self.canvas, numbers, self.grid.wraps, followed)
        self.target = {
            name: np.reshape(t, self.grid.shape) if np.ndim(t) else t for name, t in target.items()
        }
        self.mask = None if request.mask is None else request.mask.reshape(self.grid.shape)
        self.own = None if self.target else ExemplarShares.build(library, request.seed)
        names = list(target) if self.own is None else list(self.own.fields)
        self.descriptors = CandidateDescriptors.measure(library, names, config.weights)
        self.pools = CandidatePools(library, self.descriptors, request.seed)
        stage = key(request.seed, "quilt/choice")
        ranker = CandidateRanker(
            library.words,
            self.pools,
            self.descriptors,
            config.alpha,
            config.variety,
            config.sieve,
            stage,
            bool(self.target),
        )
        self.chooser = PatchChooser(library, config, ranker, self.components, self.grid.margin)
        self.work.enter("lay patches")
        self.trace = PlacementTrace(self.grid, {name: self.work.empty(name) for name in RECORDS})
        self.placed = self.work.zeros("placed")
        self.log: deque[_PlacedPatch] = deque(maxlen=max(1, config.backtrack))
        self.refused: dict[int, set[int]] = {}
        self.backs: dict[int, int] = {}

    def lay_all(self) -> np.ndarray:
        """Lay all patches; return the labels, uint8 (Z, Y, X)."""
        counts = self.grid.counts
        for done in track(range(self._resume(), counts[0]), "laying patches"):
            self._lay_layer(done)
            if checkpoint.due():
                checkpoint.offer(
                    _STAGE,
                    done + 1,
                    canvas=self.canvas,
                    placed=self.placed,
                    **self._component_arrays(),
                    **self.trace.arrays(),
                )
        if self.components is not None:
            self.trace.painted = paint_islands(
                self.canvas,
                self.components.numbers,
                self.components.islands(self.chooser.check.island),
                self.components.classes,
                void=self.chooser.strut_builder.void,
                solid=self.chooser.strut_builder.solid,
            )
            if _may_join(self.config) and self.trace.gave_way_in("connectivity"):
                self._join_rest(self.components.classes)
        unmark(self.canvas, self.void)
        return self.canvas

    def _join_rest(self, classes: np.ndarray) -> None:
        """Join the components of the solid that are left; nothing is laid after it."""
        self.components = self.chooser.components = None
        self.work.enter("join components")
        self.trace.joined = join_rest(
            self.canvas,
            classes,
            self.grid.wraps,
            void=self.void,
            patch=max(self.grid.patch),
            brush=2 * self.chooser.strut_builder.radius + 1,
            least=self.chooser.check.island + 1,
        )

    def _lay_layer(self, layer: int) -> None:
        """Lay the patches of one layer of places; none is taken back later."""
        _, rows, places = self.grid.counts
        number, end = layer * rows * places, (layer + 1) * rows * places
        while number < end:
            number = self._lay_or_undo(number)
            if number % places == 0:
                memmap.release_pages()
                self.pools.drop_large_pools()
        for memory in (self.log, self.refused, self.backs):
            memory.clear()

    def _lay_or_undo(self, number: int) -> int:
        """Lay the patch of a place, or take one back; return the place to continue with."""
        corner = self.grid.corner(number)
        place = self._site_at(number, corner)
        if place is None:
            return number + 1
        may_go_back = bool(self.log) and self.backs.get(number, 0) < self.config.backtrack
        patch, tried = self.chooser.choose(place, last_way=not may_go_back)
        if patch.why and may_go_back:
            self.backs[number] = self.backs.get(number, 0) + 1
            return self._undo_last()
        if place.refused == ():
            self.refused.pop(number, None)
        self._lay_patch(place, corner, patch)
        share = patch.mismatch / place.query.voxels if place.query.voxels else float("nan")
        off = patch.difference / (SCALE * WEIGHT) if self.target else float("nan")
        self.trace.add(number, share, off, tried, patch.strut, patch.why)
        return number + 1

    def _site_at(self, number: int, corner: tuple[int, ...]) -> PatchSite | None:
        """Collect the facts of a place; None where nothing is to be made."""
        library, grid = self.library, self.grid
        old = np.empty(self.chooser.window, np.uint8)
        grid.read_window(self.canvas, corner, old, OUT)
        box = np.ascontiguousarray(inner_box(old, grid.margin))
        if not (box == EMPTY).any():
            return None
        numbers = np.zeros(old.shape, np.int32)
        if self.components is not None:
            grid.read_window(self.components.numbers, corner, numbers, 0)
        near = near_empty(box, library.overlap) if self.request.fixed is not None else box < OUT
        targets = (
            self.own.at(corner)
            if self.own
            else targets_at(self.target, grid, corner, library.descriptor_centre, self.mask)
        )
        return PatchSite(
            number,
            old,
            numbers,
            overlap_query(library.words, box, near, library.strides[1:]),
            self.descriptors.scale_targets(targets),
            self.pools.pool(phase_key(corner, library.periods)),
            self._patches_before(number),
            self.refused.get(number, ()),
        )

    def _patches_before(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where the patches before a place along z, y and x begin in the stack, and the
        offsets of the place from them.
        """
        at, away = [], []
        place = np.unravel_index(number, self.grid.counts)
        by = int(np.prod(self.grid.counts))
        for axis, count in enumerate(self.grid.counts):
            by //= count
            if place[axis] > 0 and self.placed[number - by] > 0:
                at.append(self.placed[number - by] - 1)
                away.append([self.grid.step[axis] if other == axis else 0 for other in range(3)])
        return np.array(at, np.int64), np.array(away, np.int64).reshape(-1, 3)

    def _lay_patch(self, place: PatchSite, corner: tuple[int, ...], patch: CutPatch) -> None:
        """Write a patch into the output, and its components into the table."""
        table: tuple[np.ndarray, ...] = ()
        numbers = place.numbers
        if self.components is not None:
            numbers = place.numbers.copy()
            table = self.chooser.check.enter(
                self.components, place.old, patch.window, place.numbers
            )
            self.grid.write_box(self.components.numbers, corner, place.numbers)
        self.grid.write_box(self.canvas, corner, patch.window)
        self.placed[place.number] = patch.at + 1
        self.log.append(_PlacedPatch(place.number, patch.at, corner, place.old, numbers, table))

    def _undo_last(self) -> int:
        """Undo the last patch, and refuse it at its place."""
        step = self.log.pop()
        self.grid.write_box(self.canvas, step.corner, step.old)
        if self.components is not None:
            self.grid.write_box(self.components.numbers, step.corner, step.numbers)
            self.components.restore(step.table)
        self.refused.setdefault(step.place, set()).add(step.at)
        self.trace.drop(step.place)
        return step.place

    def _component_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of the components for a checkpoint."""
        return {} if self.components is None else self.components.arrays()

    def _resume(self) -> int:
        """Restore a checkpoint; return the layer to continue with."""
        state = checkpoint.resume(_STAGE)
        if state is None:
            return 0
        arrays = state.arrays
        for name in ("canvas", "placed", "numbers", *RECORDS):
            if name in self.work:
                self.work.release(name)
                self.work.adopt(name, arrays["of" if name == "numbers" else name])
        self.canvas, self.placed = self.work["canvas"], self.work["placed"]
        self.trace.load_arrays(arrays)
        if self.components is not None:
            self.components.load_arrays(arrays)
        return state.number


_WIDER, _WIDEST = 4, 2  # times as many candidates where those looked at do not fit; so often

_FEWEST = 8  # candidates

_OF_A_LATTICE, _OF_OTHERS = 4, 8  # candidates whose seams are compared

_PATIENCE = 4  # candidates judged in the hope of one that begins no new component

_ISLAND = 0.02  # share of a box up to which a component may be painted over


class CutPatch(NamedTuple):
    """A candidate, cut in."""

    at: int
    mismatch: int
    difference: int
    window: np.ndarray
    why: str  # the reason against it
    growth: int  # components that it adds
    strut: int = 0  # voxels of its struts


@dataclass
class PatchSite:
    """A place in hand.

    Attributes
    ----------
    number : int
    old, numbers : (z, y, x) uint8 and int32
        Its window, and the components in it.
    query : OverlapQuery
        The words of its overlap.
    target : (k,) int64
        Its targets, as `CandidateDescriptors.scale_targets` returns them.
    pool : CandidatePool
    before : two arrays
        First voxels of the patches laid before it, and its offsets from them.
    refused : collection of int
        Patches that were taken back here.
    """

    number: int
    old: np.ndarray
    numbers: np.ndarray
    query: OverlapQuery
    target: np.ndarray
    pool: CandidatePool
    before: tuple[np.ndarray, np.ndarray]
    refused: Collection[int]


@dataclass
class _TriedCandidates:
    """The judged candidates of a place: their number, how many of them have solid at each voxel,
    and the best rejected one.
    """

    solid: np.ndarray
    count: int = 0
    fallback: CutPatch | None = None


class PatchChooser:
    """Choice of a candidate at every place.

    Attributes
    ----------
    components : ComponentTracker or None
        None where connectivity does not matter.
    window : three ints
        Shape of a place's window.
    check : ConnectivityCheck
    """

    def __init__(
        self,
        library: PatchLibrary,
        config: QuiltConfig,
        ranker: CandidateRanker,
        components: ComponentTracker | None,
        margin: tuple[int, ...],
    ) -> None:
        self.library, self.config, self.ranker, self.components, self.margin = (
            library,
            config,
            ranker,
            components,
            margin,
        )
        self.seams = config.seams or (_OF_A_LATTICE if any(library.periods) else _OF_OTHERS)
        phases = library.images[0].phases
        self.solid = voxel_classes("solid", void_label(phases), len(phases)) == SOLID
        self.window = tuple(side + 2 * m for side, m in zip(library.box, margin, strict=True))
        self.check = ConnectivityCheck(
            self.window, margin, island=round(_ISLAND * np.prod(library.box))
        )

    @cached_property
    def strut_builder(self) -> StrutBuilder:
        """Return the builder of struts."""
        return StrutBuilder.build(self.library, self.config.feature)

    def choose(self, place: PatchSite, *, last_way: bool) -> tuple[CutPatch, int]:
        """Choose the best acceptable candidate, or else the best rejected one; return it and how
        many were judged.

        With `last_way` a rejected candidate gets struts rather than break connectivity.
        """
        config = self.config
        count = min(config.candidates, max(_FEWEST, round(config.share * len(place.pool.at))))
        failed, tried = set(place.refused), _TriedCandidates(np.zeros(self.library.box, np.int32))
        for wider in range(_WIDEST + 1):
            found = self.ranker.rank(
                place.query,
                place.pool,
                place.target,
                place=place.number,
                count=count * _WIDER**wider,
                before=place.before,
                without=failed,
            )
            last = found.complete or wider == _WIDEST
            if (
                wider == 0
                and not last
                and found.least_mismatch() > config.mismatch * place.query.voxels
            ):
                continue
            patch = self._first_acceptable(place, found, tried, failed)
            if patch is not None:
                return patch, tried.count
            if last:
                break
        if tried.fallback is None:  # all that there are were taken back before
            place.refused = ()
            return self.choose(place, last_way=last_way)
        return (
            self._with_struts(place, tried) if last_way else None
        ) or tried.fallback, tried.count

    def _first_acceptable(
        self, place: PatchSite, found: RankedCandidates, tried: _TriedCandidates, failed: set[int]
    ) -> CutPatch | None:
        """Return a candidate with nothing against it; if there is one soon, one that begins no new
        component.
        """
        good: CutPatch | None = None
        for n, cut in self._by_seam(place, found):
            if good is not None and tried.count >= _PATIENCE:
                break
            tried.count += 1
            for keep in (LEAST, MOST, ALL):  # a patch laid on EMPTY alone tears nothing
                window = cut if keep == LEAST else self._cut_in_at(place, int(found.at[n]), keep)[0]
                patch = self._judge(place, found, n, window)
                if not patch.why and patch.growth <= 0:
                    return patch
                if not patch.why:
                    good = good or patch
                    break
                tried.fallback = tried.fallback or patch
            tried.solid += self.solid[self.library.patch_at(int(found.at[n]))]
            failed.add(int(found.at[n]))
        return good

    def _by_seam(
        self, place: PatchSite, found: RankedCandidates
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the nearest candidates, so many at a time, of these the one with the least seam
        first; and the windows they make.
        """
        left = self.config.tries
        while left > 0:
            batch = found.take_nearest(min(left, self.seams))
            if not len(batch):
                return
            left -= len(batch)
            windows, costs = self._cut_in_each(place, found.at[batch])
            for k in np.argsort(costs, kind="stable"):
                yield int(batch[k]), windows[k]

    def _cut_in_each(self, place: PatchSite, at: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        """Cut candidates in, each for itself; return the windows and the costs of the cuts."""
        windows, costs = [place.old] * len(at), np.zeros(len(at), np.int64)

        def work(start: int, stop: int) -> None:
            for k in range(start, stop):
                windows[k], costs[k] = self._cut_in_at(place, int(at[k]), LEAST)

        for_items(work, len(at))
        return windows, costs

    def _cut_in_at(self, place: PatchSite, at: int, keep: int) -> tuple[np.ndarray, int]:
        """Cut a candidate in along its seam; return the window and the cost of the cut."""
        return cut_in(place.old, self.margin, self.library.patch_at(at), keep=keep)

    def _judge(
        self, place: PatchSite, found: RankedCandidates, n: int, window: np.ndarray
    ) -> CutPatch:
        """Judge a candidate."""
        why, growth = "", 0
        if self.components is not None:
            if self.check.verdict(self.components, place.old, window, place.numbers) != FINE:
                why = "connectivity"
            growth = self.check.growth
        if not why and self._thins(place, window):
            why = "feature size"
        return CutPatch(
            int(found.at[n]), int(found.mismatch[n]), int(found.difference[n]), window, why, growth
        )

    def _thins(self, place: PatchSite, window: np.ndarray) -> bool:
        """Return whether a window has more thin voxels than before."""
        size = self.config.feature
        if size == 1:
            return False
        rim = tuple(min(size - 1, m) for m in self.margin)  # where the window cannot tell
        return thin_voxels(window, rim, size, self.solid) > thin_voxels(
            place.old, rim, size, self.solid
        )

    def _with_struts(self, place: PatchSite, tried: _TriedCandidates) -> CutPatch | None:
        """Return the best candidate with struts that make it acceptable; cut in at its best seam,
        or else laid only on voxels to make.
        """
        best = tried.fallback
        if self.components is None or best is None or best.why != "connectivity":
            return None
        share = (tried.solid / np.float32(max(tried.count, 1))).astype(np.float32)
        for keep in (LEAST, ALL):
            plain, _ = self._cut_in_at(place, best.at, keep)
            window = self.strut_builder.lay(
                self.components, self.check, place.old, plain, place.numbers, share
            )
            if window is not None and not self._thins(place, window):
                laid = int(np.count_nonzero(window != plain))
                return best._replace(window=window, why="", strut=laid)
        return None

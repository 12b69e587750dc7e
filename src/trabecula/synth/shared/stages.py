"""Arrays that the methods by search and vote declare alike (`engine.memory`): those of a layout, of
a level by the steps of a round, of known voxels, and of the choice of the result's values.

A run allocates from these lists on every level; the forecast is that of the finest one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from trabecula.core.request import Request
from trabecula.engine.memory import Array, Stage, within
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.content.joints import joint_stages
from trabecula.synth.shared.matching.grid import search_stages
from trabecula.synth.shared.matching.planes import planes_at_once
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.slabs import AT_ONCE

RANKS = 1 << 19
"""Bytes of the counts of all ranks."""

_SMALL = 1 << 20  # bytes of all arrays that do not grow with the volume
_BETWEEN = 32  # bytes of a voxel that NumPy takes in between, beside known voxels
_AROUND = 1 << 16  # bytes around one that is read from a file: the system maps them with it


def region_arrays(request: Request, shape: Sequence[int], channels: int) -> dict[str, Array | None]:
    """Declare the free voxels of a region of `shape`, and the bounds of the known ones."""
    known = request.fixed is not None
    bound = Array((channels, *shape), np.int8) if known else None
    free = Array(shape, bool) if known or request.mask is not None else None
    return {"free": free, "low": bound, "high": bound}


@dataclass(frozen=True)
class LevelMemory:
    """Search and vote on one level.

    Attributes
    ----------
    request : Request
    region : Region
        The level, without its arrays; it is covered in every view.
    views : sequence of (axis, Candidates)
        One of axis 0 where neighbourhoods are cubes.
    sweeps : int
        Of the search, at most; its features are held where there are several, or it is `exact`.
    guides : int
        Features of a place, beside those of the field.
    held : mapping of str to Array
        More arrays that stay as they are.
    votes_rest : bool
        Whether the votes are held between rounds.
    refit : bool
        Whether the arrays of other neighbourhoods on the level are there at the start.
    chosen : bool
        Whether voxels become pixels of the exemplars, and remember which.
    correction : sequence of Stage
        A step on the two-point function beside field and votes; empty for none.
    mapped : bool
        Whether the arrays are memory-mapped.
    """

    request: Request
    region: Region
    views: Sequence[tuple[int, Candidates]]
    sweeps: int = 1
    exact: bool = False
    guides: int = 0
    held: Mapping[str, Array] = field(default_factory=dict)
    votes_rest: bool = True
    refit: bool = False
    chosen: bool = False
    correction: Sequence[Stage] = ()
    mapped: bool = False

    @cached_property
    def covered(self) -> Region:
        """Return the voxels that are covered in every view."""
        _, candidates = self.views[0]
        bare = Region(self.region.shape, self.region.wraps)
        return bare.cover(box=(candidates.basis.width,) * 3, steps=(candidates.step,) * 3)

    @property
    def channels(self) -> int:
        """Count the channels of the field."""
        return len(self.views[0][1].stack.field)

    @cached_property
    def grids(self) -> list[tuple[int, int, int]]:
        """Return the sites along each axis of every view."""
        turned = ((self.covered.view_along(axis), c) for axis, c in self.views)
        return [view.grid(box=c.basis.box, steps=c.steps) for view, c in turned]

    @property
    def volume(self) -> tuple[int, ...]:
        """Return the shape (C, Z, Y, X) of field and votes."""
        return (self.channels, *self.covered.shape)

    @property
    def votes(self) -> dict[str, Array]:
        """Declare the votes."""
        return {"votes": Array(self.volume, np.int16)}

    @cached_property
    def base(self) -> dict[str, Array | None]:
        """Declare the arrays that all stages hold: what stays as it is, and the matches."""
        base = region_arrays(self.request, self.covered.shape, self.channels) | dict(self.held)
        for place, grid in enumerate(self.grids):
            base |= {f"active{place}": Array(grid, bool), f"match{place}": Array(grid, np.int32)}
        return base

    @cached_property
    def rest(self) -> dict[str, Array | None]:
        """Declare the arrays between two rounds."""
        sources = {"sources": Array(self.covered.shape, np.int32)} if self.chosen else {}
        votes = self.votes if self.votes_rest else {}
        return {**self.base, **votes, "field": Array(self.volume, np.int8), **sources}

    def stages(self) -> tuple[Stage, ...]:
        """Declare the arrays of a level: from start to rest, the state between rounds."""
        base, rest, votes = self.base, self.rest, self.votes
        sites = [Array(grid, np.int32) for grid in self.grids]
        weights = {f"weight{place}": weight for place, weight in enumerate(sites)}
        width, threads = self.views[0][1].basis.width + 2, thread_count()
        between, pages = threads * self._work_bytes(), threads * self._page_bytes() * self.mapped
        cast = threads * self._vote_bytes() + pages
        sources = {name: rest[name] for name in rest if name == "sources"}
        before = {f"{name} before": array for name, array in rest.items()} if self.refit else {}
        stages = [
            Stage("start", {**rest, **weights, **before}, between),
            Stage("rest", rest),
            Stage("deliver", {**votes, **sources}),
            Stage("vote", {**base, **weights, **votes}, cast, width),
            Stage("match", {**rest, **votes, **weights}, between + (threads + 3) * RANKS),
        ]
        for place, (axis, candidates) in enumerate(self.views):
            view = self.covered.view_along(axis)
            weighed = {name: weights[name] for name in list(weights)[:place]}
            seen = {"seen": Array((self.channels, *view.shape), np.int8) if axis else None}
            search = search_stages(
                candidates,
                view,
                guides=self.guides,
                sweeps=self.sweeps,
                exact=self.exact,
                mapped=self.mapped,
            )
            stages += [
                Stage(f"search{place}", one.arrays, one.working + pages, one.planes)
                for one in within({**rest, **weighed, **seen}, search)
            ]
            made = {f"weight{place}": sites[place], "distance": sites[place]}
            stages.append(Stage(f"weigh{place}", {**rest, **weighed, **made}))
        if self.request.fixed is not None:
            joint = within({**base, **weights, **votes}, joint_stages(self.covered.shape))
            stages += [Stage("join", one.arrays, between) for one in joint]
        if self.chosen:
            chosen = {**rest, **weights, "chosen": rest["field"]}
            stages.append(Stage("choose", chosen, cast, width))
        return (*stages, *within({**rest, **votes}, self.correction))

    def _vote_bytes(self) -> int:
        """Return the bytes of one thread's votes, or of its distances to pixels."""
        shape, threads = self.covered.shape, thread_count()
        if not self.views[0][1].basis.flat:
            _, height, across = shape
            width = self.views[0][1].basis.width
            return 4 * (self.channels + 1) * (height + width) * (across + width)
        each = max(5 * (self.channels + 1), 6 * self.channels + 30 if self.chosen else 0)
        thickest = -(-max(shape) // (4 * threads if threads > 1 else 1))
        return each * min(planes_at_once(shape), thickest) * shape[1] * shape[2]

    def _work_bytes(self) -> int:
        """Return the bytes of NumPy's temporary arrays in one thread."""
        request = self.request
        each = _BETWEEN if request.fixed is not None else 8 if request.mask is not None else 4
        return each * self.channels * slab_voxels(self.covered.shape)

    def _page_bytes(self) -> int:
        """Return the bytes of some rows in every plane of the views across y and x."""
        width = self.views[0][1].basis.width
        return sum(
            2 * planes * min(4 * rows * columns, _AROUND + 4 * width * columns)
            for (axis, _), (planes, rows, columns) in zip(self.views, self.grids, strict=True)
            if axis
        )


def bound_stages(request: Request, channels: int, *, distances: bool) -> tuple[Stage, ...]:
    """Declare the arrays from which the bounds of known voxels are made."""
    if request.fixed is None:
        return ()
    bound = Array((channels, *request.shape), np.float32)
    depth = Array((4, *request.shape), np.float32)
    beside = {"depths": depth} if distances else {"field": bound}
    between = thread_count() * slab_voxels(request.shape) * (32 if distances else 12 * channels)
    return (Stage("bound known voxels", {"least": bound, "most": bound, **beside}, between),)


def value_stages(
    request: Request, shape: Sequence[int], channels: int, *, nbytes: int, distances: bool
) -> tuple[Stage, ...]:
    """Declare the choice of the result's values, of `nbytes`, from votes on `shape`, which may be
    larger than the request: cropped, then made values; the voxels that are free, and those around.
    """
    size, known = request.shape, request.fixed is not None
    votes = Array((channels, *size), np.int16)
    inside = Array(size, bool) if known else None
    found = {
        "votes": votes,
        "values": Array((nbytes // int(np.prod(size)), *size), np.uint8),
        "ranks": Array((channels, *size), np.uint16) if distances and channels > 1 else None,
        "free": inside,
    }
    ranks = (thread_count() + 3) * RANKS * (3 if distances and channels > 1 else 1)
    stages = [Stage("choose values", found, ranks)]
    if known and distances:
        around = {"far": Array(size, np.float32), "near": inside, "not free": inside}
        stages += within({"votes": votes, "free": inside}, [Stage("look around", around)])
    if tuple(shape) != size:
        between = thread_count() * slab_voxels(size) * 2 * channels
        covered = {"covered votes": Array((channels, *shape), np.int16), "votes": votes}
        stages.append(Stage("crop", covered, between))
    return tuple(stages)


def layout_stages(
    volume: Sequence[int],
    held: Mapping[str, Array | None],
    transport: Sequence[Stage],
    steps: Sequence[Stage],
) -> tuple[Stage, ...]:
    """Declare the layout of a level by sliced rounds, with `transport` of the votes (C, Z, Y, X)
    and `steps` beside them and the field, while other arrays are `held`.
    """
    votes, moved = ({name: Array(volume, np.int16)} for name in ("votes", "moved"))
    rest = {**held, "field": Array(volume, np.int8)}
    return (
        Stage("rest", rest),
        Stage("match", {**rest, **votes}, (thread_count() + 3) * RANKS),
        Stage("transport", {**held, **votes, **moved}),
        *within({**held, **votes}, transport),
        *within({**rest, **votes}, steps),
    )


def slab_voxels(shape: Sequence[int]) -> int:
    """Count the voxels that NumPy works on at once in a thread."""
    return min(int(np.prod(shape)), max(AT_ONCE, shape[-2] * shape[-1]))


def usage_bytes(candidates: Iterable[Candidates], *, exact: bool) -> dict[str, int]:
    """Return the bytes of the candidates' usage counts, and of small arrays beside them."""
    most = max(len(one.features) for one in candidates)
    return {"usage": (40 if exact else 24) * most + _SMALL}

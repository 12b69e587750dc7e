"""Memory forecast of search and vote on planes, from the arrays that exist together at the moments
that compete for the peak.

Voxels count on what neighbourhoods of the finest level cover, sites are these neighbourhoods, view
by view; coarser levels hold an eighth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from trabecula.core.request import Request
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.matching.grid import planes_together
from trabecula.synth.shared.matching.neighbourhoods import block_bytes
from trabecula.synth.shared.matching.planes import planes_at_once
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.slabs import AT_ONCE, shape_with_axis_first

_RANKS = 3 << 20  # tables of 65536 ranks
_BETWEEN = 32  # bytes of a voxel that NumPy takes in between, beside known voxels
_AROUND = 1 << 16  # bytes around one that is read from a file: the system maps them with it


@dataclass(frozen=True)
class SolidForecast:
    """A run whose memory is forecast.

    Attributes
    ----------
    request : Request
    region : Region
        The output, before it is covered.
    views : sequence of (axis, Candidates)
        The neighbourhoods of the finest level.
    distances : bool
        Whether fields are those of labels.
    itemsize : int
        Bytes of a value of the result.
    chosen : bool
        Whether voxels become pixels of the exemplars, and remember which.
    exact, repeated : bool
        Whether sites are searched exactly; whether more than once in a round.
    correcting : int
        Bytes of a step on the two-point function beside field and votes; 0 for none.
    """

    request: Request
    region: Region
    views: Sequence[tuple[int, Candidates]]
    distances: bool
    itemsize: int
    chosen: bool = False
    exact: bool = False
    repeated: bool = False
    correcting: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the voxels that are covered in every view."""
        _, candidates = self.views[0]
        return self.region.cover(
            box=(candidates.basis.width,) * 3, steps=(candidates.step,) * 3
        ).shape

    @property
    def output(self) -> int:
        """Return the bytes of arrays that grow with the volume and of temporary arrays beside them,
        at their peak.
        """
        return max(self._moments()) + _RANKS

    @property
    def scratch(self) -> int:
        """Return the bytes of the candidates' usage counts."""
        return (40 if self.exact else 24) * max(
            len(candidates.features) for _, candidates in self.views
        )

    @property
    def slab(self) -> int:
        """Return the bytes that are needed in memory where arrays are memory-mapped: temporary
        arrays, and the pages of a few planes.
        """
        each = (
            max(self._search_bytes(), self._vote_bytes(), self._work_bytes())
            + self._page_bytes()
            + _RANKS
        )
        return self.scratch + thread_count() * each + _RANKS

    def _moments(self) -> list[int]:
        channels, voxels = self._channels, prod(self.shape)
        requested, threads = prod(self.request.shape), thread_count()
        sites = [prod(grid) for grid in self._grids()]
        most, every = max(sites), sum(sites)
        kept = voxels * (3 * channels + (4 if self.chosen else 0)) + 5 * every + self._bound_bytes()
        between = threads * self._work_bytes()
        search = kept + 4 * (every - most) + voxels * channels
        if self.exact or self.repeated:
            depths = [candidates.features.shape[1] for _, candidates in self.views]
            search += 16 * most + 2 * max(
                depth * count for depth, count in zip(depths, sites, strict=True)
            )
        else:
            search += 8 * most
        moments = [
            search + threads * self._search_bytes(),
            kept
            + 4 * every
            + voxels * (2 * channels + (4 if self.chosen else 0))
            + threads * self._vote_bytes(),
            kept + 4 * every + voxels * (channels + 2) + between,
            kept
            + 2 * channels * requested * (self.shape != self.request.shape)
            + requested * self._value_bytes()
            + between,
        ]
        if self.request.fixed is not None:
            moments.append(kept + 4 * every + voxels * (2 * channels + 9) + between)
            moments.append(
                requested * (8 * channels + 16 if self.distances else 11 * channels + 2) + between
            )
        if self.correcting:
            moments.append(kept + self.correcting + voxels * 2 * channels)
        return moments

    def _bound_bytes(self) -> int:
        """Return the bytes of the mask and of the bounds of known voxels."""
        parts = int(self.request.mask is not None or self.request.fixed is not None)
        parts += 2 * self._channels * (self.request.fixed is not None)
        return prod(self.shape) * parts * 8 // 7

    def _value_bytes(self) -> int:
        """Return the bytes of a voxel that the choice of the values takes beside the votes."""
        free = 2 * (self.request.fixed is not None)
        around = 6 if self.request.fixed is not None and self.distances else 0
        values = (
            2 * self._channels + 1 if self.distances and self._channels > 1 else 2 + self.itemsize
        )
        return free + max(around, values)

    @property
    def _thickest(self) -> int:
        """Return the planes of a slab of a thread, at most."""
        return -(-max(self.shape) // (4 * thread_count() if thread_count() > 1 else 1))

    def _search_bytes(self) -> int:
        """Return the bytes of one thread's features, and of their sources."""
        most = 0
        for (axis, candidates), grid in zip(self.views, self._grids(), strict=True):
            depth, (_, height, across) = (
                candidates.features.shape[1],
                shape_with_axis_first(self.shape, axis),
            )
            thick = min(planes_together(depth, grid), self._thickest)
            each = (6 if candidates.basis.grain > 1 else int(self._channels > 1)) + 2 * any(
                self.region.wraps
            )
            made = 2 * depth * grid[1] * grid[2] + each * self._channels * height * across
            most = max(most, made * thick + block_bytes(candidates.basis, grid))
        return most

    def _vote_bytes(self) -> int:
        """Return the bytes of one thread's votes, or of its distances to pixels."""
        each = max(5 * (self._channels + 1), 6 * self._channels + 30 if self.chosen else 0)
        return (
            each * min(planes_at_once(self.shape), self._thickest) * self.shape[1] * self.shape[2]
        )

    def _work_bytes(self) -> int:
        """Return the bytes of NumPy's temporary arrays in one thread."""
        each = (
            _BETWEEN
            if self.request.fixed is not None
            else 8
            if self.request.mask is not None
            else 4
        )
        return (
            each
            * self._channels
            * min(prod(self.shape), max(AT_ONCE, self.shape[1] * self.shape[2]))
        )

    def _page_bytes(self) -> int:
        """Return the bytes of a few planes, and of some rows in every plane of the views across y
        and x.
        """
        width = self.views[0][1].basis.width
        plane = self.shape[1] * self.shape[2]
        known = 2 * self._channels + 10 if self.request.fixed is not None else 2
        pages = (width + 2) * (3 * self._channels + known) * plane
        for (axis, _), (planes, rows, columns) in zip(self.views, self._grids(), strict=True):
            each = 4 * rows * columns
            pages += (
                8 * width * columns * rows
                if axis == 0
                else 2 * planes * min(each, _AROUND + 4 * width * columns)
            )
        return pages

    def _grids(self) -> list[tuple[int, int, int]]:
        bare = Region(self.shape, self.region.wraps)
        return [
            bare.view_along(axis).grid(box=c.basis.box, steps=c.steps) for axis, c in self.views
        ]

    @property
    def _channels(self) -> int:
        return len(self.views[0][1].stack.field)

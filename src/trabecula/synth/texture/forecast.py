"""Memory forecast of a run, from the arrays that exist together at the moments that compete for its
peak.

Voxels count on what neighbourhoods of the finest level cover, sites are these neighbourhoods;
coarser levels hold an eighth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

from trabecula.core.request import Request
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.matching.neighbour_search import search_bytes
from trabecula.synth.shared.matching.neighbourhoods import block_bytes, planes_together
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.slabs import AT_ONCE
from trabecula.synth.texture import energy_rounds, graded

_RANKS = 1 << 19  # bytes of counts of all ranks
_SITE = 13  # of a search: the match before and after, distances, which sites are active
_THREAD = 1 << 18  # bytes that a further thread holds of its own: itself, and counts


@dataclass(frozen=True)
class Moment:
    """Bytes of arrays that grow with the volume, and of temporary arrays beside them."""

    arrays: int
    beside: int


@dataclass(frozen=True)
class TextureForecast:
    """A run whose memory is forecast.

    Attributes
    ----------
    request : Request
    region : Region
        The output, before it is covered.
    finest : sequence of Candidates
        The neighbourhoods of the finest level, as they are used.
    distances : bool
        Whether fields are those of labels.
    itemsize : int
        Bytes of a value of the result.
    exact, energetic, graded : bool
        Ways of search and vote that hold more.
    repeated : bool
        Whether features are searched more than once, and kept.
    correcting : int
        Bytes of a step on the two-point function beside field and votes; 0 for none.
    """

    request: Request
    region: Region
    finest: Sequence[Candidates]
    distances: bool
    itemsize: int
    exact: bool = False
    energetic: bool = False
    graded: bool = False
    repeated: bool = False
    correcting: int = 0

    @property
    def output(self) -> int:
        """Return the bytes of arrays that grow with the volume, at the peak."""
        return self._peak.arrays

    @property
    def scratch(self) -> int:
        """Return the bytes of temporary arrays then, of all threads."""
        return self._peak.beside + (thread_count() - 1) * _THREAD

    @property
    def slab(self) -> int:
        """Return the bytes that are needed in memory where arrays are memory-mapped: temporary
        arrays, and the pages of a few planes.
        """
        beside = max(
            moment.beside for candidates in self.finest for moment in self._moments(candidates)
        )
        return beside + max(map(self._page_bytes, self.finest))

    @property
    def _peak(self) -> Moment:
        moments = [moment for candidates in self.finest for moment in self._moments(candidates)]
        return max(moments, key=lambda moment: moment.arrays + moment.beside)

    def _moments(self, candidates: Candidates) -> list[Moment]:
        """List the moments of the rounds with one width, of the steps before them, and of the
        choice of the values after them.
        """
        channels, request = len(candidates.stack.field), self.request
        threads = thread_count()
        shape, grid = self._shape(candidates), self._grid(candidates)
        voxels, requested = prod(shape), prod(request.shape)
        sites = prod(grid)
        known, cropped = request.fixed is not None, shape != request.shape
        free = (1 if known else int(request.mask is not None and cropped)) + int(
            known and request.mask is not None
        )
        bounds = 2 * channels * (2 if cropped else 1) if known else 0
        held = voxels * (free + bounds) * 8 // 7 + (16 * voxels + 4 * sites if self.graded else 0)
        features = 2 * candidates.features.shape[1] * sites if self.exact or self.repeated else 0
        vote = (
            threads
            * 4
            * (
                (channels + 1) * prod(side + candidates.basis.width for side in shape[1:])
                + grid[1] * grid[2]
            )
        )
        between = threads * min(requested, max(AT_ONCE, request.shape[1] * request.shape[2]))
        search = threads * self._search_bytes(candidates) + (16 + 48 * self.exact) * len(
            candidates.features
        )
        ranks = (threads + 3) * _RANKS
        moments = [
            Moment(held + voxels * channels + _SITE * sites + features, search),
            Moment(held + voxels * 2 * channels + 9 * sites, vote),
            Moment(held + voxels * (3 * channels + 8 * self.graded) + 5 * sites, ranks),
            Moment(
                requested * (2 * channels + self._value_bytes(channels)),
                ranks * (3 if self.distances and channels > 1 else 1),
            ),
        ]
        if cropped:
            moments.append(Moment(2 * channels * (voxels + requested), between * 2 * channels))
        if known:
            moments.append(Moment(held + voxels * (4 * channels + 9) + 5 * sites, between * 16))
            kept = 8 * channels + 16 if self.distances else 11 * channels + 2
            moments.append(
                Moment(requested * kept, between * (32 if self.distances else 12 * channels))
            )
        if self.energetic:
            moments.append(
                Moment(held + energy_rounds.round_bytes(voxels, sites, channels=channels), search)
            )
        if self.graded:
            meanwhile = 8 * (thread_count() - 1) * min(voxels, AT_ONCE)
            moments.append(
                Moment(voxels * graded.BYTES + voxels * (free + bounds) * 8 // 7 + meanwhile, 0)
            )
        if self.correcting:
            moments.append(
                Moment(self.correcting + held + voxels * 4 * channels + 5 * sites, ranks)
            )
        return moments

    def _value_bytes(self, channels: int) -> int:
        """Return the bytes of a voxel that the choice of the values takes beside the votes."""
        request = self.request
        free = 2 * (request.fixed is not None)
        around = 6 if request.fixed is not None and self.distances else 0
        values = 2 * channels + 1 if self.distances and channels > 1 else self.itemsize
        return free + max(around, values)

    def _search_bytes(self, candidates: Candidates) -> int:
        """Return one thread's bytes of features, and of the sums over blocks that they
        are made of.
        """
        shape, grid = self._shape(candidates), self._grid(candidates)
        threads = thread_count()
        basis, channels = candidates.basis, len(candidates.stack.field)
        depth = candidates.features.shape[1]
        thick = min(
            planes_together(depth, grid), -(-grid[0] // (4 * threads if threads > 1 else 1))
        )
        planes = min((thick - 1) * candidates.steps[0] + basis.box[0], shape[0] + basis.box[0])
        seen = channels * planes * prod(shape[1:])
        copied = int(channels > 1) + 2 * any(self.region.wraps)
        made = 2 * depth * thick * grid[1] * grid[2] * (3 if self.graded else 1)
        opened = search_bytes(len(candidates.features), candidates.k) if self.exact else 0
        return (
            made
            + opened
            + copied * seen
            + max(
                4 * seen * (basis.grain > 1),
                2 * seen * (basis.grain > 1) + block_bytes(basis, grid),
            )
        )

    def _page_bytes(self, candidates: Candidates) -> int:
        """Return the bytes of the pages of a few planes, of all threads."""
        shape, grid = self._shape(candidates), self._grid(candidates)
        channels, width = len(candidates.stack.field), candidates.basis.width
        known = 2 * channels + 10 if self.request.fixed is not None else 2
        planes = (width + 2) * (3 * channels + known) * shape[1] * shape[2]
        pages = planes + 4 * _SITE * grid[1] * grid[2]
        if self.energetic:
            pages += energy_rounds.slab_bytes(
                prod(shape[1:]), prod(grid[1:]), width=width, channels=channels
            )
        if self.graded:
            pages += graded.slab_bytes(shape)
        return thread_count() * pages

    def _grid(self, candidates: Candidates) -> tuple[int, int, int]:
        return self.region.grid(box=candidates.basis.box, steps=candidates.steps)

    def _shape(self, candidates: Candidates) -> tuple[int, ...]:
        return self.region.cover(box=candidates.basis.box, steps=candidates.steps).shape

"""The neighbourhoods of one sliced round: their places in a volume, and the replacement of the
voxels that they hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.engine.random import below, philox
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.matching.neighbourhoods import Triple, grid_reach

BATCH = 1 << 21
"""Values of neighbourhoods that are put back at a time, if not those of one row of sites are more.
"""

_FEW = 512  # neighbourhoods that are rebuilt at once: their temporary arrays stay in the cache


@dataclass(frozen=True)
class Sites:
    """A grid of neighbourhoods of `box` voxels, `steps` apart.

    `counts` is how many there are along each axis, `places` where the voxels that they cover lie
    along it, one after the other; `active` (`counts`) bool says which of them take part (None:
    all).
    """

    counts: Triple
    places: tuple[np.ndarray, np.ndarray, np.ndarray]
    box: Triple
    steps: Triple
    active: np.ndarray | None

    @classmethod
    def draw(
        cls,
        shape: Sequence[int],
        *,
        box: Triple,
        steps: Triple,
        periodic: Sequence[bool],
        free: np.ndarray | None,
        key: np.uint64,
        number: int,
    ) -> Sites:
        """Draw the grid of a round in a volume (Z, Y, X): it begins elsewhere in every one, and
        goes around axes that wrap.
        """
        along = list(zip(shape, box, steps, periodic, strict=True))
        room = [side if wrap and t > 1 else min(t, side - w + 1) for side, w, t, wrap in along]
        starts = np.empty(3, np.int64)
        draw_starts(key, number, np.array(room), starts)
        z, y, x = (
            -(-side // t) if wrap else (side - int(start) - w) // t + 1
            for start, (side, w, t, wrap) in zip(starts, along, strict=True)
        )
        covered = grid_reach((z, y, x), box=box, steps=steps)
        at = [
            (start + np.arange(reach)) % side
            for start, reach, side in zip(starts, covered, shape, strict=True)
        ]
        places = (at[0], at[1], at[2])
        active = None if free is None else _holding(free, places, (z, y, x), box, steps)
        return cls((z, y, x), places, box, steps, active)

    def holds_any(self) -> bool:
        """Return whether any site takes part."""
        return self.active is None or any(plane.any() for plane in self.active)

    def around(self, inside: np.ndarray) -> Sites:
        """Return the sites whose middle is `inside` (Z, Y, X) bool; all where none is."""
        middles = [
            at[w // 2 :: t][:count]
            for at, w, t, count in zip(self.places, self.box, self.steps, self.counts, strict=True)
        ]
        active = inside[np.ix_(*middles)]
        return replace(self, active=active) if active.any() else self

    def levels(self, field: np.ndarray) -> np.ndarray:
        """Round the votes (C, Z, Y, X) that the sites cover to int8."""
        levels = memmap.empty((len(field), *map(len, self.places)), np.int8)
        for_slabs(partial(_round_votes, field, *self.places, levels), levels.shape[1])
        return levels

    def rows(
        self, features: np.ndarray, start: int, stop: int, *, few: int
    ) -> Iterator[np.ndarray]:
        """Yield features (z, y, x, D) of the sites that take part, of planes start..stop of them,
        about so many at a time.
        """
        lines = max(1, few // self.counts[2])
        for z in range(start, stop):
            for y in range(0, self.counts[1], lines):
                part = slice(y, y + lines)
                active = slice(None) if self.active is None else self.active[z, part].ravel()
                yield features[z, part].reshape(-1, features.shape[-1])[active]

    def put_back(
        self,
        features: np.ndarray,
        rebuilt: Callable[[np.ndarray], np.ndarray],
        rest: np.ndarray,
        total: np.ndarray,
        votes: np.ndarray,
    ) -> None:
        """Add the neighbourhoods that are rebuilt of their features, with a `rest` (C,) of each
        voxel, to total (C, Z, Y, X) int32, and their number to votes (Z, Y, X) int32."""
        length = len(total) * self.box[0] * self.box[1] * self.box[2]
        for planes, lines in self._batches(length):
            active = None if self.active is None else self.active[planes, lines]
            self._put_some(
                features[planes, lines],
                active,
                (planes.start, lines.start),
                rebuilt,
                length,
                rest,
                total,
                votes,
            )

    def _put_some(
        self,
        features: np.ndarray,
        active: np.ndarray | None,
        first: tuple[int, int],
        rebuilt: Callable[[np.ndarray], np.ndarray],
        length: int,
        rest: np.ndarray,
        total: np.ndarray,
        votes: np.ndarray,
    ) -> None:
        """Rebuild and add neighbourhoods of `length` values, at the sites (z, y, x) of some planes
        and rows, from the `first`.
        """
        chosen = features.reshape(-1, features.shape[-1]) if active is None else features[active]
        if not len(chosen):
            return
        numbers = np.arange(features[..., 0].size).reshape(features.shape[:3])
        if active is not None:
            numbers = np.where(active, np.cumsum(active).reshape(active.shape) - 1, -1)
        blocks = np.empty((len(chosen), length), np.int32)
        _rebuild(chosen, rebuilt, blocks)
        steps, box = np.array(self.steps), np.array(self.box)
        collect = partial(
            add, blocks, numbers, np.array(first), steps, box, self.places, rest, total, votes
        )
        for_slabs(collect, votes.shape[1], least=4)

    def _batches(self, length: int) -> Iterator[tuple[slice, slice]]:
        """Yield the planes and rows of sites whose neighbourhoods of `length` values are put back
        at a time.
        """
        depth, height, width = self.counts
        planes = max(1, BATCH // (height * width * length))
        lines = height if planes > 1 else max(1, BATCH // (width * length))
        for z in range(0, depth, planes):
            for y in range(0, height, lines):
                yield slice(z, min(z + planes, depth)), slice(y, min(y + lines, height))


def _rebuild(
    features: np.ndarray, rebuilt: Callable[[np.ndarray], np.ndarray], blocks: np.ndarray
) -> None:
    def work(start: int, stop: int) -> None:
        for first in range(start, stop, _FEW):
            part = slice(first, min(first + _FEW, stop))
            blocks[part] = rebuilt(features[part])

    for_slabs(work, len(features), least=64)


def _holding(
    free: np.ndarray, places: Sequence[np.ndarray], counts: Triple, box: Triple, steps: Triple
) -> np.ndarray:
    """Mark the sites whose neighbourhood holds a free voxel."""
    active = memmap.empty(counts, bool)
    across = np.ix_(*places[1:])

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            covered = places[0][z * steps[0] : z * steps[0] + box[0]]
            held = free[covered].any(axis=0)[across]
            windows = np.lib.stride_tricks.sliding_window_view(held, box[1:])[
                :: steps[1], :: steps[2]
            ]
            active[z] = windows.any(axis=(2, 3))

    for_slabs(work, counts[0])
    return active


@kernel
def _round_votes(field, places_z, places_y, places_x, levels, start, stop):
    """Round the votes at places along every axis to int8, planes start..stop of them."""
    for c in range(len(levels)):
        for z in range(start, stop):
            for y in range(levels.shape[2]):
                row = field[c, places_z[z], places_y[y]]
                for x in range(levels.shape[3]):
                    level = (np.int32(row[places_x[x]]) + UNIT // 2) >> 8
                    levels[c, z, y, x] = min(max(level, -FULL), FULL)


@kernel
def draw_starts(key, number, sides, starts):
    words = philox(key, number, 0, 0, 1)
    for axis in range(3):
        starts[axis] = below(words[axis], sides[axis])


@kernel
def add(blocks, numbers, first, steps, box, places, rest, total, votes, start, stop):
    """Add neighbourhoods to rows start..stop of total (C, Z, Y, X) and votes (Z, Y, X).

    blocks (n, C * voxels) int32; numbers (sz, sy, sx) the row of each site in it, or -1; first (2,)
    the number of the first site along z and y; places: the places along an axis of the voxels
    that all sites cover; rest (C,) is added to each.
    """
    places_z, places_y, places_x = places
    width, voxels = box[2], box[0] * box[1] * box[2]
    channels = len(total)
    line = np.empty((channels, len(places_x)), np.int32)
    count = np.empty(len(places_x), np.int32)
    low, high = first[0] * steps[0], (first[0] + numbers.shape[0] - 1) * steps[0] + box[0]
    near, far = first[1] * steps[1], (first[1] + numbers.shape[1] - 1) * steps[1] + box[1]
    for z in range(low, high):
        for y in range(near, far):
            if places_y[y] < start or places_y[y] >= stop:
                continue
            line[:] = 0
            count[:] = 0
            for sz in range(numbers.shape[0]):
                dz = z - (first[0] + sz) * steps[0]
                if dz < 0 or dz >= box[0]:
                    continue
                for sy in range(numbers.shape[1]):
                    dy = y - (first[1] + sy) * steps[1]
                    if dy < 0 or dy >= box[1]:
                        continue
                    at = (dz * box[1] + dy) * width
                    for sx in range(numbers.shape[2]):
                        row = numbers[sz, sy, sx]
                        if row < 0:
                            continue
                        x = sx * steps[2]
                        # the compiler makes few additions of a width that it knows
                        if width == 6:
                            for c in range(channels):
                                for dx in range(6):
                                    line[c, x + dx] += blocks[row, at + c * voxels + dx]
                            for dx in range(6):
                                count[x + dx] += 1
                        else:
                            for c in range(channels):
                                for dx in range(width):
                                    line[c, x + dx] += blocks[row, at + c * voxels + dx]
                            for dx in range(width):
                                count[x + dx] += 1
            for x in range(len(places_x)):
                for c in range(channels):
                    total[c, places_z[z], places_y[y], places_x[x]] += (
                        line[c, x] + rest[c] * count[x]
                    )
                votes[places_z[z], places_y[y], places_x[x]] += count[x]

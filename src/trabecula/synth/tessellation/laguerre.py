"""Laguerre (power) diagrams on a torus: the cell of every point, and its distance to the faces.

A point x belongs to the seed s with the least power |x - s|^2 - w, over all images of the seeds; w
is the seed's weight (Aurenhammer 1987, doi:10.1137/0216006). Three steps:

1. seeds are sorted into bins, and the torus is cut into blocks, a few for each seed. A seed may own
   a point of a block with centre c and half diagonal r only if max(0, |c - s| - r)^2 - w is at most
   the least (|c - t| + r)^2 - v over all seeds t, v: the candidates of the block are found once, in
   growing rings of bins;
2. every point takes the best candidate of its block;
3. its distance to the faces of its cell is the least distance to the planes between its cell and
   those that touch it, since the nearest of a convex cell's planes holds a face.

Every point is found alone, so that no order of work matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs

FINE = 1024
"""Parts of a unit of length in which displacements are summed: whole numbers, in any order."""


_BLOCKS = 2  # along the edge of a cube that holds one seed
_HALF = [shift for shift in product((-1, 0, 1), repeat=3) if shift > (0, 0, 0)]


class SeedBins(NamedTuple):
    """Seeds in bins, for kernels; N seeds, lengths in voxels."""

    places: np.ndarray
    """(N, 3) float64."""
    weights: np.ndarray
    """(N,) float64."""
    sides: np.ndarray
    """(3,) float64 of the torus."""
    counts: np.ndarray
    """(3,) int64 bins along z, y, x."""
    starts: np.ndarray
    """(bins + 1,) int64: first of the seeds of every bin in `order`."""
    order: np.ndarray
    """(N,) int64."""


class Blocks(NamedTuple):
    """Candidates of the blocks of a torus, for kernels."""

    counts: np.ndarray
    """(3,) int64 blocks along z, y, x."""
    starts: np.ndarray
    """(blocks + 1,) int64: first of the candidates of every block in `seeds`."""
    seeds: np.ndarray
    """(candidates,) int32."""


class PointGrid(NamedTuple):
    """Points of a grid: their coordinates along z, y, x, float64, voxels."""

    z: np.ndarray
    y: np.ndarray
    x: np.ndarray


@dataclass(frozen=True, eq=False)
class Diagram:
    """Seeds of a Laguerre diagram on a torus; N seeds, lengths in voxels."""

    seeds: np.ndarray
    """(N, 3) float64, within the torus."""
    weights: np.ndarray
    """(N,) float64."""
    sides: np.ndarray
    """(3,) float64."""

    @cached_property
    def sites(self) -> SeedBins:
        """Return the seeds in bins of about one seed each."""
        counts = self._cut(1)
        place = np.minimum((self.seeds / self.sides * counts).astype(np.int64), counts - 1)
        flat = (place[:, 0] * counts[1] + place[:, 1]) * counts[2] + place[:, 2]
        order = np.argsort(flat, kind="stable").astype(np.int64)
        starts = np.searchsorted(flat[order], np.arange(np.prod(counts) + 1)).astype(np.int64)
        return SeedBins(self.seeds, self.weights, self.sides, counts, starts, order)

    @cached_property
    def blocks(self) -> Blocks:
        """Return the candidates of blocks, `_BLOCKS` along the edge of a bin."""
        counts = self._cut(_BLOCKS)
        number = np.zeros(int(np.prod(counts)), np.int64)
        blocks = Blocks(counts, np.zeros(len(number) + 1, np.int64), np.empty(0, np.int32))

        def work(start: int, stop: int) -> None:
            find_candidates(blocks, number, self.sites, start, stop)

        for_slabs(work, int(counts[0]))
        np.cumsum(number, out=blocks.starts[1:])
        blocks = blocks._replace(seeds=np.empty(int(blocks.starts[-1]), np.int32))
        for_slabs(work, int(counts[0]))
        return blocks

    def _cut(self, parts: int) -> np.ndarray:
        """Return into how many boxes the torus is cut along each axis, (3,) int64: `parts` along
        the edge of a cube that holds one seed on average.
        """
        edge = np.cbrt(np.prod(self.sides) / len(self.seeds)) / parts
        return np.maximum(1, np.round(self.sides / edge)).astype(np.int64)

    def points(self, counts: Sequence[int]) -> PointGrid:
        """Return a grid of so many points along z, y, x that covers the torus evenly."""
        pairs = zip(counts, self.sides, strict=True)
        return PointGrid(*((np.arange(n) + 0.5) * (side / n) for n, side in pairs))

    def cells(self, grid: PointGrid) -> np.ndarray:
        """Return the cell, from 0, of every point of a grid, (Z, Y, X) int32."""
        owner = np.empty([len(axis) for axis in grid], np.int32)
        sites, blocks = self.sites, self.blocks
        for_slabs(lambda a, b: find_cells(owner, grid, sites, blocks, a, b), len(owner), least=1)
        return owner

    def neighbours(self, counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells that touch every cell on a grid of so many points over the torus: the
        first of each in the list, (N + 1,) int64, and the list, int32.
        """
        owner = self.cells(self.points(counts))
        count = len(self.seeds)
        found = np.empty(0, np.int64)
        for shift in _HALF:
            other = np.roll(owner, shift, axis=(0, 1, 2))
            apart = owner != other
            pairs = owner[apart].astype(np.int64) * count + other[apart]
            found = np.union1d(found, pairs)
        first, second = np.divmod(found, count)
        pairs = np.unique(np.concatenate([found, second * count + first]))
        first, second = np.divmod(pairs, count)
        return np.searchsorted(first, np.arange(count + 1)), second.astype(np.int32)

    def face_distance(
        self,
        grid: PointGrid,
        owner: np.ndarray,
        touching: tuple[np.ndarray, np.ndarray],
        radius: float,
    ) -> np.ndarray:
        """Return the distance of every point of a grid to the faces of its cell, (Z, Y, X) float32.

        Parameters
        ----------
        grid : PointGrid
        owner : int32 array, (Z, Y, X)
            As from `cells`.
        touching : tuple of arrays
            As from `neighbours`.
        radius : float
            R, voxels: where several faces are nearer, R - sqrt(sum (R - d)^2), so that surfaces of
            one distance have round corners; 0 for the distance to the nearest face.
        """
        found = np.empty(owner.shape, np.float32)
        sites = self.sites
        starts, others = touching
        for_slabs(
            lambda a, b: measure_faces(found, owner, grid, sites, starts, others, radius, a, b),
            len(found),
            least=1,
        )
        return found

    def moments(self, counts: Sequence[int]) -> np.ndarray:
        """Return the moments of every cell over a grid of so many points along z, y, x.

        Returns
        -------
        moments : int64 array, (N, 4)
            Points, and the sums of their displacements along z, y, x from the seed in 1 / `FINE`.
        """
        grid, sites = self.points(counts), self.sites
        owner = self.cells(grid)

        def add(start: int, stop: int) -> np.ndarray:
            sums = np.zeros((len(self.seeds), 4), np.int64)
            add_moments(sums, owner, grid, sites, start, stop)
            return sums

        return np.asarray(sum_slabs(add, len(owner)))


@inline
def _nearest(apart, side):
    """Return a difference of coordinates on a torus, -side / 2 .. side / 2."""
    return apart - side * np.round(apart / side)


@inline
def _square(sites, seed, z, y, x):
    """Return the squared distance to a seed's nearest image."""
    dz = _nearest(z - sites.places[seed, 0], sites.sides[0])
    dy = _nearest(y - sites.places[seed, 1], sites.sides[1])
    dx = _nearest(x - sites.places[seed, 2], sites.sides[2])
    return dz * dz + dy * dy + dx * dx


@inline
def _ring(seeds, sites, ring, bz, by, bx):
    """List the seeds of the bins at Chebyshev distance `ring` from a bin; each bin of the torus
    lies in one ring. Returns their number.
    """
    count = 0
    for oz in range(-ring, ring + 1):
        if 2 * abs(oz) > sites.counts[0] or -2 * oz == sites.counts[0]:
            continue
        for oy in range(-ring, ring + 1):
            if 2 * abs(oy) > sites.counts[1] or -2 * oy == sites.counts[1]:
                continue
            step = 1 if abs(oz) == ring or abs(oy) == ring else 2 * ring
            for ox in range(-ring, ring + 1, step):
                if 2 * abs(ox) > sites.counts[2] or -2 * ox == sites.counts[2]:
                    continue
                place = (
                    (bz + oz) % sites.counts[0] * sites.counts[1] + (by + oy) % sites.counts[1]
                ) * sites.counts[2] + (bx + ox) % sites.counts[2]
                for n in range(sites.starts[place], sites.starts[place + 1]):
                    seeds[count] = sites.order[n]
                    count += 1
    return count


@inline
def _candidates(kept, around, sites, top, z, y, x, half):
    """List the seeds that may own a point within `half` of (z, y, x); returns their number."""
    bz = min(np.int64(z / sites.sides[0] * sites.counts[0]), sites.counts[0] - 1)
    by = min(np.int64(y / sites.sides[1] * sites.counts[1]), sites.counts[1] - 1)
    bx = min(np.int64(x / sites.sides[2] * sites.counts[2]), sites.counts[2] - 1)
    edge = min(
        sites.sides[0] / sites.counts[0],
        sites.sides[1] / sites.counts[1],
        sites.sides[2] / sites.counts[2],
    )
    limit, count = np.inf, 0
    for ring in range(sites.counts.max() // 2 + 1):
        out = max(0.0, (ring - 1) * edge - half)
        if out * out - top > limit:
            break
        number = _ring(around, sites, ring, bz, by, bx)
        for n in range(number):
            seed = around[n]
            away = np.sqrt(_square(sites, seed, z, y, x))
            limit = min(limit, (away + half) ** 2 - sites.weights[seed])
            if max(0.0, away - half) ** 2 - sites.weights[seed] <= limit:
                kept[count] = seed
                count += 1
    left = 0
    for n in range(count):
        away = np.sqrt(_square(sites, kept[n], z, y, x))
        if max(0.0, away - half) ** 2 - sites.weights[kept[n]] <= limit:
            kept[left] = kept[n]
            left += 1
    return left


@inline
def _half_diagonal(sides, counts):
    return 0.5 * np.sqrt(
        (sides[0] / counts[0]) ** 2 + (sides[1] / counts[1]) ** 2 + (sides[2] / counts[2]) ** 2
    )


@kernel
def find_candidates(blocks, number, sites, start, stop):
    """Write the number of candidates of every block of layers start..stop: `number` (blocks,); and
    the candidates, where there is room for them.
    """
    counts = blocks.counts
    kept = np.empty(len(sites.order), np.int64)
    around = np.empty(len(sites.order), np.int64)
    half, top = _half_diagonal(sites.sides, counts), sites.weights.max()
    for k in range(start, stop):
        z = (k + 0.5) * sites.sides[0] / counts[0]
        for j in range(counts[1]):
            y = (j + 0.5) * sites.sides[1] / counts[1]
            for i in range(counts[2]):
                x = (i + 0.5) * sites.sides[2] / counts[2]
                place = (k * counts[1] + j) * counts[2] + i
                number[place] = _candidates(kept, around, sites, top, z, y, x, half)
                if len(blocks.seeds):
                    for n in range(number[place]):
                        blocks.seeds[blocks.starts[place] + n] = kept[n]


@inline
def _block_of(at, side, count):
    return min(np.int64(at / side * count), count - 1)


@kernel
def find_cells(owner, grid, sites, blocks, start, stop):
    """Write the cell of every point of planes start..stop; of equally near ones the first."""
    for k in range(start, stop):
        z = grid.z[k] % sites.sides[0]
        bz = _block_of(z, sites.sides[0], blocks.counts[0])
        for j in range(len(grid.y)):
            y = grid.y[j] % sites.sides[1]
            by = _block_of(y, sites.sides[1], blocks.counts[1])
            for i in range(len(grid.x)):
                x = grid.x[i] % sites.sides[2]
                bx = _block_of(x, sites.sides[2], blocks.counts[2])
                place = (bz * blocks.counts[1] + by) * blocks.counts[2] + bx
                best, chosen = np.inf, 0
                for n in range(blocks.starts[place], blocks.starts[place + 1]):
                    seed = blocks.seeds[n]
                    power = _square(sites, seed, z, y, x) - sites.weights[seed]
                    if power < best or (power == best and seed < chosen):
                        best, chosen = power, seed
                owner[k, j, i] = chosen


@inline
def _to_face(sites, own, other, z, y, x):
    """Return the distance from a point of a cell to the plane between it and another."""
    oz = _nearest(z - sites.places[own, 0], sites.sides[0])
    oy = _nearest(y - sites.places[own, 1], sites.sides[1])
    ox = _nearest(x - sites.places[own, 2], sites.sides[2])
    tz = _nearest(z - sites.places[other, 0], sites.sides[0])
    ty = _nearest(y - sites.places[other, 1], sites.sides[1])
    tx = _nearest(x - sites.places[other, 2], sites.sides[2])
    gap = (tz * tz + ty * ty + tx * tx - sites.weights[other]) - (
        oz * oz + oy * oy + ox * ox - sites.weights[own]
    )
    far = np.sqrt((oz - tz) ** 2 + (oy - ty) ** 2 + (ox - tx) ** 2)
    return gap / (2.0 * max(far, 1e-9))


@kernel
def measure_faces(found, owner, grid, sites, starts, others, radius, start, stop):
    """Write the distance of every point of planes start..stop to the faces of its cell."""
    for k in range(start, stop):
        for j in range(len(grid.y)):
            for i in range(len(grid.x)):
                own = owner[k, j, i]
                least, squares = np.inf, 0.0
                for n in range(starts[own], starts[own + 1]):
                    d = _to_face(sites, own, others[n], grid.z[k], grid.y[j], grid.x[i])
                    least = min(least, d)
                    if d < radius:
                        squares += (radius - d) ** 2
                found[k, j, i] = radius - np.sqrt(squares) if squares > 0.0 else least


@kernel
def add_moments(sums, owner, grid, sites, start, stop):
    """Add points and displacements of planes start..stop to `sums` (N, 4) int64."""
    for k in range(start, stop):
        for j in range(len(grid.y)):
            for i in range(len(grid.x)):
                seed = owner[k, j, i]
                dz = _nearest(grid.z[k] - sites.places[seed, 0], sites.sides[0])
                dy = _nearest(grid.y[j] - sites.places[seed, 1], sites.sides[1])
                dx = _nearest(grid.x[i] - sites.places[seed, 2], sites.sides[2])
                sums[seed, 0] += 1
                sums[seed, 1] += np.int64(np.round(dz * FINE))
                sums[seed, 2] += np.int64(np.round(dy * FINE))
                sums[seed, 3] += np.int64(np.round(dx * FINE))

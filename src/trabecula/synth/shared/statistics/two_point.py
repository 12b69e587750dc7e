"""Two-point functions of the soft indicators of fields: 0 to 1 over a few voxels around an
interface, so that a small move of it changes them a little.

Pairs are binned by their distance and by the nearest axis: of distance alone, a material that
is longer along one axis would come out longer still. With axes alone it may come out longer along a
diagonal: so the diagonals have bins of their own where that is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import sum_slabs
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.statistics.byte_tables import count_bytes, look_up_bytes
from trabecula.synth.shared.statistics.long_waves import LongWaves
from trabecula.synth.shared.statistics.pairs import AXES, Pairs, Planes

_SOFTNESS = (1.6, 2.4)  # voxels of the soft interface: on the finest level, and on the others
# farthest distance in voxels of the finest level, and at least so many of a level's own
_REACH, _NEAR = 30, 6


@dataclass(frozen=True)
class Correlations:
    """Target of the steps: `curves` (C, directions (r_max + 1)), the two-point function of every
    channel's soft indicator, of pairs nearest to z, then to y, then to x, or to each of the axes
    and diagonals in turn.

    `softness` is the width of the soft step in int8 steps of the field; `edges` are the sides of a
    voxel; `held` (bool) says for which of them the exemplars hold any pairs. With `waves` the steps
    leave alone waves longer than twice their largest window. Where `blocks` is 2 the soft indicator
    is that of blocks of 2 x 2 x 2 voxels, its mean over them, and distances count in blocks.
    """

    curves: np.ndarray
    softness: float
    edges: tuple[float, ...]
    held: np.ndarray
    waves: LongWaves | None = None
    directions: int = AXES
    blocks: int = 1

    @property
    def r_max(self) -> int:
        """Return the largest distance."""
        return self.curves.shape[1] // self.directions - 1

    def grid(self, shape: Sequence[int]) -> tuple[int, ...]:
        """Return the sides of a torus in blocks: an odd side ends with one that is cut in half."""
        return tuple(-(-side // self.blocks) for side in shape)

    def on_grid(self, planes: Planes, shape: Sequence[int]) -> Planes:
        """Return the planes of blocks of a field of this shape, given by its own planes."""
        return planes if self.blocks == 1 else BlockMeans(planes, tuple(shape))


@dataclass(frozen=True)
class BlockMeans:
    """Means over blocks of 2 x 2 x 2 voxels of a field of some shape, given by its planes; a block
    that is cut in half by a face is continued by the voxels at the face.
    """

    planes: Planes
    shape: tuple[int, ...]

    def __call__(self, start: int, stop: int) -> np.ndarray:
        """Return planes start..stop of blocks, float32."""
        voxels = self.planes(2 * start, min(2 * stop, self.shape[0]))
        means = np.empty((stop - start, *(-(-side // 2) for side in self.shape[1:])), np.float32)
        _block_means(voxels, means)
        return means


def whole_blocks(planes: Planes, shape: Sequence[int], blocks: int) -> Planes:
    """Return the planes of so many blocks (Z, Y, X) of a field that is given by its own planes: its
    far faces may lie beyond them.
    """
    if blocks == 1:
        return planes
    sides = [blocks * side for side in shape]
    return BlockMeans(partial(_near_part, planes, sides[1], sides[2]), tuple(sides))


def _near_part(planes: Planes, height: int, width: int, start: int, stop: int) -> np.ndarray:
    return planes(start, stop)[:, :height, :width]


def correlations_of(
    fields: Sequence[np.ndarray],
    *,
    softness: float,
    r_max: int,
    edges: Sequence[float] = (1.0, 1.0, 1.0),
    directions: int = AXES,
    blocks: int = 1,
) -> Correlations:
    """Measure the two-point functions of the soft indicators of exemplars (C, Z, Y, X) int8, all
    pairs of them counted alike.

    A picture is a volume of one plane across the axis that it is seen across: it says nothing of
    pairs along that axis.

    Parameters
    ----------
    fields : sequence of arrays
    softness : float
        Width of the soft step in int8 steps of the field: FULL / clip is one voxel.
    r_max : int
        Largest distance, in the unit of `edges`.
    edges : three floats
        Sides of a voxel.
    directions : int
        `AXES` or `DIAGONAL`.
    blocks : int
        1 or 2 voxels a side of the blocks whose means are correlated; the largest distance counts
        in blocks.
    """
    steps = (float(edges[0]), float(edges[1]), float(edges[2]))
    bins = directions * (r_max + 1)
    sums, fits = np.zeros((len(fields[0]), bins)), np.zeros(bins)
    for field in fields:
        shape = tuple(side // blocks for side in field.shape[1:])
        pairs = Pairs(shape, r_max, edges=steps, directions=directions)
        fits += pairs.fits
        for c, channel in enumerate(field):
            soft = Soft.of(channel, softness)
            spectrum = pairs.forward(whole_blocks(soft.planes, shape, blocks))
            sums[c] += pairs.curve(spectrum, spectrum) * pairs.fits
    curves = sums / np.maximum(fits, 1)
    return Correlations(curves, softness, steps, fits > 0, directions=directions, blocks=blocks)


def correlations_at(
    fields: Sequence[np.ndarray],
    level: int,
    *,
    edges: Sequence[float],
    clip: float,
    directions: int = AXES,
    blocks: int = 1,
) -> Correlations:
    """Measure the target of one level (0 the finest) of a pyramid, with the softness and the reach
    that suit it.

    `clip` is the distance in voxels of the level at which its int8 fields saturate.
    """
    # a picture has no depth
    shortest = min(side for field in fields for side in field.shape[1:] if side > 1)
    reach = min(_REACH, shortest * 2**level // 2 - 1)
    softness = _SOFTNESS[min(level, len(_SOFTNESS) - 1)] * FULL / clip
    return correlations_of(
        fields,
        softness=softness,
        r_max=max(_NEAR, reach // (blocks * 2**level)),
        edges=edges,
        directions=directions,
        blocks=blocks,
    )


def reweight_target(
    target: Correlations, own: Sequence[Histogram], asked: Sequence[Histogram], *, softness: float
) -> Correlations:
    """Return the target for fields with other histograms: the covariance form (S2 - m^2) / (m -
    m^2) is kept.

    `softness` is that of the indicator whose two-point functions they are.
    """
    curves = []
    for curve, have, want in zip(target.curves, own, asked, strict=True):
        m, w = soft_mean(have, softness), soft_mean(want, softness)
        curves.append((curve - m * m) * ((w - w * w) / max(m - m * m, 1e-30)) + w * w)
    return replace(target, curves=np.array(curves))


def soft_mean(histogram: Histogram, softness: float) -> float:
    """Return the mean of the soft indicator of a field with this histogram."""
    counts = np.diff(histogram.up_to, prepend=0)
    soft = soft_indicator(histogram.values, softness).astype(np.float64)
    return float((soft * counts).sum() / counts.sum())


def soft_means(histograms: Sequence[Histogram], softness: float) -> np.ndarray:
    """Return the means of the soft indicators of channels with these histograms, (C,) float64."""
    return np.array([soft_mean(one, softness) for one in histograms])


def soft_indicator(field: np.ndarray, softness: float) -> np.ndarray:
    """Return 0 .. 1 in float32 of a field in int8."""
    return _table(softness)[field.astype(np.int16) & 255]


@dataclass(frozen=True)
class Soft:
    """The soft indicator of a field (Z, Y, X) int8, 0 where it is not free; nowhere as a whole.

    `table` (256,) float32 is its value by the byte of the field; `free` (Z, Y, X) bool, None for
    everywhere.
    """

    field: np.ndarray
    table: np.ndarray
    free: np.ndarray | None = None

    @classmethod
    def of(cls, field: np.ndarray, softness: float, free: np.ndarray | None = None) -> Soft:
        """Take a field with the width of the soft step in its int8 steps."""
        return cls(field, _table(softness), free)

    def planes(self, start: int, stop: int) -> np.ndarray:
        """Return planes start..stop (n, Y, X) float32."""
        return self._look_up(self.table, start, stop)

    def interface(self, start: int, stop: int) -> np.ndarray:
        """Mark the voxels of planes start..stop (n, Y, X) that are neither 0 nor 1, bool."""
        return self._look_up((self.table > 0) & (self.table < 1), start, stop)

    def centre(self, mean: np.float32, start: int, stop: int) -> np.ndarray:
        """Return planes start..stop less the mean, where they are free."""
        soft = self.planes(start, stop)
        free = True if self.free is None else self.free[start:stop]
        return np.subtract(soft, mean, out=soft, where=free)

    def mean_and_moving(self) -> tuple[np.float32, int]:
        """Return the mean over the free voxels, and count the voxels of the interface."""
        counts = sum_slabs(self._counts, len(self.field))
        total = math.fsum((counts * self.table.astype(np.float64)).tolist())
        moving = counts[(self.table > 0) & (self.table < 1)].sum()
        return np.float32(total / max(1, int(counts.sum()))), int(moving)

    def _look_up(self, table: np.ndarray, start: int, stop: int) -> np.ndarray:
        found = np.empty((stop - start, *self.field.shape[1:]), table.dtype)
        look_up_bytes(self.field[start:stop].view(np.uint8), table, found)
        return found if self.free is None else found * self.free[start:stop]

    def _counts(self, start: int, stop: int) -> np.ndarray:
        """Count each byte in free voxels of these planes, (256,) int64."""
        free = np.empty((0, 0, 0), bool) if self.free is None else self.free[start:stop]
        return count_bytes(self.field[start:stop].view(np.uint8), free)


@kernel
def _block_means(voxels, means):
    """Write the means over blocks of 2 x 2 x 2 voxels, repeating the last voxel where a block lacks
    one.
    """
    depth, height, width = voxels.shape
    for z in range(means.shape[0]):
        near, far = voxels[2 * z], voxels[min(2 * z + 1, depth - 1)]
        for y in range(means.shape[1]):
            up, low = 2 * y, min(2 * y + 1, height - 1)
            for x in range(means.shape[2]):
                a, b = 2 * x, min(2 * x + 1, width - 1)
                first = (near[up, a] + far[up, a]) + (near[low, a] + far[low, a])
                second = (near[up, b] + far[up, b]) + (near[low, b] + far[low, b])
                means[z, y, x] = (first + second) * np.float32(1 / 8)


def _table(softness: float) -> np.ndarray:
    """Return the soft indicator (256,) float32 of every byte of a field."""
    steps = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float64)
    return np.clip(steps / softness + 0.5, 0, 1).astype(np.float32)

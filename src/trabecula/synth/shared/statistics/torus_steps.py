"""Steps on the two-point function of a field on a torus, in one direction: a quarter of the
transforms of `two_point_steps`, which seeks a combination of directions and knows open faces.

The mean of a field over a shell varies less the wider the shell is, so the same push moves long
distances less. Where the share of every band is sought, shares rise with the distance (bone and
Berea, 38 steps; of one direction the prediction was best with pushes by r^1 to r^1.8). Here each
distance is pushed by r^1.2 times its misfit, all of them in one direction, whose length is chosen
as there, and a round takes twice as many steps: with as many as before particles lost their form
(80^3 of a cathode, figures out of band: 7 by the steps in six directions, 14 by as many of these, 4
by twice as many).

Pairs wrap around as the direction does, so every field is transformed once. Power spectra and
kernels are real: half of the lines along z is enough. On the finest level the soft indicator is the
mean over blocks of 2 x 2 x 2 voxels, and the move is continued between their middles: an eighth of
the values. Votes keep what is finer than a block (of six scans Euler density, thickness and S2 came
out alike).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Stage, Workspace
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.content.fields import UNIT, votes_of
from trabecula.synth.shared.statistics.pairs import Pairs, box_response, spans
from trabecula.synth.shared.statistics.two_point import Correlations, Soft
from trabecula.synth.shared.statistics.two_point_steps import (
    LEAK,
    Direction,
    Slopes,
    best_length,
    least_squares,
    longest_wave,
    weigh_distances,
)

_RISE = 1.2  # exponent of the distance in the push


@dataclass(frozen=True)
class TorusPairs(Pairs):
    """Pairs of voxels of a torus: every axis wraps, every voxel is free."""

    @classmethod
    def of(cls, shape: Sequence[int], target: Correlations) -> TorusPairs:
        """Return the pairs by which a target is binned."""
        around = (True, True, True)
        edges, directions = target.edges, target.directions
        return cls(target.grid(shape), target.r_max, around, edges, directions=directions)

    def slope(self, spectrum: np.ndarray, weights: np.ndarray, *, shorter_than: int) -> np.ndarray:
        """Sum a field less its mean around every voxel, as `convolve` does: a view (Z, Y, X)
        float32 of an array like its spectrum.
        """
        kernel, side = self._kernel(weights), self.shape[0]
        values = memmap.empty(spectrum.shape, np.complex64, least=0)
        long_z, long_y, long_x = (box_response(s, shorter_than) ** 2 for s in self.shape)
        long_x = long_x[: spectrum.shape[2]]

        def lines(start: int, stop: int) -> None:
            for low, high in spans(start, stop, spectrum[:, 0].size):
                response = np.fft.hfft(kernel[:, low:high], side, axis=0)
                if shorter_than:
                    response *= 1 - long_z[:, None, None] * (long_y[low:high, None] * long_x)
                product = spectrum[:, low:high] * response
                if low == 0:
                    product[0, 0, 0] = 0
                values[:, low:high] = np.fft.ifft(product, axis=0)

        for_slabs(lines, spectrum.shape[1], anywhere=True)
        real = values.view(np.float32)[:, :, : self.shape[2]]
        self._inverse_planes(values, tuple(map(np.arange, self.shape)), real)
        return real

    def _correlate(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Sum over all pairs of every offset, mean of both orders: of a real spectrum."""
        planes, side = len(self.offsets[0]), self.shape[0]
        kept = memmap.empty((planes, *first.shape[1:]), np.complex64, least=0)

        def lines(start: int, stop: int) -> None:
            for low, high in spans(start, stop, first[:, 0].size):
                a, b = first[:, low:high], second[:, low:high]
                power = a.real * b.real + a.imag * b.imag
                kept[:, low:high] = np.fft.ihfft(power, side, axis=0)[:planes]

        for_slabs(lines, first.shape[1], anywhere=True)
        sums = np.empty(tuple(map(len, self.offsets)), np.float32)
        self._inverse_planes(kept, self.offsets, sums)
        return sums


@dataclass(frozen=True)
class Doubled:
    """A field on a torus of some shape (Z, Y, X), float32, given by its blocks of 2 x 2 x 2 voxels:
    linear between their middles.
    """

    blocks: np.ndarray
    shape: tuple[int, ...]

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, planes: slice) -> np.ndarray:
        """Return some planes (n, Y, X)."""
        found = np.empty((planes.stop - planes.start, *self.shape[1:]), np.float32)
        along_z, along_y, along_x = self._pairs
        _double(self.blocks, along_z, along_y, along_x, planes.start, found)
        return found

    @cached_property
    def _pairs(self) -> list[np.ndarray]:
        """Return the block of every voxel along each axis, and the next nearest one, (2, n)."""
        voxels = [np.arange(side) for side in self.shape]
        return [
            np.stack([at // 2, (at // 2 + np.where(at % 2, 1, -1)) % count])
            for at, count in zip(voxels, self.blocks.shape, strict=True)
        ]


@kernel
def _double(blocks, along_z, along_y, along_x, start, found):
    """Interpolate planes from `start` on between the middles of blocks."""
    three = np.float32(3)
    plane = np.empty(blocks.shape[1:], np.float32)
    row = np.empty(blocks.shape[2], np.float32)
    for n in range(len(found)):
        near, far = blocks[along_z[0, start + n]], blocks[along_z[1, start + n]]
        for y in range(plane.shape[0]):
            for x in range(plane.shape[1]):
                plane[y, x] = three * near[y, x] + far[y, x]
        for y in range(found.shape[1]):
            up, low = plane[along_y[0, y]], plane[along_y[1, y]]
            for x in range(len(row)):
                row[x] = three * up[x] + low[x]
            for x in range(found.shape[2]):
                value = three * row[along_x[0, x]] + row[along_x[1, x]]
                found[n, y, x] = value * np.float32(1 / 64)


def torus_step(
    field: np.ndarray,
    target: Correlations,
    *,
    debt: np.ndarray | None = None,
    renew: bool = False,
    beyond: float = 1.0,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Move the interfaces of a field on a torus one step towards the target's two-point functions.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
    target : Correlations
    debt : (C, bins), optional
        Sum of the misfits that votes left, as of `two_point_steps.accumulate_debt`.
    renew : bool
        Whether the field comes from a vote, so that its misfit joins the debt.
    beyond : float
        How far to aim beyond the target, in debts.

    Returns
    -------
    votes : (C, Z, Y, X) int16
        In 1 / UNIT of an int8 step, to be matched to the exemplar's histogram.
    debt : (C, bins), optional
        The one that this step made up for.
    """
    pairs, votes = TorusPairs.of(field.shape[1:], target), votes_of(field)
    before = np.zeros_like(target.curves) if debt is None else debt
    after = before.copy()
    for c, channel in enumerate(field):
        soft = Soft.of(channel, target.softness)
        work = Workspace(_stages(pairs))
        work.enter("compare")
        spectrum = work.adopt("spectrum", pairs.forward(target.on_grid(soft.planes, channel.shape)))
        misfit = np.where(target.held, pairs.curve(spectrum, spectrum) - target.curves[c], 0.0)
        del spectrum
        if renew:
            after[c] = misfit + LEAK * before[c]
        _step(soft, misfit + beyond * after[c], target, pairs, work, votes[c])
    return votes, None if debt is None and not renew else after


def torus_step_stages(shape: Sequence[int], target: Correlations) -> tuple[Stage, ...]:
    """Declare the arrays of `torus_step` beside the field and the votes, for a volume."""
    return _stages(TorusPairs.of(shape, target))


def _stages(pairs: TorusPairs) -> tuple[Stage, ...]:
    spectrum = {"spectrum": pairs.spectrum}
    slope, change = {"slope": pairs.spectrum}, {"change": pairs.spectrum}
    tables = 2 * pairs.table_bytes + pairs.slab_bytes
    more = tables + 4 * pairs.table_bytes
    return (
        Stage("compare", {**spectrum, "lines": pairs.kernel}, more),
        Stage("make a direction", {**spectrum, **slope, "kernel": pairs.kernel}, tables),
        Stage("compare it", {**spectrum, **slope, **change, "lines": pairs.kernel}, more),
        Stage("take it", {**slope, **change, "lines": pairs.kernel}, more),
    )


def _step(
    soft: Soft,
    excess: np.ndarray,
    target: Correlations,
    pairs: TorusPairs,
    work: Workspace,
    votes: np.ndarray,
) -> None:
    """Take the excess away by a move of the soft indicator, into votes (Z, Y, X) int16."""
    _, moving = soft.mean_and_moving()
    r, weights = weigh_distances(pairs, target)
    push = r**_RISE * weights * excess / np.maximum(pairs.fits, 1)
    if not moving or not push.any():
        return
    work.enter("make a direction")
    push, shortest = push / np.abs(push).max(), longest_wave(target)
    found = pairs.slope(work["spectrum"], push, shorter_than=shortest)
    slope: Slopes = found if target.blocks == 1 else Doubled(found, soft.field.shape)
    direction = Direction.of(slope, soft, moving)
    work.enter("compare it")
    work.adopt("change", pairs.forward(target.on_grid(direction.planes, soft.field.shape)))
    change = 2 * pairs.curve(work["spectrum"], work["change"])
    work.enter("take it")
    square = pairs.curve(work["change"], work["change"])
    (gain,) = least_squares(change[None], excess, weights)
    length = gain * best_length(excess, gain * change, gain**2 * square, weights)
    direction.take(np.float32(length), np.float32(UNIT * target.softness), votes)

"""Long waves: the variation of the local fraction of a phase over windows that are wider than
neighbourhoods.

Neighbourhoods know nothing beyond their width, and two-point functions hardly resolve a wave longer
than their largest distance: a wave of amplitude a adds a^2 / 2 to every distance alike, .0005 for
one that moves the local fraction by .03. So the field is split into bands by box means of doubling
width, the spread of each band is compared with the exemplar's, and interfaces are shifted,
smoothly, until it agrees. A phase keeps its overall fraction: bands have no mean.

Sums are whole numbers and their variances are added plane by plane, so threads and memory-mapped
files change nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, sum_slabs, thread_count
from trabecula.synth.shared.box_sums import window_sums_of_planes
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.statistics.byte_tables import count_bytes, look_up_bytes

_FIRST = 16  # voxels of the finest level: the smallest window, where the exemplar has room for it
_PARTS = 6  # the smallest window is at most such a part of the exemplar's shortest side
_LARGEST = 256  # voxels: sums over wider windows would leave 32 bits
_LEAST = 3
_FINE = 64  # of a soft indicator, in whole numbers
_SLACK = 0.1  # a spread that falls short of the exemplar's by less is left alone
_ENOUGH = 0.05  # so is one that exceeds it by less, which saves most second rounds
_HASTE = 3.0  # a wave little longer than its window passes it weakly, and is shifted back weakly
_MOST = 0.5  # of the soft step, by which an interface is shifted at once
_ROUNDS = 2


@dataclass(frozen=True)
class LongWaves:
    """The spread of the exemplars' local fraction by window.

    Attributes
    ----------
    widths : tuple of int
        Voxels a side of windows, odd and rising; about doubling.
    variances : (C, n) float
        Of the mean soft indicator over windows of each width, per channel.
    bands : (C, n) float
        The same of its difference from the mean over the next wider window around the same place;
        of the widest, from the mean over everything.
    softness : float
        Width of the soft step in int8 steps of the field.
    """

    widths: tuple[int, ...]
    variances: np.ndarray
    bands: np.ndarray
    softness: float

    def extend(self, side: int) -> LongWaves:
        """Return the same for volumes whose shortest side is given: windows up to half of it.

        Wider windows than the exemplars have are continued with the ratio of the last two
        variances, which is 1/8 at least (no correlation at such distances) and 1 at most.
        """
        count = sum(2 * width <= side for width in self.widths)
        variances, bands = self.variances[:, :count], self.bands[:, :count]
        widths = list(self.widths[:count])
        if not count:
            return LongWaves((), variances, bands, self.softness)
        if count < len(self.widths):
            bands = np.concatenate([bands[:, :-1], variances[:, -1:]], axis=1)
        else:
            before = self.variances[:, -2:-1] if count > 1 else 8 * variances[:, -1:]
            ratio = np.clip(variances[:, -1:] / np.maximum(before, 1e-12), 1 / 8, 1)
            while (wider := 2 * widths[-1] + 1) <= min(side // 2, _LARGEST):
                last = variances[:, -1:]
                widths.append(wider)
                variances = np.concatenate([variances, last * ratio], axis=1)
                bands = np.concatenate([bands[:, :-1], last * (1 - ratio), last * ratio], axis=1)
        return LongWaves(tuple(widths), variances, bands, self.softness)


def long_waves_of(fields: Sequence[np.ndarray], level: int, *, softness: float) -> LongWaves:
    """Return the spread of the local fraction in exemplars (C, Z, Y, X) int8 of one level (0 the
    finest).

    Windows lie wholly within an exemplar and are at most a third of its shortest side; they vary
    around the mean of all exemplars.
    """
    shortest = min(side for field in fields for side in field.shape[1:])
    widths = _widths(shortest, level)
    variances, bands = (np.zeros((len(fields[0]), len(widths))) for _ in range(2))
    for c in range(len(fields[0])):
        channels, counts = [field[c] for field in fields], sum(field[c].size for field in fields)
        mean = sum(_soft_window_sums(channel, softness, _LEAST)[1] for channel in channels) / (
            _FINE * counts
        )
        for n, width in enumerate(widths):
            wider = widths[n + 1] if n + 1 < len(widths) else None
            found = np.sum(
                [_squares_of(channel, softness, width, wider, mean) for channel in channels], axis=0
            )
            variances[c, n], bands[c, n] = found[0] / found[1], found[2] / found[3]
    return LongWaves(widths, variances, bands, softness)


def adjust_long_waves(
    votes: np.ndarray,
    target: LongWaves,
    matched: Callable[[np.ndarray], np.ndarray],
    wraps: tuple[bool, bool, bool] = (True, True, True),
) -> None:
    """Shift the interfaces of votes until the spread of every band is the exemplars', in place.

    A band whose spread falls short by less than a tenth, or exceeds by less than a twentieth, is
    left as it is. Windows wider than half of the shortest side are not looked at.

    Parameters
    ----------
    votes : (C, Z, Y, X) int16
        1 / UNIT of an int8 step.
    target : LongWaves
    matched : callable
        Makes the field (C, Z, Y, X) int8 of votes, with the exemplars' histogram: its spread
        counts. A shift that is less than the gap between two values of a distance changes
        the votes' soft indicator, and no label.
    wraps : three bools
        Axes on which windows continue beyond a face.
    """
    waves = target.extend(min(votes.shape[1:]))
    if not waves.widths:
        return
    for _ in range(_ROUNDS):
        work = Workspace(wave_stages(votes.shape))
        work.enter("waves")
        work.adopt("matched", matched(votes))
        moved = [_adjust(votes[c], c, waves, wraps, work) for c in range(len(votes))]
        if not any(moved):
            break


def wave_stages(shape: Sequence[int]) -> tuple[Stage, ...]:
    """Declare the arrays of `adjust_long_waves` beside the votes (C, Z, Y, X)."""
    _, *volume = shape
    sums, planes = Array(volume, np.int32), 60 * shape[2] * shape[3]
    arrays = {
        "matched": Array(shape, np.int8),
        "narrow": sums,
        "wide": sums,
        "change": Array(volume, np.float32),
    }
    return (
        Stage("waves", arrays, thread_count() * (planes + shape[1] * 4 * shape[3] + (1 << 16))),
    )


def _widths(shortest: int, level: int) -> tuple[int, ...]:
    """Return odd widths on a level, for exemplars whose shortest side on it is given."""
    side = shortest * 2**level
    width, widths = float(min(_FIRST, side / _PARTS)), []
    while 3 * width <= side and width <= _LARGEST:
        widths.append(max(_LEAST, 2 * int(width / 2**level / 2) + 1))
        width *= 2
    return tuple(sorted({w for w in widths if 2 * w <= shortest}))


def _table(softness: float) -> np.ndarray:
    """Return the soft indicator (256,) int32 of every byte of a field: 0 .. `_FINE` in whole
    numbers.
    """
    values = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float32)
    soft = values * np.float32(_FINE / softness) + np.float32(_FINE / 2)
    return np.rint(np.clip(soft, 0, _FINE, out=soft), out=soft).astype(np.int32)


def _soft_window_sums(channel: np.ndarray, softness: float, width: int) -> tuple[np.ndarray, int]:
    """Sum the soft indicator of (Z, Y, X) int8 over windows, with nothing beyond the faces, and
    over everything.
    """
    soft = partial(_soft_planes, channel, _table(softness))
    return window_sums_of_planes(soft, channel.shape, width, (False, False, False))


def _soft_planes(channel: np.ndarray, table: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Return the soft indicator of planes start..stop of (Z, Y, X) int8, int32."""
    found = np.empty((stop - start, *channel.shape[1:]), np.int32)
    look_up_bytes(channel[start:stop].view(np.uint8), table, found)
    return found


def _squares_of(
    channel: np.ndarray, softness: float, width: int, wider: int | None, mean: float
) -> tuple[float, int, float, int]:
    """Sum the squares over all windows of a width, and count them; then those of the band that ends
    with a wider one.
    """
    narrow, _ = _soft_window_sums(channel, softness, width)
    alone = _Band(narrow, None, 1 / (_FINE * width**3), 1.0, mean).squares_within(width)
    if wider is None:
        return *alone, *alone
    wide, _ = _soft_window_sums(channel, softness, wider)
    band = _Band(narrow, wide, 1 / (_FINE * width**3), 1 / (_FINE * wider**3), mean)
    return *alone, *band.squares_within(wider)


def _adjust(
    votes: np.ndarray, c: int, waves: LongWaves, wraps: tuple[bool, bool, bool], work: Workspace
) -> bool:
    """Shift channel `c` of votes (Z, Y, X) int16, whose field is in `work`, once; return whether
    there was anything to shift.
    """
    table, field = _table(waves.softness), work["matched"][c]
    if "change" in work:
        work.release("change")

    everywhere = np.empty((0, 0, 0), bool)
    counts = sum_slabs(lambda a, b: count_bytes(field[a:b].view(np.uint8), everywhere), len(field))
    moving = int(counts[(table > 0) & (table < _FINE)].sum()) / field.size
    if not moving:
        return False

    def sums(name: str, width: int) -> int:
        soft = partial(_soft_planes, field, table)
        found, total = window_sums_of_planes(soft, field.shape, width, wraps)
        work.adopt(name, found)
        return total

    mean = sums("narrow", waves.widths[0]) / (_FINE * field.size)
    for n, width in enumerate(waves.widths):
        wider = waves.widths[n + 1] if n + 1 < len(waves.widths) else None
        if wider is not None:
            sums("wide", wider)
        _add_band(work, (width, wider), mean, waves.bands[c][n], moving)
        work.release("narrow")
        if wider is not None:
            work.adopt("narrow", work.take("wide"))
    if "change" not in work:
        return False
    change, unit = work["change"], np.float32(UNIT * waves.softness)
    for_slabs(partial(_shift, votes, field.view(np.uint8), table, change, unit), len(votes))
    return True


def _add_band(
    work: Workspace, widths: tuple[int, int | None], mean: float, wanted: float, moving: float
) -> None:
    """Add what a band is to change by to the change of the votes."""
    width, wider = widths[0], widths[1] or 1
    wide = None if widths[1] is None else work["wide"]
    band = _Band(work["narrow"], wide, 1 / (_FINE * width**3), 1 / (_FINE * wider**3), mean)
    gain = _gain(wanted, band.variance())
    if gain:
        change = work["change"] if "change" in work else work.zeros("change")
        band.add(change, np.float32(-gain / moving))


def _gain(wanted: float, found: float) -> float:
    """Return the share of a band that is taken away; negative: added to it."""
    if found <= 0:
        return 0.0
    excess = 1 - math.sqrt(wanted / found)
    if 0 < excess < _ENOUGH:
        return 0.0
    if excess < 0:
        excess = min(0.0, 1 - math.sqrt(wanted / found) * (1 - _SLACK))
    return min(max(_HASTE * excess, -1.0), 1.0)


@dataclass(frozen=True)
class _Band:
    """The difference of two means: sums over windows `narrow` and `wide` (None: `mean` everywhere),
    times their scales.
    """

    narrow: np.ndarray
    wide: np.ndarray | None
    scale: float
    wider_scale: float
    mean: float

    def variance(self) -> float:
        """Return the mean square over everything."""
        squares = np.zeros(len(self.narrow))
        for_slabs(partial(_sum_squares, *self._parts, 0, squares), len(squares))
        return math.fsum(squares.tolist()) / self.narrow.size

    def squares_within(self, width: int) -> tuple[float, int]:
        """Return the sum of squares over windows of an odd width that lie within the volume, and
        their number.
        """
        low, sides = width // 2, self.narrow.shape
        squares = np.zeros(sides[0])
        for_slabs(partial(_sum_squares, *self._parts, low, squares), len(squares))
        inner = squares[low : sides[0] - low]
        return math.fsum(inner.tolist()), math.prod(side - 2 * low for side in sides)

    def add(self, shift: np.ndarray, factor: np.float32) -> None:
        """Add the band, times a factor, to (Z, Y, X) float32."""
        for_slabs(partial(_add_multiple, *self._parts, factor, shift), len(shift))

    @property
    def _parts(self) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Return both sums and their scales; a mean as one sum of windows of everything."""
        if self.wide is None:
            return self.narrow, np.ones((1, 1, 1), np.int32), self.scale, self.mean
        return self.narrow, self.wide, self.scale, self.wider_scale


@inline
def _difference(narrow, wide, scale, wider_scale, z, y, x):
    """Return the band in a voxel."""
    far = wide[0, 0, 0] if wide.size == 1 else wide[z, y, x]
    return np.float32(narrow[z, y, x] * scale - far * wider_scale)


@kernel
def _sum_squares(narrow, wide, scale, wider_scale, rim, squares, start, stop):
    """Write the sum of a band's squares in planes start..stop, without a rim of some voxels."""
    for z in range(start, stop):
        total = 0.0
        for y in range(rim, narrow.shape[1] - rim):
            for x in range(rim, narrow.shape[2] - rim):
                value = np.float64(_difference(narrow, wide, scale, wider_scale, z, y, x))
                total += value * value
        squares[z] = total


@kernel
def _add_multiple(narrow, wide, scale, wider_scale, factor, shift, start, stop):
    """Add a band times a factor to planes start..stop."""
    for z in range(start, stop):
        for y in range(narrow.shape[1]):
            for x in range(narrow.shape[2]):
                band = _difference(narrow, wide, scale, wider_scale, z, y, x)
                shift[z, y, x] += band * factor


@kernel
def _shift(votes, field, table, change, unit, start, stop):
    """Add a change to the votes of planes start..stop, where the soft indicator is neither 0 nor
    whole.
    """
    most, limit = np.float32(_MOST), np.float32(FULL * UNIT)
    for z in range(start, stop):
        for y in range(votes.shape[1]):
            for x in range(votes.shape[2]):
                inside = table[field[z, y, x]]
                if inside == 0 or inside == _FINE:
                    continue
                step = min(max(change[z, y, x], -most), most) * unit
                moved = np.rint(np.float32(votes[z, y, x]) + step)
                votes[z, y, x] = np.int16(min(max(moved, -limit), limit))

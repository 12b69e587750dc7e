"""What a generator's patterns are off on average, and voxels that change phase because of it.

A window of unlimited material knows no whole whose misfit it could share, and samples scatter as
the material does: brought to the exemplar's densities one by one they would all be alike. So it is
the generator whose densities are compared with the exemplar's, once, at the fraction that a block
has, and each block is changed by what is off there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.synth.shared.patterns.counts import Bins
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.excess import FractionCells, kept_cells
from trabecula.synth.shared.patterns.flip_block import flip_block
from trabecula.synth.shared.patterns.kernels import MARGIN
from trabecula.synth.shared.patterns.misfit import EFFORT, Misfit, VotePrice, steps_around

_ROUNDS = 3  # of measuring what is still off: flips fall short of what they are asked for
_EVERYWHERE = np.empty((0, 0, 0), bool)


@dataclass(frozen=True)
class PatternBias:
    """Densities that a generator is to have, and how much more of each it makes.

    Attributes
    ----------
    wanted : PatternDensities
        Of the exemplars; of two phases with slopes.
    own : (bins,) array
        What it has too much at the exemplars' fraction of the second phase.
    slopes : (bins,) array
        By how much that rises with the fraction.
    """

    wanted: PatternDensities
    own: np.ndarray
    slopes: np.ndarray

    @classmethod
    def learn(
        cls,
        exemplars: Sequence[np.ndarray],
        count: int,
        make: Callable[[PatternBias | None], np.ndarray],
        *,
        width: int,
    ) -> PatternBias:
        """Compare exemplars, phases (Z, Y, X) uint8 below `count`, with what a generator makes.

        Parameters
        ----------
        exemplars, count :
            Phases, counted from 0.
        make : callable
            Returns phases (Z, Y, X) of material, changed by a bias, without one as it comes.
        width : int
            Voxels a side of the windows that tell how densities change with the fraction.
        """
        wanted = _measure(exemplars, count, width)
        zero = np.zeros(wanted.bins.total)
        found = None
        for _ in range(_ROUNDS):
            made = _measure([make(found)], count, width)
            rise = zero if made.slopes is None else made.slopes
            own = made.own + (wanted.fraction - made.fraction) * rise - wanted.own
            slopes = rise if wanted.slopes is None else rise - wanted.slopes
            if found is not None:
                own, slopes = own + found.own, slopes + found.slopes
            found = cls(wanted, own, slopes)
        assert found is not None
        return found

    def mend(
        self,
        local: np.ndarray,
        votes: np.ndarray,
        key: np.uint64,
        *,
        level: float,
        unit: float,
        cells: FractionCells | None = None,
    ) -> np.ndarray:
        """Return the phases (Z, Y, X) uint8 of a block that are changed; as they were where the
        exemplars have no place of such a fraction.

        Parameters
        ----------
        local : (Z, Y, X) uint8
            With `MARGIN` voxels around the block. It is changed as well.
        votes : (C, Z, Y, X) int16
            Signed distances that the block was made of, as of `flip_voxels`.
        key : uint64
            Of seed and place.
        level : float
            Of the votes where the second of two phases begins.
        unit : float
            Of the votes in a voxel.
        cells : FractionCells, optional
            Of the block. Default: it keeps its fraction as a whole.
        """
        core = local[(slice(MARGIN, -MARGIN),) * 3]
        more = float(np.mean(core == 1)) - self.wanted.fraction
        target = self.wanted.own
        if self.wanted.slopes is not None:
            found = self.wanted.at(self.wanted.fraction + more)
            if found is None:
                return core
            target = found
        else:
            more = 0.0
        off = self.own + more * self.slopes
        phases = self.wanted.bins.phases
        if cells is None:
            cells = kept_cells(core.shape, phases, max(core.shape))
        misfit = Misfit(self.wanted.bins, core.size, target * core.size, off * core.size)
        flip_block(
            local,
            phases,
            _EVERYWHERE,
            VotePrice(np.ascontiguousarray(votes), level, EFFORT / unit),
            (key, 0),
            misfit.of_block(1.0),
            steps_around(local.shape),
            cells,
            np.zeros(self.wanted.bins.total, np.int64),
        )
        return core

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the densities that are wanted and what is off, (1 or 2, bins) float32."""
        wanted = self.wanted
        rows = [(wanted.own, self.own)]
        if wanted.slopes is not None:
            rows.append((wanted.slopes, self.slopes))
        both = (np.asarray(column, np.float32) for column in zip(*rows, strict=True))
        return dict(zip(("wanted", "off"), both, strict=True))

    def plain(self) -> dict[str, Any]:
        """Return the rest as plain JSON."""
        wanted = self.wanted
        return {
            "phases": wanted.bins.phases,
            "fraction": wanted.fraction,
            "below": wanted.below,
            "above": wanted.above,
        }

    @classmethod
    def from_parts(cls, arrays: Mapping[str, np.ndarray], plain: Mapping[str, Any]) -> PatternBias:
        """Return what `arrays` and `plain` described.

        Raises
        ------
        ValueError, TypeError, LookupError
            Not such a description.
        """
        bins = Bins(int(plain["phases"]))
        rows = 2 if bins.phases == 2 else 1
        both = [np.asarray(arrays[name], np.float64) for name in ("wanted", "off")]
        numbers = [float(plain[name]) for name in ("fraction", "below", "above")]
        whole = all(a.shape == (rows, bins.total) and np.isfinite(a).all() for a in both)
        if not whole or not all(map(math.isfinite, numbers)):
            raise ValueError("its patterns are damaged")
        slopes = both[0][1] if rows == 2 else None
        wanted = PatternDensities(bins, both[0][0], slopes, *numbers)
        off = both[1][1] if rows == 2 else np.zeros(bins.total)
        return cls(wanted, both[1][0], off)


def _measure(volumes: Sequence[np.ndarray], count: int, width: int) -> PatternDensities:
    """Measure densities, of two phases with their slopes."""
    if count > 2:
        return PatternDensities.of(volumes, count)
    return PatternDensities.by_fraction(volumes, count, width)

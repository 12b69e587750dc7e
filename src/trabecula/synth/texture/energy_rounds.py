"""The paper's vote of one round: both terms of equation (1), the weights of equation (2), and the
energy's trace.

The plain vote of `optimise` is the special case without a gradient term, with weights from the
distances of features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.matching.grid import Grid, wrap_field
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.energy import (
    Energy,
    Feedback,
    adaptive_weights,
    energy,
    mismatch,
    total,
)
from trabecula.synth.texture.gradient import GradientVotes, add_votes, empty_votes, fold_votes
from trabecula.synth.texture.poisson import solve_votes

_UNIT = 64  # the integer weight that stands for 1


@dataclass(frozen=True)
class Balance:
    """The feedback of one grid, and the distance that weights are relative to (that of its first
    round).
    """

    feedback: Feedback
    reference: float | None = None

    @classmethod
    def at_first(cls, config: TextureConfig, rounds: int) -> Balance:
        """Return the balance before the first round."""
        rise, fall = (config.increase, config.decrease) if config.adaptive else (0.0, 0.0)
        return cls(Feedback(tolerance=config.tolerance, most=rounds, increase=rise, decrease=fall))

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Balance:
        """Rebuild it from plain JSON."""
        feedback = stored["feedback"]
        trace = tuple(Energy(**energy) for energy in feedback["trace"])
        return cls(Feedback(**{**feedback, "trace": trace}), stored["reference"])

    def trace(self) -> list[dict[str, Any]]:
        """Return every round's energies, as plain JSON."""
        return [asdict(round_) for round_ in self.feedback.trace]


def round_bytes(voxels: int, sites: int, *, channels: int) -> int:
    """Forecast the memory of a round on so many covered voxels: the votes, the solver's arrays, the
    state before.
    """
    return voxels * (13 * channels + 30) + 16 * sites


def slab_bytes(plane: int, sites: int, *, width: int, channels: int) -> int:
    """Forecast a thread's memory in a round whose arrays are memory-mapped: some planes, of `plane`
    voxels and `sites` sites.

    A plane of sites reads `width` planes of the field; numbers of its energies are added as those
    of Python.
    """
    return plane * (2 * width * channels + 20 * channels + 60) + 120 * sites


def energy_vote(
    grid: Grid,
    field: np.ndarray,
    match: np.ndarray,
    balance: Balance,
    config: TextureConfig,
    *,
    trim: int,
) -> tuple[np.ndarray, Balance]:
    """Return the votes (C, Z, Y, X) int16 for matches found on `field`, and the balance
    after them.
    """
    candidates = grid.candidates
    where: dict[str, Any] = {
        "shape": candidates.shape,
        "stride": candidates.stride,
        "step": candidates.step,
        "width": candidates.basis.width,
    }
    exemplar = candidates.stack.field
    squared, _ = mismatch(
        wrap_field(grid, field), exemplar, match, gradient=False, active=grid.active, **where
    )
    floor = float(len(exemplar) * candidates.basis.width**3)  # one unit of the field per voxel
    reference = balance.reference or math.sqrt(_mean(squared, grid.active) + floor)
    settings = {"robustness": config.robustness, "reference": reference, "floor": floor}
    weights = _weights(squared, grid.active, settings)
    del squared
    scale = balance.feedback.scale
    # lambda W + mu L = lambda (W + (mu / lambda) L): only their ratio moves the field.
    solved = solve_votes(
        fold_votes(_cast(grid, match, weights, where, trim), field.shape[1:]),
        mu=config.gradient / scale,
        unit=_UNIT,
    )
    after = mismatch(wrap_field(grid, solved), exemplar, match, active=grid.active, **where)
    found = energy(after[0], after[1], weights, mu=config.gradient, unit=scale / _UNIT, **settings)
    return solved, Balance(balance.feedback.after(found), reference)


def _mean(squared: np.ndarray, active: np.ndarray) -> float:
    """Average over the sites that are active; 0 where none is."""
    count = sum_slabs(lambda a, b: np.count_nonzero(active[a:b]), len(active))
    return total(lambda z: squared[z][active[z]], len(squared)) / max(1, count)


def _weights(squared: np.ndarray, active: np.ndarray, settings: dict[str, float]) -> np.ndarray:
    """Compute the weights of equation (2) in integers; 0 where a site is not active."""
    weights = memmap.empty(squared.shape, np.int32)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            own = np.clip(np.rint(_UNIT * adaptive_weights(squared[z], **settings)), 1, 1023)
            weights[z] = np.where(active[z], own, 0)

    for_slabs(work, len(weights))
    return weights


def _cast(
    grid: Grid, match: np.ndarray, weights: np.ndarray, where: dict[str, Any], trim: int
) -> GradientVotes:
    """Sum the votes for values and gradients."""
    exemplar = grid.candidates.stack.field
    votes = empty_votes(grid.reach, channels=len(exemplar))
    add_votes(votes, exemplar, match, weights, trim=trim, wraps=grid.region.wraps, **where)
    return votes

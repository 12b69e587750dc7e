"""The paper's vote of one round: both terms of equation (1), the weights of equation (2), and the
energy's trace.

The plain vote is the special case without a gradient term, with weights from the distances of
features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.memory import Array, Stage, Workspace
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
from trabecula.synth.texture.gradient import (
    GradientVotes,
    add_votes,
    empty_votes,
    fold_votes,
    vote_arrays,
)
from trabecula.synth.texture.poisson import solve_votes

_UNIT = 64  # the integer weight that stands for 1
_FLOATS = 120  # bytes of a site whose energies are numbers of Python
_SUMS = 6  # bytes of a voxel of the exemplar, of its gradients


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


def energy_stages(
    exemplar: np.ndarray, shape: Sequence[int], sites: Sequence[int], reach: Sequence[int]
) -> tuple[Stage, ...]:
    """Declare the arrays of `energy_vote` beside field and matches.

    Parameters
    ----------
    exemplar : (C, z, y, x) int8
    shape, sites, reach : three int
        Voxels of the field, sites, and voxels that these cover; axes that wrap are counted on.
    """
    channels, wraps = len(exemplar), tuple(shape) != tuple(reach)
    held = {"weights": Array(sites, np.int32), "solved": Array((channels, *shape), np.int16)}
    squared = {
        "squared": Array((2, *sites), np.float64),
        "grown": Array((channels, *reach), np.int16) if wraps else None,
    }
    sums, around = vote_arrays(shape, channels), vote_arrays(reach, channels) if wraps else {}
    unfolded = {f"unfolded {name}": array for name, array in around.items()}
    solver = ("solution", "inverse", "rest", "along", "image")
    solving = {name: Array(shape, np.float32) for name in solver}
    return (
        Stage("evaluate", {**held, **squared}, _FLOATS * sites[1] * sites[2]),
        Stage("fold", {**held, **sums, **unfolded}, _SUMS * exemplar.size),
        Stage("solve", {**held, **sums, **solving}),
    )


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
    work = Workspace(energy_stages(exemplar, field.shape[1:], grid.shape, grid.reach))
    work.enter("evaluate")
    work.adopt(
        "squared",
        mismatch(
            wrap_field(grid, field), exemplar, match, gradient=False, active=grid.active, **where
        ),
    )
    floor = float(len(exemplar) * candidates.basis.width**3)  # one unit of the field per voxel
    reference = balance.reference or math.sqrt(_mean(work["squared"][0], grid.active) + floor)
    settings = {"robustness": config.robustness, "reference": reference, "floor": floor}
    weights = work.adopt("weights", _weights(work["squared"][0], grid.active, settings))
    work.enter("solve")
    scale = balance.feedback.scale
    # lambda W + mu L = lambda (W + (mu / lambda) L): only their ratio moves the field.
    solved = work.adopt(
        "solved",
        solve_votes(
            fold_votes(_cast(grid, match, weights, where, trim), field.shape[1:]),
            mu=config.gradient / scale,
            unit=_UNIT,
        ),
    )
    work.enter("evaluate")
    after = work.adopt(
        "squared",
        mismatch(wrap_field(grid, solved), exemplar, match, active=grid.active, **where),
    )
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

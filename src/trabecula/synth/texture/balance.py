"""One round's vote as the paper takes it: both terms of equation (1), the weights of equation (2), and the energy's trace.

The plain vote of `optimise` is the special case without a gradient term, with weights from the distances of features.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.synth.shared.matching.grid import Grid, wrapped
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.energy import Feedback, adaptive_weights, energy, mismatch
from trabecula.synth.texture.gradient import add_votes, fold_votes, no_votes
from trabecula.synth.texture.poisson import solve_votes

_UNIT = 64  # the integer weight that stands for 1


@dataclass(frozen=True)
class Balance:
    """The feedback of one grid, and the distance that weights are relative to (that of its first round)."""

    feedback: Feedback
    reference: float | None = None

    @classmethod
    def at_first(cls, config: TextureConfig, rounds: int) -> Balance:
        """Before the first round."""
        rise, fall = (config.increase, config.decrease) if config.adaptive else (0.0, 0.0)
        return cls(Feedback(tolerance=config.tolerance, most=rounds, increase=rise, decrease=fall))

    def trace(self) -> list[dict[str, Any]]:
        """Every round's energies, as plain JSON."""
        return [asdict(round_) for round_ in self.feedback.trace]


def balanced(
    grid: Grid, field: np.ndarray, match: np.ndarray, balance: Balance, config: TextureConfig, *, trim: int
) -> tuple[np.ndarray, Balance]:
    """The votes (C, Z, Y, X) int16 for matches found on `field`, and the balance after them."""
    candidates = grid.candidates
    where: dict[str, Any] = {
        "shape": candidates.shape,
        "stride": candidates.stride,
        "step": candidates.step,
        "width": candidates.basis.width,
    }
    exemplar = candidates.stack.field
    chosen = np.where(grid.active, match, np.int32(-1))
    squared, _ = mismatch(wrapped(grid, field), exemplar, chosen, gradient=False, **where)
    floor = float(len(exemplar) * candidates.basis.width**3)  # one unit of the field per voxel
    present = squared[grid.active]
    reference = balance.reference or math.sqrt(math.fsum(present) / max(1, present.size) + floor)
    settings = {"robustness": config.robustness, "reference": reference, "floor": floor}
    weights = np.clip(np.rint(_UNIT * adaptive_weights(squared, **settings)), 1, 1023).astype(np.int32)
    weights = np.where(grid.active, weights, 0).astype(np.int32)

    votes = no_votes(grid.reach, channels=len(exemplar))
    add_votes(votes, exemplar, chosen, weights, trim=trim, wraps=grid.region.wraps, **where)
    votes = fold_votes(votes, field.shape[1:])
    scale = balance.feedback.scale
    # lambda W + mu L = lambda (W + (mu / lambda) L): only their ratio moves the field.
    solved = solve_votes(votes, mu=config.gradient / scale, unit=_UNIT)
    after = mismatch(wrapped(grid, solved), exemplar, chosen, **where)
    used = scale * weights / _UNIT
    found = energy(after[0], after[1], used, mu=config.gradient, **settings)
    return solved, Balance(balance.feedback.after(found), reference)

"""The feedback of one scale: what has been learnt of how levels go with the sums around them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.synth.mrf.feedback import Joint, in_units, local_change

Tables = list[np.ndarray]
"""By cell and group (C, B, G) int64, for each learner: counts, or a bias in units."""


class Steering:
    """A bias by cell of the local sum and group of levels, one for each learner.

    Parameters
    ----------
    joints : sequence of Joint
        The statistics of every learner.
    views : int
        How many views pull at a site at once.
    rate : float
        Setting `feedback`.

    Attributes
    ----------
    by_cell : list of (C, B, G) float64
    """

    def __init__(self, joints: Sequence[Joint], views: int, *, rate: float) -> None:
        self._joints = list(joints)
        # Every view and every channel pulls with its own table: together they move as far as the
        # rate says.
        self._rate = rate / (views * len(joints[0].share))
        self.by_cell = [np.zeros(joint.share.shape) for joint in joints]

    def bias(self) -> Tables:
        """The bias of every group by cell, in units."""
        return [in_units(part) for part in self.by_cell]

    def empty_tables(self) -> Tables:
        """What a sweep counts into."""
        return [np.zeros(part.shape, np.int64) for part in self.by_cell]

    def learn(self, counted: Tables) -> None:
        """The counts of a whole sweep; learners that it did not ask have none."""
        for n, (joint, table) in enumerate(zip(self._joints, counted, strict=True)):
            if table.any():
                self.by_cell[n] = self.by_cell[n] + self._rate * local_change(joint, table)

    def state(self) -> dict[str, np.ndarray]:
        """What the next sweep starts from."""
        return {f"by_cell{n}": part for n, part in enumerate(self.by_cell)}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a `state`."""
        self.by_cell = [arrays[f"by_cell{n}"] for n in range(len(self.by_cell))]

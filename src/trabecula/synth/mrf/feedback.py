"""Feedback: a learnt bias that draws the output's local statistics to the picture's.

For every channel of the features, the sum over a slice neighbourhood is put in one of a few cells;
how often a group of levels occurs as the centre of each cell is the joint statistic. After a sweep
the bias of a group in a cell moves by the logarithm of how often it should occur there over how
often it does. The levels' shares of the whole are not its business (`shares`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.mrf.tables import UNIT

if TYPE_CHECKING:
    from trabecula.synth.mrf.content import Content
    from trabecula.synth.mrf.patches import Patches

_ROWS = 4096  # neighbourhoods that are summed at once
_MOST = 12.0  # factors of two in a bias


@dataclass(frozen=True)
class Joint:
    """How often (C, B, G) float64 a group of levels has a local sum in a cell; `edges` (C, B - 1)
    int32 part the cells.
    """

    edges: np.ndarray
    share: np.ndarray


def joint_of(patches: Patches, content: Content, bins: int) -> Joint:
    """The joint statistic of a picture's neighbourhoods, with cells of about equal share."""
    features = content.features
    groups = int(content.groups.max()) + 1
    edges = np.empty((features.shape[1], bins - 1), np.int32)
    share = np.zeros((features.shape[1], bins, groups))
    for c in range(features.shape[1]):
        column = features[:, c].astype(np.int32)
        parts = np.array_split(patches.around, 1 + len(patches.around) // _ROWS)
        sums = np.concatenate([column[part].sum(1, dtype=np.int32) for part in parts])
        edges[c] = np.sort(sums)[np.arange(1, bins) * len(sums) // bins]
        np.add.at(
            share[c],
            (np.searchsorted(edges[c], sums, side="left"), content.groups[patches.centres]),
            1,
        )
    return Joint(edges, share / len(patches.centres))


def local_change(joint: Joint, counted: np.ndarray) -> np.ndarray:
    """How the bias (C, B, G) float64 of a group in a cell is to change after `counted` (C, B, G),
    at most 1 factor of two.

    By how often a group occurs in a cell, given the cell. It is freed of what it would do to the
    groups' own shares, which have another owner. One count is added on both sides, so that what is
    rare is not moved by chance.
    """
    wanted = joint.share * counted[0].sum() + 1
    seen = counted + 1
    given = np.log2(wanted / wanted.sum(2, keepdims=True)) - np.log2(
        seen / seen.sum(2, keepdims=True)
    )
    given = np.clip(given - given.mean(2, keepdims=True), -1, 1)
    given -= (joint.share.sum(2, keepdims=True) * given).sum(1, keepdims=True)
    return given


def in_units(bias: np.ndarray) -> np.ndarray:
    """Factors of two in whole units (int64)."""
    return np.rint(np.clip(bias, -_MOST, _MOST) * UNIT).astype(np.int64)


@kernel
def cells_of(sums, edges, cells):
    """The cell (S, C) uint8 of every local sum (S, C) int32: as many as there are edges below it."""
    for s in range(len(sums)):
        for c in range(len(edges)):
            cell = 0
            while cell < edges.shape[1] and sums[s, c] > edges[c, cell]:
                cell += 1
            cells[s, c] = cell


@kernel
def pull(cells, bias, groups, out):
    """Adds the bias (C, B, G) of the cells to every level: `out` (S, L) int64."""
    for s in range(len(cells)):
        for c in range(len(bias)):
            row = bias[c, cells[s, c]]
            for level in range(len(groups)):
                out[s, level] += row[groups[level]]


@kernel
def count(cells, groups, chosen, table):
    """Counts the levels chosen (S,) by cell and group: `table` (C, B, G) int64."""
    for s in range(len(cells)):
        for c in range(len(table)):
            table[c, cells[s, c], groups[chosen[s]]] += 1

"""The guide of a search among turned and scaled copies: beside the volume fraction the local fabric
and the size, as more features.

A neighbourhood is near to a place where the material around it changes least along the target's
direction: not where its copy was turned to it, since a scan's own windows do not all lie alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.target import FRAME, Target
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.matching.grid import Grid, append_guide
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.turned_exemplars import PAIRS, TurnedExemplars, wanted_fabric

_TURN = 12000  # features in a fabric of 1
_SIZE = 4000  # features between a size and twice it


def guide_count(target: Mapping[str, Target]) -> int:
    """Count the features that a target's orientation and size add."""
    return len(PAIRS) * ("orientation" in target) + ("size" in target)


def guide_turned(
    grid: Grid, copies: TurnedExemplars, target: Mapping[str, Target], index: int
) -> Grid:
    """Return a guided grid of level `index` whose search follows a target's orientation and size as
    well.
    """
    fractions = grid.guide
    assert fractions is not None
    places = grid.middles
    fields = {name: np.asarray(value) for name, value in target.items() if name in FRAME}
    added = guide_count(target)
    guide = memmap.empty((*grid.shape, 1 + added), np.int16)

    def work(start: int, stop: int) -> None:
        guide[start:stop, ..., :1] = fractions[start:stop]
        near = [places[0][start:stop], *places[1:]]
        guide[start:stop, ..., 1:] = _wanted(fields, near, index)

    for_slabs(work, len(guide))
    return replace(
        grid, guide=guide, candidates=_add_features(grid.candidates, copies, index, fields)
    )


def _wanted(
    fields: Mapping[str, np.ndarray], places: Sequence[np.ndarray], index: int
) -> np.ndarray:
    """Return the features of a target at places of a level."""
    found = []
    shape = tuple(len(at) for at in places)
    for name in (name for name in FRAME if name in fields):
        values, axes = fields[name], int(name == "orientation")
        if values.ndim > axes:
            sides = values.shape[:3]
            near = [
                np.minimum((at << index) + (1 << index) // 2, side - 1)
                for at, side in zip(places, sides, strict=True)
            ]
            values = values[np.ix_(*near)]
        else:
            values = np.broadcast_to(values, shape + values.shape)
        found.append(_fabric_features(wanted_fabric(values)) if axes else _size_features(values))
    return np.concatenate(found, axis=-1)


def _add_features(
    candidates: Candidates,
    copies: TurnedExemplars,
    index: int,
    fields: Mapping[str, np.ndarray],
) -> Candidates:
    """Return candidates with the local fabric and the size of their copies as more features."""
    middle = [
        np.arange(count) * stride + w // 2
        for count, stride, w in zip(
            candidates.shape, candidates.strides, candidates.basis.box, strict=True
        )
    ]
    directed = "orientation" in fields
    added = len(PAIRS) * directed + ("size" in fields)
    features = np.zeros((*candidates.shape, added), np.int16)
    stack = candidates.stack
    for number, (start, sides) in enumerate(zip(stack.starts, stack.sides, strict=True)):
        first, last = np.searchsorted(middle[0], [start, start + sides[0]])
        at = [middle[0][first:last] - start, *middle[1:]]
        if directed:
            finest = [(place << index) + (1 << index) // 2 for place in at]
            fabric = copies.fabric_at(number, finest)
            features[first:last, ..., : len(PAIRS)] = _fabric_features(fabric)
        if "size" in fields:
            features[first:last, ..., -1:] = _size_features(np.asarray(copies.sizes[number]))
    return replace(
        candidates,
        features=append_guide(candidates.features, features.reshape(-1, added)),
    )


def _fabric_features(fabric: np.ndarray) -> np.ndarray:
    """Convert fabrics (..., 6) to features, entries off the diagonal counted twice."""
    weights = np.array([_TURN if i == j else _TURN * np.sqrt(2) for i, j in PAIRS])
    return np.rint(fabric * weights).astype(np.int16)


def _size_features(sizes: np.ndarray) -> np.ndarray:
    """Convert sizes (...) to features (..., 1)."""
    return np.rint(_SIZE * np.log2(sizes)).astype(np.int16)[..., None]

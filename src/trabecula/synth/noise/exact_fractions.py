"""Shares to the voxel: the highest of a field by rank, over a whole volume."""

from __future__ import annotations

import math

import numpy as np

from trabecula.core.request import Request
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.synth.noise.fields import Field, Phases
from trabecula.synth.noise.periodic_domain import domain_of, lifted


def ranked(request: Request, field: Field, phases: Phases, *, outside: int) -> np.ndarray:
    """The labels of a request, its phases' shares exact among the voxels of its mask; those outside
    are `outside`.
    """
    domain = domain_of(request)
    work = Workspace(stages_of_ranking(field, domain.shape))
    work.enter("make")
    result = work.full("labels", phases.labels[-1])
    numbers = work.empty("numbers")
    asked = np.ones(1, bool) if request.mask is None else request.mask.reshape(domain.shape)
    count = result.size if request.mask is None else int(np.count_nonzero(request.mask))
    ends = np.rint(np.cumsum(phases.fractions) * count).astype(np.int64)

    def keep(piece: tuple[slice, ...], z: int, plane: np.ndarray) -> None:
        numbers[piece][z] = np.rint(plane)

    for i, label in enumerate(phases.labels[:-1]):
        work.enter("make")
        field.each(i, domain, lifted(tuple((0, side) for side in request.shape)), keep)
        work.enter("rank")
        work.adopt("left", (result == phases.labels[-1]) & asked)
        _label_highest(work, int(ends[i] - (ends[i - 1] if i else 0)), label)
    if request.mask is not None:
        result[~asked] = outside
    return result[0] if domain.flat else result


def stages_of_ranking(field: Field, shape: tuple[int, ...]) -> tuple[Stage, ...]:
    """Return the stages of `ranked` for a domain (Z, Y, X)."""
    voxels = math.prod(shape)
    held = {"labels": Array(shape, np.uint8), "numbers": Array(shape, np.int32)}
    chosen = {
        "left": Array(shape, bool),
        "found": Array(voxels, np.uint8, at_most=True),
        "values": Array(voxels, np.int32, at_most=True),
        "sorted": Array(voxels, np.int32, at_most=True),
        "chosen": Array(voxels, bool, at_most=True),
    }
    return (
        Stage("make", held),
        *within(held, field.stages(shape)),
        # voxels of one value, as a mask and as indices: white noise has many
        Stage("rank", {**held, **chosen}, 5 * voxels),
    )


def _label_highest(work: Workspace, count: int, label: int) -> None:
    """Give a label to the `count` highest "numbers" among the voxels "left", the first of equal
    ones.
    """
    if count == 0:
        return
    labels, left = work["labels"], work["left"]
    values = work.adopt("values", work["numbers"][left])
    level = work.adopt("sorted", np.partition(values, len(values) - count))[len(values) - count]
    chosen = work.adopt("chosen", values > level)
    missing = count - int(np.count_nonzero(chosen))
    chosen[np.flatnonzero(values == level)[:missing]] = True
    found = work.adopt("found", labels[left])
    found[chosen] = label
    labels[left] = found

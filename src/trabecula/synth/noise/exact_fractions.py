"""Shares to the voxel: the highest of a field by rank, over a whole volume."""

from __future__ import annotations

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.noise.fields import Field, Phases
from trabecula.synth.noise.periodic_domain import domain_of, lifted


def ranked(request: Request, field: Field, phases: Phases, *, outside: int) -> np.ndarray:
    """The labels of a request, its phases' shares exact among the voxels of its mask; those outside
    are `outside`.
    """
    domain = domain_of(request)
    result = np.full(domain.shape, phases.labels[-1], np.uint8)
    asked = np.ones(1, bool) if request.mask is None else request.mask.reshape(domain.shape)
    count = result.size if request.mask is None else int(np.count_nonzero(request.mask))
    ends = np.rint(np.cumsum(phases.fractions) * count).astype(np.int64)
    numbers = np.empty(domain.shape, np.int32)

    def keep(piece: tuple[slice, ...], z: int, plane: np.ndarray) -> None:
        numbers[piece][z] = np.rint(plane)

    for i, label in enumerate(phases.labels[:-1]):
        field.each(i, domain, lifted(tuple((0, side) for side in request.shape)), keep)
        left = (result == phases.labels[-1]) & asked
        found = result[left]
        found[_highest(numbers[left], int(ends[i] - (ends[i - 1] if i else 0)))] = label
        result[left] = found
    if request.mask is not None:
        result[~asked] = outside
    return result[0] if domain.flat else result


def _highest(values: np.ndarray, count: int) -> np.ndarray:
    """True at the `count` highest of a flat array, the first of equal ones."""
    if count == 0:
        return np.zeros(len(values), bool)
    level = np.partition(values, len(values) - count)[len(values) - count]
    chosen = values > level
    missing = count - int(np.count_nonzero(chosen))
    chosen[np.flatnonzero(values == level)[:missing]] = True
    return chosen

"""What a target asks for: the share of a phase at every voxel, on every level.

On a coarser level a phase has another share (thin struts vanish first): what is asked for is
carried over along straight lines through (0, 0), (the exemplar's share, its share on that level)
and (1, 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.matching.sources import Stack
from trabecula.synth.shared.pyramid import halve

BEYOND = 0.5
"""How far outside the exemplar's own porosities the shift reaches with struts that still look like
it: of the way to 0 and to 1."""


def check_phases(present: tuple[int, ...], empty: int) -> None:
    """Raise where a target porosity does not say how much of each phase there is to be."""
    if len(present) != 2 or empty not in present:
        raise RequestError(
            f"a target porosity is honoured for a void and one other phase, the exemplar holds {len(present)} phases: "
            "merge them (tb.segment with one threshold), or leave the target out"
        )


def requested_fractions(request: Request, present: tuple[int, ...], empty: int) -> np.ndarray:
    """(Z, Y, X) float32: the share that the upper of two phases is to have at every voxel."""
    shares = memmap.empty(request.shape, np.float32)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            porosity = np.asarray(_asked(request, slice(z, z + 1)), np.float32)
            shares[z] = porosity if present[1] == empty else 1 - porosity

    for_slabs(work, len(shares))
    return shares


def _asked(request: Request, planes: slice) -> float | np.ndarray:
    """The porosity that is asked for on planes, or everywhere."""
    target = {
        name: value[planes] if isinstance(value, np.ndarray) else value
        for name, value in request.target.items()
    }
    asked = porosity_of(target)
    return 0.0 if asked is None else asked


def fractions_by_level(shares: np.ndarray, stacks: Sequence[Stack]) -> list[np.ndarray]:
    """What shares at every voxel are at the resolution of each stack, finest first."""
    own = phase_fraction(stacks[0])
    found: list[np.ndarray] = []
    for stack in stacks:
        shares = halve(shares[None])[0] if found else shares
        found.append(carry_over(shares, own, phase_fraction(stack)))
    return found


def carry_over(shares: np.ndarray, own: float, there: float) -> np.ndarray:
    """What shares become on a level where the exemplar's own share is `there`."""
    carried = memmap.empty(shares.shape, np.float32)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            carried[z] = np.interp(shares[z], (0.0, own, 1.0), (0.0, there, 1.0))

    for_slabs(work, len(shares))
    return carried


def phase_fraction(stack: Stack) -> float:
    """The share of the phase in the exemplars' volumes."""
    inside = sum(
        np.count_nonzero(stack.field[0, start : start + z, :y, :x] > 0)
        for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True)
    )
    return float(inside / np.prod(stack.sides.astype(np.int64), axis=1).sum())


def average_target(request: Request) -> Request:
    """The request with one number as its target: the mean of what is asked for."""
    if not any(map(np.ndim, request.target.values())):
        return replace(request, target={"porosity": float(_asked(request, slice(None)))})
    planes = np.zeros((request.shape[0], 2))

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            asked = np.asarray(_asked(request, slice(z, z + 1)))[0]
            inside = asked if request.mask is None else asked[request.mask[z]]
            planes[z] = inside.sum(dtype=np.float64), inside.size

    for_slabs(work, len(planes))
    return replace(request, target={"porosity": math.fsum(planes[:, 0]) / math.fsum(planes[:, 1])})

"""The source of copies: the exemplars at one resolution, stacked along z to one volume, and its
neighbourhoods as features.

A picture is a volume of one plane, and its neighbourhoods are flat.

Several exemplars, and rotated or mirrored copies of them, are one flat list of candidates with
gaps: a neighbourhood that would reach over the seam between two volumes is not allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.halving_tree import HalvingTree, build_tree
from trabecula.synth.shared.matching.neighbour_index import NeighbourIndex as Nearest
from trabecula.synth.shared.matching.neighbour_index import build_index
from trabecula.synth.shared.matching.neighbourhoods import Basis, Triple, box_of, project, steps_of
from trabecula.synth.shared.matching.principal_components import (
    grain_of,
    principal_basis,
    variance_in,
)

_MANY = 1_200_000  # neighbourhoods above which only every `step`-th is a candidate


@dataclass(frozen=True)
class Stack:
    """Volumes at one resolution, one above the other, filled up with zeros.

    `field` is (C, z, y, x) int8; `starts` (n,) the first plane of each volume; `sides` (n, 3) its
    extent; `histograms` one per channel, of the volumes themselves.
    """

    field: np.ndarray
    starts: np.ndarray
    sides: np.ndarray
    histograms: tuple[Histogram, ...]

    @classmethod
    def of(cls, fields: Sequence[np.ndarray]) -> Stack:
        """Stack fields (C, z, y, x) int8 of one number of channels."""
        sides = np.array([field.shape[1:] for field in fields])
        starts = np.concatenate([[0], np.cumsum(sides[:, 0])])
        whole = np.zeros((len(fields[0]), starts[-1], *sides[:, 1:].max(0)), np.int8)
        for field, start, (z, y, x) in zip(fields, starts, sides, strict=False):
            whole[:, start : start + z, :y, :x] = field
        channels = zip(*fields, strict=True)
        histograms = tuple(
            Histogram.of(np.concatenate([part.ravel() for part in channel])) for channel in channels
        )
        return cls(whole, starts[:-1], sides, histograms)

    def corners_within(self, box: Triple) -> np.ndarray:
        """Mark the voxels whose neighbourhood, with its first corner there, lies within one volume,
        (gz, gy, gx) bool.
        """
        within = np.zeros(
            [side - w + 1 for side, w in zip(self.field.shape[1:], box, strict=True)], bool
        )
        for start, sides in zip(self.starts, self.sides, strict=True):
            z, y, x = (int(side) - w + 1 for side, w in zip(sides, box, strict=True))
            within[start : start + z, :y, :x] = True
        return within


class CandidateCells(NamedTuple):
    """Extent and strides of the grid of candidates, and the steps of the output's sites."""

    shape: tuple[int, ...]
    strides: Triple
    steps: Triple


@dataclass(frozen=True)
class Candidates:
    """The neighbourhoods of one width: `features` (N, D) int16 of the cells of a grid of `shape`,
    `stride` voxels apart.

    `step` is how far apart the output's neighbourhoods are to be.
    """

    stack: Stack
    basis: Basis
    features: np.ndarray
    shape: tuple[int, ...]
    stride: int
    step: int
    allowed: np.ndarray  # (N,) bool
    k: int = 10  # nearest ones that the exact search looks at

    @property
    def steps(self) -> Triple:
        """Return the distance between the output's neighbourhoods along each axis."""
        return steps_of(self.step, flat=self.basis.flat)

    @property
    def strides(self) -> Triple:
        """Return the distance between cells along each axis."""
        return steps_of(self.stride, flat=self.basis.flat)

    @property
    def cells(self) -> CandidateCells:
        """Return the geometry of the cells and of the sites, for kernels."""
        return CandidateCells(self.shape, self.strides, self.steps)

    @classmethod
    def of(
        cls,
        stack: Stack,
        *,
        width: int,
        step: int,
        variance: float,
        most: int,
        smooth: bool = False,
        k: int = 10,
        flat: bool = False,
    ) -> Candidates:
        """Describe all neighbourhoods, or every `step`-th along each axis where there are more than
        1.2 million.
        """
        grain = grain_of(width, smooth=smooth)
        within = stack.corners_within(box_of(width, flat=flat))
        basis = principal_basis(
            stack.field,
            within,
            width=width,
            variance=variance_in(grain, variance),
            most=most,
            grain=grain,
            flat=flat,
        )
        stride = step if np.count_nonzero(within) > _MANY else 1
        every_z, every_y, every_x = steps_of(stride, flat=flat)
        allowed = within[::every_z, ::every_y, ::every_x]
        features = project(
            stack.field, basis, step=stride, active=None if allowed.all() else allowed
        )
        features = features.reshape(-1, features.shape[-1])
        return cls(
            stack,
            basis,
            features,
            allowed.shape,
            stride,
            step,
            np.ascontiguousarray(allowed).ravel(),
            k,
        )

    @cached_property
    def numbers(self) -> np.ndarray:
        """List the allowed candidates, as numbers in the grid."""
        return np.flatnonzero(self.allowed)

    @cached_property
    def index(self) -> Nearest:
        """Build the index of the exact search."""
        return build_index(
            self.features, k=self.k, allowed=None if self.allowed.all() else self.allowed
        )

    @cached_property
    def tree(self) -> HalvingTree:
        """Build the tree of the search by leaves."""
        return build_tree(self.features, self.numbers)

    def bounds(self) -> np.ndarray:
        """Return (n, 3, 4) int64: for each volume and axis its start in the stack, the last corner
        of a neighbourhood within it, and the first and last cell of the grid that are allowed.
        """
        most = self.stack.sides - self.basis.box
        start = np.zeros_like(most)
        start[:, 0] = self.stack.starts
        # The stride need not divide a volume's start: its first and last cells are rounded inwards.
        cells = [-(-start // self.strides), (start + most) // self.strides]
        return np.stack([start, most, *cells], axis=-1).astype(np.int64)


def carry_matches(
    match: np.ndarray, old: Candidates, new: Candidates, grid: tuple[int, ...], *, factor: int
) -> np.ndarray:
    """Carry matches over to another grid: every new neighbourhood takes the match of the old one at
    its place.

    `factor` is 2 where the new resolution is twice as fine, 1 where only the width changes.
    """
    moved, bounds = memmap.empty(grid, np.int32), new.bounds()

    def work(start: int, stop: int) -> None:
        _carry(match, old.cells, old.stack.starts, moved, new.cells, bounds, factor, start, stop)

    for_slabs(work, grid[0])
    return moved


@kernel
def _carry(match, cells, starts, moved, new_cells, bounds, factor, start, stop):
    """Carry matches over to planes start..stop of another grid.

    match, moved (Z, Y, X) int32 on sites `steps` and `new_steps` apart, indices into E of `shape`
    and `new_shape` with cells `strides` and `new_strides` apart; starts (n,) the first planes of
    the volumes that E is stacked of; bounds (n, 3, 4) int64 of each volume of the new E its start
    (0 but along z), the last corner within it, and the first and last cell.
    """
    shape, strides, steps = cells
    new_shape, new_strides, new_steps = new_cells
    site, corner = np.empty(3, np.int64), np.empty(3, np.int64)
    for z in range(start, stop):
        for y in range(moved.shape[1]):
            for x in range(moved.shape[2]):
                corner[0], corner[1], corner[2] = (
                    z * new_steps[0],
                    y * new_steps[1],
                    x * new_steps[2],
                )
                for axis in range(3):
                    site[axis] = min(corner[axis] // (factor * steps[axis]), match.shape[axis] - 1)
                m = match[site[0], site[1], site[2]]
                cz = m // (shape[1] * shape[2]) * strides[0]
                volume = 0
                while volume + 1 < len(starts) and starts[volume + 1] <= cz:
                    volume += 1
                old = (
                    cz - starts[volume],
                    m // shape[2] % shape[1] * strides[1],
                    m % shape[2] * strides[2],
                )
                index = np.int64(0)
                for axis in range(3):
                    bound = bounds[volume, axis]
                    place = factor * (old[axis] - site[axis] * steps[axis]) + corner[axis]
                    cell = (min(max(place, 0), bound[1]) + bound[0]) // new_strides[axis]
                    index = index * new_shape[axis] + min(max(cell, bound[2]), bound[3])
                moved[z, y, x] = index

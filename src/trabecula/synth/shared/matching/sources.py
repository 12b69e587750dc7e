"""What is copied from: the exemplars at one resolution, stacked along z to one volume, and its neighbourhoods as features.

A picture is a volume of one plane, and its neighbourhoods are flat.

Several exemplars, and rotated or mirrored copies of them, are one flat list of candidates with gaps: a neighbourhood that
would reach over the seam between two volumes is not allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.nearest import Candidates as Nearest
from trabecula.synth.shared.nearest import candidates
from trabecula.synth.shared.neighbourhoods import Basis, Triple, box_of, principal_basis, project, steps_of

_MANY = 1_200_000  # neighbourhoods above which only every `step`-th is a candidate


@dataclass(frozen=True)
class Stack:
    """Volumes at one resolution, one above the other; beyond their own sides lies zero.

    `field` is (C, z, y, x) int8; `starts` (n,) the first plane of each volume; `sides` (n, 3) its extent; `histograms` one
    per channel, of the volumes themselves.
    """

    field: np.ndarray
    starts: np.ndarray
    sides: np.ndarray
    histograms: tuple[Histogram, ...]

    @classmethod
    def of(cls, fields: Sequence[np.ndarray]) -> Stack:
        """From fields (C, z, y, x) int8 of one number of channels."""
        sides = np.array([field.shape[1:] for field in fields])
        starts = np.concatenate([[0], np.cumsum(sides[:, 0])])
        whole = np.zeros((len(fields[0]), starts[-1], *sides[:, 1:].max(0)), np.int8)
        for field, start, (z, y, x) in zip(fields, starts, sides, strict=False):
            whole[:, start : start + z, :y, :x] = field
        channels = zip(*fields, strict=True)
        histograms = tuple(Histogram.of(np.concatenate([part.ravel() for part in channel])) for channel in channels)
        return cls(whole, starts[:-1], sides, histograms)

    def allowed(self, box: Triple) -> np.ndarray:
        """Whether the neighbourhood with its first corner at a voxel lies within one volume, (gz, gy, gx) bool."""
        within = np.zeros([side - w + 1 for side, w in zip(self.field.shape[1:], box, strict=True)], bool)
        for start, sides in zip(self.starts, self.sides, strict=True):
            z, y, x = (int(side) - w + 1 for side, w in zip(sides, box, strict=True))
            within[start : start + z, :y, :x] = True
        return within


@dataclass(frozen=True)
class Candidates:
    """The neighbourhoods of one width: `features` (N, D) int16 of the cells of a grid of `shape`, `stride` voxels apart.

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
        """How far apart the output's neighbourhoods are along each axis."""
        return steps_of(self.step, flat=self.basis.flat)

    @property
    def strides(self) -> Triple:
        """How far apart the cells are along each axis."""
        return steps_of(self.stride, flat=self.basis.flat)

    @classmethod
    def of(
        cls,
        stack: Stack,
        *,
        width: int,
        step: int,
        variance: float,
        most: int,
        grain: int = 1,
        k: int = 10,
        flat: bool = False,
    ) -> Candidates:
        """All neighbourhoods, or every `step`-th along each axis where there are more than 1.2 million."""
        within = stack.allowed(box_of(width, flat=flat))
        basis = principal_basis(stack.field, within, width=width, variance=variance, most=most, grain=grain, flat=flat)
        stride = step if np.count_nonzero(within) > _MANY else 1
        every_z, every_y, every_x = steps_of(stride, flat=flat)
        allowed = within[::every_z, ::every_y, ::every_x]
        features = project(stack.field, basis, step=stride, active=None if allowed.all() else allowed)
        features = features.reshape(-1, features.shape[-1])
        return cls(stack, basis, features, allowed.shape, stride, step, np.ascontiguousarray(allowed).ravel(), k)

    @cached_property
    def numbers(self) -> np.ndarray:
        """The allowed candidates, as numbers in the grid."""
        return np.flatnonzero(self.allowed)

    @cached_property
    def prepared(self) -> Nearest:
        """The candidates as the exact search wants them."""
        return candidates(self.features, k=self.k, allowed=None if self.allowed.all() else self.allowed)

    def corners(self, match: np.ndarray) -> list[np.ndarray]:
        """The first voxel of each candidate, along z, y, x of the stack."""
        return [cell * stride for cell, stride in zip(np.unravel_index(match, self.shape), self.strides, strict=True)]

    def at(self, corners: Sequence[np.ndarray], volume: np.ndarray) -> np.ndarray:
        """The allowed candidates of a volume that begin nearest to these voxels (z counted within the volume)."""
        cells = []
        for axis, (corner, width, stride) in enumerate(zip(corners, self.basis.box, self.strides, strict=True)):
            most = self.stack.sides[volume, axis] - width
            start = self.stack.starts[volume] if axis == 0 else 0
            # The stride need not divide a volume's start: its first and last cells are rounded inwards.
            first, last = -(-start // stride), (start + most) // stride
            cells.append(np.clip((np.clip(corner, 0, most) + start) // stride, first, last))
        return np.ravel_multi_index(cells, self.shape).astype(np.int32)

    def volumes(self, z: np.ndarray) -> np.ndarray:
        """Which volume a plane of the stack belongs to."""
        return np.searchsorted(self.stack.starts, z, side="right") - 1


def carried(match: np.ndarray, old: Candidates, new: Candidates, grid: tuple[int, ...], *, factor: int) -> np.ndarray:
    """Matches on another grid: every new neighbourhood takes what the old one at its place was matched with.

    `factor` is 2 where the new resolution is twice as fine, 1 where only the width changes.
    """
    sites, offsets = [], []
    for count, have, coarse, fine in zip(grid, match.shape, old.steps, new.steps, strict=True):
        corner = np.arange(count) * fine
        site = np.minimum(corner // (factor * coarse), have - 1)
        sites.append(site)
        offsets.append(corner - factor * site * coarse)
    z, y, x = old.corners(match[np.ix_(*sites)])
    volume = old.volumes(z)
    local = (z - old.stack.starts[volume], y, x)
    moved = [factor * corner + offset for corner, offset in zip(local, np.ix_(*offsets), strict=True)]
    return new.at(moved, volume)

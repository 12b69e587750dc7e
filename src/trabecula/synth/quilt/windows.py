"""Windows of the output: copied out with a margin, worked on, and their boxes written back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.quilt.voxel_codes import EMPTY, OUT

_MARGIN = 4
"""Voxels around a box in which ways around it are seen."""


@dataclass(frozen=True)
class Frame:
    """Where boxes lie in an output of `shape`: `patch` voxels a side, every `step`, the first at
    `start` (0 or before).
    """

    shape: tuple[int, ...]
    wraps: tuple[bool, ...]
    patch: tuple[int, ...]
    step: tuple[int, ...]
    start: tuple[int, ...]

    @cached_property
    def margin(self) -> tuple[int, ...]:
        """Voxels around a box in its window: none along an axis of one voxel, and no voxel twice."""
        return tuple(
            0 if side == 1 else min(_MARGIN, (side - patch) // 2) if wrap else _MARGIN
            for side, patch, wrap in zip(self.shape, self.patch, self.wraps, strict=True)
        )

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Boxes along every axis, so that all voxels are covered."""
        counts = []
        for side, wrap, patch, step, start in zip(
            self.shape, self.wraps, self.patch, self.step, self.start, strict=True
        ):
            reach = side - start if wrap else side - start - (patch - step)
            counts.append(max(1, -(-reach // step)))
        return tuple(counts)

    def corner(self, number: int) -> tuple[int, ...]:
        """First voxel of a box; boxes are numbered in raster order."""
        at = np.unravel_index(number, self.counts)
        return tuple(
            int(a) * step + start for a, step, start in zip(at, self.step, self.start, strict=True)
        )

    def indices(self, corner: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Coordinates of a box's voxels along every axis, those outside left out."""
        axes = []
        for first, size, side, wrap in zip(corner, self.patch, self.shape, self.wraps, strict=True):
            at = np.arange(first, first + size)
            axes.append(at % side if wrap else at[(at >= 0) & (at < side)])
        return tuple(axes)

    def cut_out(
        self, canvas: np.ndarray, corner: tuple[int, ...], window: np.ndarray, beyond: int
    ) -> None:
        """Copy a box with its margin into `window`; `beyond` is what lies outside the volume."""
        first = tuple(at - margin for at, margin in zip(corner, self.margin, strict=True))
        _cut_out(canvas, first, self.wraps, window, beyond)

    def put_back(self, canvas: np.ndarray, corner: tuple[int, ...], window: np.ndarray) -> None:
        """Write the box of a window."""
        _put_back(canvas, corner, self.wraps, self.margin, window)


def anchored(
    shape: tuple[int, ...], to_make: Sequence[np.ndarray], step: tuple[int, ...], lead: int
) -> tuple[int, ...]:
    """Starts (0 or before) of boxes that begin `lead` voxels before the first layer with voxels
    `to_make`, along every axis.
    """
    starts = []
    for side, by, made in zip(shape, step, to_make, strict=True):
        used = int(np.argmax(made))
        first = 0 if side == 1 or used == 0 else used - lead
        starts.append(-(-first % by))
    return tuple(starts)


def box_of(window: np.ndarray, margin: tuple[int, ...]) -> np.ndarray:
    """The box in a window, as a view."""
    return window[tuple(slice(m, side - m) for m, side in zip(margin, window.shape, strict=True))]


def near_empty(box: np.ndarray, reach: int) -> np.ndarray:
    """Which made voxels of a box have a voxel to make within `reach` along every axis."""
    found = box == EMPTY
    for axis, side in enumerate(box.shape):
        rows, grown = np.moveaxis(found, axis, 0), np.moveaxis(found.copy(), axis, 0)
        for by in range(1, min(reach, side - 1) + 1):
            grown[by:] |= rows[:-by]
            grown[:-by] |= rows[by:]
        found = np.moveaxis(grown, 0, axis)
    return np.ascontiguousarray(found & (box < OUT))


@kernel
def _cut_out(canvas, first, wraps, window, beyond):
    """Coordinates beyond a side wrap around where the axis does."""
    depth, height, width = canvas.shape
    for k in range(window.shape[0]):
        z = first[0] + k
        z = z % depth if wraps[0] else z
        for j in range(window.shape[1]):
            y = first[1] + j
            y = y % height if wraps[1] else y
            inside = 0 <= z < depth and 0 <= y < height
            for i in range(window.shape[2]):
                x = first[2] + i
                x = x % width if wraps[2] else x
                window[k, j, i] = canvas[z, y, x] if inside and 0 <= x < width else beyond


@kernel
def _put_back(canvas, corner, wraps, margin, window):
    depth, height, width = canvas.shape
    for k in range(window.shape[0] - 2 * margin[0]):
        z = corner[0] + k
        z = z % depth if wraps[0] else z
        if not 0 <= z < depth:
            continue
        for j in range(window.shape[1] - 2 * margin[1]):
            y = corner[1] + j
            y = y % height if wraps[1] else y
            if not 0 <= y < height:
                continue
            for i in range(window.shape[2] - 2 * margin[2]):
                x = corner[2] + i
                x = x % width if wraps[2] else x
                if 0 <= x < width:
                    canvas[z, y, x] = window[k + margin[0], j + margin[1], i + margin[2]]

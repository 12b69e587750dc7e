"""One material: its bubbles in reach of any box, and their arrivals in the box or in blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.synth.bubbles.flow import Flow
from trabecula.synth.bubbles.growth_law import ABSORBED, PUSH, REPULSIONS, Law, counts_of
from trabecula.synth.bubbles.kernels import BLOCK, HALF, MOST, SUPER
from trabecula.synth.bubbles.nucleation import (
    FINE,
    absorb,
    count_bubbles,
    draw_bubbles,
    draw_vectors,
    repel,
    shift_nodes,
)
from trabecula.synth.bubbles.sweep import grow

CUBE = BLOCK * SUPER
MARGIN = REPULSIONS + 1  # cells around those in reach that move or absorb bubbles in reach
_PLANES = 32  # planes of a room read at once
_NO_LEVELS = np.empty((0, 0, 0), np.float32)


def flow_step(law: Law) -> int:
    """Return the voxels between the points at which bubbles sample the flow."""
    return BLOCK * max(1, int(law.apart / (8 * BLOCK)))


@dataclass(frozen=True)
class Growth:
    """A material whose boxes can be grown alone. A picture is a box of one plane, at z = 0.

    Attributes
    ----------
    law : Law
    seed : int
    periods : three int
        Voxels after which an axis repeats; 0: never. Boxes then lie within the first turn.
    shape : three int
        Of the request: where the room of the flow is known.
    flow : Flow, optional
    """

    law: Law
    seed: int
    periods: tuple[int, ...]
    shape: tuple[int, ...]
    flow: Flow | None

    def fill(
        self, labels: np.ndarray, corner: Sequence[int], phases: tuple[int, int], level: Any
    ) -> None:
        """Label a box from voxel `corner` on: void up to T^2 = `level`, solid beyond.

        The level is a number or a field.
        """
        levels = level if isinstance(level, np.ndarray) else _NO_LEVELS
        latest = np.float32(level.max() if isinstance(level, np.ndarray) else level)
        box = tuple((first, first + side) for first, side in zip(corner, labels.shape, strict=True))
        first, sides = self._cubes(box)
        no_values, no_blocks = np.empty((0, 0), np.float32), np.empty((0, 3), np.int64)
        region = (np.array(corner, np.int64), first, sides)
        given = (labels, no_values, *region, no_blocks, np.empty((0, 0), np.uint8))
        shades = np.array(phases, labels.dtype)
        rest = (self._flat, self.world(box), latest, levels, np.uint64(self.law.merging), shades)
        blocks = int(np.prod(sides)) * SUPER**self.law.ndim
        for_slabs(lambda a, b: grow(*given, a, b, *rest), blocks, least=256)
        for start in range(0, len(labels), _PLANES):
            part = labels[start : start + _PLANES]
            room = self.room(((box[0][0] + start, box[0][0] + start + len(part)), *box[1:]))
            if room is not None:
                part[~room] = phases[1]

    def sample(self, box: Box, blocks: np.ndarray, picks: np.ndarray) -> np.ndarray:
        """Return T^2 (N, P) float32 at some voxels of blocks (N, 3) in a box.

        `picks` (1 or N, P) are the numbers of the voxels in their blocks.
        """
        values = np.empty((len(blocks), picks.shape[1]), np.float32)
        no_labels = np.empty((0, 0, 0), np.uint8)
        none, no_phases = np.zeros(3, np.int64), np.zeros(2, np.uint8)
        given = (no_labels, values, none, none, none, blocks, picks)
        latest, merging = np.float32(self.law.latest**2), np.uint64(self.law.merging)
        rest = (self._flat, self.world(box), latest, _NO_LEVELS, merging, no_phases)
        for_slabs(lambda a, b: grow(*given, a, b, *rest), len(blocks), least=256)
        return values

    def world(self, box: Box) -> tuple[Any, ...]:
        """Return the arrays that kernels read to grow a box (see `sweep`)."""
        shifts, flow, node = self._nodes(box)
        bubbles, lattice = self._bubbles(box)
        starts, places, brakes, names = self._keep_in_room(*bubbles)
        flows = self._start_flows(box, places) if len(flow) else np.empty((0, 3))
        nodes = (shifts, flow, np.concatenate([node, node]))
        return nodes, (starts, places / FINE, brakes, flows, names), lattice, self.law.numbers()

    @property
    def _flat(self) -> bool:
        return self.law.ndim == 2

    def _cubes(self, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """Return the first of the cubes that cover a box, and their number along every axis."""
        first = np.array([start // CUBE for start, _ in box], np.int64)
        last = np.array([-(-stop // CUBE) for _, stop in box], np.int64)
        return first, last - first

    def _edges(self, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the number of cells in a period, and the edges of cells, of about `length` voxels.

        The number is 0 along an axis that does not repeat.
        """
        around = np.array(
            [max(1, round(period / length)) if period else 0 for period in self.periods], np.int64
        )
        turns = zip(self.periods, around, strict=True)
        return around, np.array([period / count if period else length for period, count in turns])

    def _bubbles(self, box: Box) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Return the bubbles in reach of a box, by cell, and the lattice of the cells."""
        law = self.law
        around, edges = self._edges(law.apart)
        near = np.ceil(law.apart / edges).astype(np.int64)
        first, sides = self._cubes(box)
        low = np.floor((first * CUBE - law.reach) / edges).astype(np.int64) - MARGIN * near
        high = (
            np.floor(((first + sides) * CUBE + law.reach) / edges).astype(np.int64) + MARGIN * near
        )
        mean = float(np.prod(edges[3 - law.ndim :] / law.apart))
        laps = np.array(self.periods, np.int64) * FINE
        if self._flat:
            low[0], high[0], around[0], edges[0] = 0, 0, 0, 0.0
        cells, stage = high - low + 1, key(self.seed, "bubbles")
        starts = np.empty(int(np.prod(cells)) + 1, np.int64)
        count_bubbles(starts, stage, low, cells, around, counts_of(mean, law.regularity))
        many = int(starts[-1])
        places = np.empty((many, 3), np.int64)
        sizes = np.empty(many, np.int64)
        names = np.empty(many, np.uint32)
        draw_bubbles(places, sizes, names, starts, stage, low, cells, around, edges * FINE, laps)
        places, brakes = self._relax(places, starts, cells, near), law.brakes[sizes]
        alive = np.empty(many, bool)
        fine = FINE * np.array([ABSORBED * law.apart, law.wall])
        absorb(alive, places, brakes, starts, cells, near, *fine)
        left = np.concatenate([np.zeros(1, np.int64), np.cumsum(alive)])
        edges[0] = edges[0] or 1.0
        return (left[starts], places[alive], brakes[alive], names[alive]), (low, cells, edges)

    def _relax(
        self, places: np.ndarray, starts: np.ndarray, cells: np.ndarray, near: np.ndarray
    ) -> np.ndarray:
        """Return the places of the bubbles after repulsion."""
        apart = FINE * self.law.apart
        for _ in range(REPULSIONS if self.law.regularity else 0):
            moved = np.empty_like(places)
            repel(moved, places, starts, cells, near, apart, PUSH * apart * self.law.regularity)
            places = moved
        return places

    def _keep_in_room(
        self, starts: np.ndarray, places: np.ndarray, brakes: np.ndarray, names: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Return the bubbles that start in the room."""
        if self.flow is None:
            return starts, places, brakes, names
        if self.room(((0, 1),) * 3) is None:
            return starts, places, brakes, names
        voxels = places // FINE
        inside = ((voxels >= 0) & (voxels < np.array(self.shape))).all(1)
        kept = np.zeros(len(places), bool)
        kept[inside] = self._has_room(voxels[inside])
        counts = np.concatenate([[0], np.cumsum(kept)])
        return counts[starts], places[kept], brakes[kept], names[kept]

    def _has_room(self, voxels: np.ndarray) -> np.ndarray:
        """Return whether voxels (N, 3) of the request lie in the room."""
        free = np.ones(len(voxels), bool)
        if not len(voxels):
            return free
        low, high = voxels.min(0), voxels.max(0) + 1
        for start in range(int(low[0]), int(high[0]), _PLANES):
            box = (
                (start, min(start + _PLANES, int(high[0]))),
                *zip(low[1:].tolist(), high[1:].tolist(), strict=True),
            )
            here = (voxels[:, 0] >= start) & (voxels[:, 0] < start + _PLANES)
            room = self.room(box)
            if room is not None:
                free[here] = room[tuple((voxels[here] - [start, *low[1:]]).T)]
        return free

    def room(self, box: Box) -> np.ndarray | None:
        """Return the room of bubbles in a box, (Z, Y, X) bool; None without a crust."""
        if self.flow is None:
            return None
        room = self.flow.room(box[1:] if self._flat else box)
        return room[None] if room is not None and self._flat else room

    def _nodes(self, box: Box) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the shifts of the nodes of a box, the flow there, and the first node."""
        first, sides = self._cubes(box)
        node, count = SUPER * first, SUPER * sides + 1
        if self._flat:
            node[0], count[0] = 0, 1
        shifts = self._shifts(node, count) if self.law.shift else np.empty((0, 0, 0, 3), np.float32)
        flow = np.empty((0, 0, 0, 3), np.int8)
        if self.flow is not None and self.law.along < 1:
            flow = self._directions(self.flow, node, count, BLOCK)
        return shifts, flow, node

    def _start_flows(self, box: Box, places: np.ndarray) -> np.ndarray:
        """Return half of the flow where bubbles start, (N, 3).

        It is that of the nearest point of a lattice that is fine beside L.
        """
        assert self.flow is not None
        step = flow_step(self.law)
        first, sides = self._cubes(box)
        low = np.floor((first * CUBE - self.law.reach) / step).astype(np.int64)
        high = np.ceil(((first + sides) * CUBE + self.law.reach) / step).astype(np.int64)
        if self._flat:
            low[0], high[0] = 0, 0
        flow = self._directions(self.flow, low, high - low + 1, step)
        nearest = (places + FINE * step // 2) // (FINE * step) - low
        # Bubbles out of reach do not matter.
        nearest = np.clip(nearest, 0, high - low)
        return np.asarray(flow[tuple(nearest.T)] * HALF)

    def _directions(self, flow: Flow, low: np.ndarray, count: np.ndarray, step: int) -> np.ndarray:
        """Return the flow at `count` points of the lattice of `step` voxels, from `low` on."""
        ends = tuple(
            (step * int(a), step * int(a + n - 1) + 1) for a, n in zip(low, count, strict=True)
        )
        if not self._flat:
            return np.ascontiguousarray(flow.directions(ends, step=step))
        found = flow.directions(ends[1:], step=step)
        return np.ascontiguousarray(np.pad(found, [(0, 0), (0, 0), (1, 0)])[None])

    def _shifts(self, node: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Return the shifts of `count` nodes from `node` on."""
        around, edges = self._edges(self.law.grain)
        low = np.floor(BLOCK * node / edges).astype(np.int64)
        high = np.floor(BLOCK * (node + count - 1) / edges).astype(np.int64) + 1
        vectors = np.empty((*(high - low + 1), 3), np.int16)
        draw_vectors(vectors, key(self.seed, "bubbles/shift"), low, around)
        scale = np.full(3, self.law.shift / 32767)
        if self._flat:
            scale[0] = 0.0
        shifts = np.empty((*count, 3), np.float32)
        step = np.full(3, BLOCK, np.int64)
        rest = (BLOCK * node, step, vectors, low, edges, scale)
        for_slabs(lambda a, b: shift_nodes(shifts, a, b, *rest), len(shifts), least=1)
        return shifts


_DRAWN = 124  # bytes for each bubble during the draw
_HELD = 60  # bytes for each bubble after it
_SEARCH = 48  # bytes for each bubble in every thread, beside those of a block
_FORMS = MOST * (64 + 3) * 4
_LEAST = 200_000  # bytes of tables and the recipe


def bytes_of_box(law: Law, shape: Sequence[int], *, flows: bool) -> int:
    """Return the memory of growing a box (Z, Y, X).

    It holds the bubbles in reach, the nodes, and the search of every thread.
    """
    around = 2 * (law.reach + MARGIN * law.apart)
    wide = [side for side in shape if law.ndim == 3] or list(shape[1:])
    bubbles = math.prod((side + CUBE + around) / law.apart + 1 for side in wide)
    nodes = math.prod((side + CUBE) / BLOCK + 1 for side in wide) if law.shift else 0.0
    flow = 0.0
    if flows:
        flow = 2 * math.prod((side + CUBE + 2 * law.reach) / flow_step(law) + 3 for side in wide)
        flow += math.prod((side + CUBE) / BLOCK + 1 for side in wide)
    searched = (_HELD + 80 * flows) * bubbles + thread_count() * (_SEARCH * bubbles + _FORMS)
    return int(max(_DRAWN * bubbles, searched) + 12 * nodes + 3 * flow) + _LEAST

"""One material: its bubbles in reach of any box, and their arrivals in the box or in blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.memory import Array, Stage, Workspace
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


@dataclass(frozen=True, eq=False)
class SizeField:
    """How much larger bubbles are than the smallest, by where they start.

    Attributes
    ----------
    factors : () or (Z, Y, X) float32 array
        1 and more.
    """

    factors: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return the factors at places (N, 3) in parts of a voxel; outside those of the border."""
        if not self.factors.ndim:
            return np.full(len(places), float(self.factors))
        voxels = [
            np.clip(places[:, axis] // FINE, 0, side - 1)
            for axis, side in enumerate(self.factors.shape)
        ]
        return self.factors[tuple(voxels)].astype(np.float64)

    def thin_out(self, factors: np.ndarray, names: np.ndarray, ndim: int) -> np.ndarray:
        """Return which bubbles stay, (N,) bool: one in factor^ndim, chosen by their names."""
        words = (names.astype(np.uint64) * np.uint64(_MIX) >> np.uint64(16)) & np.uint64(0xFFFFFF)
        return np.asarray(words < np.rint(factors**-ndim * (1 << 24)))


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
    sizes : SizeField, optional
    """

    law: Law
    seed: int
    periods: tuple[int, ...]
    shape: tuple[int, ...]
    flow: Flow | None
    sizes: SizeField | None = None

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
        node, count = self._node_range(box)
        low, points = self._point_range(box)
        work, lattice, around = self._count_bubbles(
            box, tuple(count), tuple(points) if self._flows else None
        )
        shifts, flow = self._nodes(work, node, count)
        self._draw_bubbles(work, lattice, around)
        flows = self._start_flows(work, low, points) if self._flows else np.empty((0, 3))
        work.enter("grow")
        places = work.adopt("exact places", work["kept places"] / FINE)
        nodes = (shifts, flow, np.concatenate([node, node]))
        bubbles = (work["kept starts"], places, work["kept brakes"], flows, work["kept names"])
        return nodes, bubbles, lattice, self.law.numbers()

    @property
    def _flat(self) -> bool:
        return self.law.ndim == 2

    @property
    def _flows(self) -> bool:
        return self.flow is not None and self.law.along < 1

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

    def _count_bubbles(
        self, box: Box, nodes: tuple[int, ...], points: tuple[int, ...] | None
    ) -> tuple[Workspace, tuple[np.ndarray, ...], np.ndarray]:
        """Count the bubbles of the cells in reach of a box; return the arrays to draw them into,
        the lattice of the cells, and the cells in a period.
        """
        law = self.law
        around, edges = self._edges(law.apart)
        near = self._near(edges)
        first, sides = self._cubes(box)
        low = np.floor((first * CUBE - law.reach) / edges).astype(np.int64) - MARGIN * near
        high = (
            np.floor(((first + sides) * CUBE + law.reach) / edges).astype(np.int64) + MARGIN * near
        )
        mean = float(np.prod(edges[3 - law.ndim :] / law.apart))
        if self._flat:
            low[0], high[0], around[0] = 0, 0, 0
        cells = high - low + 1
        starts = np.empty(int(np.prod(cells)) + 1, np.int64)
        counts = counts_of(mean, law.regularity)
        count_bubbles(starts, key(self.seed, "bubbles"), low, cells, around, counts)
        sizes = BoxSizes(
            nodes, len(starts) - 1, int(starts[-1]), points, room=self.flow is not None
        )
        work = Workspace(box_stages(law, sizes))
        work.enter("draw")
        work.adopt("starts", starts)
        if self._flat:
            edges[0] = 1.0
        return work, (low, cells, edges), around

    def _near(self, edges: np.ndarray) -> np.ndarray:
        """Return the cells to the farthest that L reaches, along every axis."""
        return np.ceil(self.law.apart / edges).astype(np.int64)

    def _draw_bubbles(
        self, work: Workspace, lattice: tuple[np.ndarray, ...], around: np.ndarray
    ) -> None:
        """Draw the bubbles in reach of a box, by cell; keep those that live on, and start in the
        room.
        """
        law, (low, cells, edges), starts = self.law, lattice, work["starts"]
        near, laps = self._near(edges), np.array(self.periods, np.int64) * FINE
        places, sizes, names = work.empty("places"), work.empty("sizes"), work.empty("names")
        stage, fine = key(self.seed, "bubbles"), edges * FINE
        if self._flat:
            fine[0] = 0.0  # bubbles of a picture lie in its plane
        draw_bubbles(places, sizes, names, starts, stage, low, cells, around, fine, laps)
        places = self._relax(work, cells, near)
        brakes = work.adopt("brakes", law.brakes[sizes])
        alive = work.empty("alive")
        chosen = None
        if self.sizes is not None:  # larger ones are fewer, and faster
            factors = self.sizes.at(places)
            chosen = self.sizes.thin_out(factors, names, law.ndim)
            brakes /= factors
        least, touch = FINE * ABSORBED * law.apart, FINE * law.wall
        absorb(alive, places, brakes, starts, cells, near, least, touch)
        if chosen is not None:
            alive &= chosen
        self._keep_in_room(places, alive)
        left = np.concatenate([np.zeros(1, np.int64), np.cumsum(alive)])
        work.adopt("kept starts", left[starts])
        work.adopt("kept places", places[alive])
        work.adopt("kept brakes", brakes[alive])
        work.adopt("kept names", names[alive])

    def _relax(self, work: Workspace, cells: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return the places of the bubbles after repulsion."""
        places, apart = work["places"], FINE * self.law.apart
        if not self.law.regularity:
            return places
        moved, push = work.empty("moved"), PUSH * apart * self.law.regularity
        for _ in range(REPULSIONS):
            repel(moved, places, work["starts"], cells, near, apart, push)
            places, moved = moved, places
        return places

    def _keep_in_room(self, places: np.ndarray, alive: np.ndarray) -> None:
        """Unmark the bubbles that do not start in the room."""
        if self.flow is None or self.room(((0, 1),) * 3) is None:
            return
        voxels = places // FINE
        inside = np.all((voxels >= 0) & (voxels < np.array(self.shape)), axis=1)
        inside[inside] = self._has_room(voxels[inside])
        alive &= inside

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

    def _node_range(self, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """Return the first of the nodes of a box, and their number along every axis."""
        first, sides = self._cubes(box)
        node, count = SUPER * first, SUPER * sides + 1
        if self._flat:
            node[0], count[0] = 0, 1
        return node, count

    def _nodes(
        self, work: Workspace, node: np.ndarray, count: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the shifts of `count` nodes from `node` on, and the flow there."""
        shifts, flow = np.empty((0, 0, 0, 3), np.float32), np.empty((0, 0, 0, 3), np.int8)
        if self.law.shift:
            shifts = work.empty("shifts")
            self._set_shifts(shifts, node, count)
        if self.flow is not None and self._flows:
            flow = work.adopt("node flow", self._directions(self.flow, node, count, BLOCK))
        return shifts, flow

    def _point_range(self, box: Box) -> tuple[np.ndarray, np.ndarray]:
        """Return the first of the points at which bubbles in reach of a box sample the flow, and
        their number along every axis.
        """
        step = flow_step(self.law)
        first, sides = self._cubes(box)
        low = np.floor((first * CUBE - self.law.reach) / step).astype(np.int64)
        high = np.ceil(((first + sides) * CUBE + self.law.reach) / step).astype(np.int64)
        if self._flat:
            low[0], high[0] = 0, 0
        return low, high - low + 1

    def _start_flows(self, work: Workspace, low: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return half of the flow where bubbles start, (N, 3).

        It is that of the nearest point of a lattice that is fine beside L.
        """
        assert self.flow is not None
        step = flow_step(self.law)
        work.enter("sample the flow")
        flow = work.adopt("points", self._directions(self.flow, low, points, step))
        nearest = (work["kept places"] + FINE * step // 2) // (FINE * step) - low
        # Bubbles out of reach do not matter.
        nearest = np.clip(nearest, 0, points - 1)
        return work.adopt("flows", flow[tuple(nearest.T)] * HALF)

    def _directions(self, flow: Flow, low: np.ndarray, count: np.ndarray, step: int) -> np.ndarray:
        """Return the flow at `count` points of the lattice of `step` voxels, from `low` on."""
        ends = tuple(
            (step * int(a), step * int(a + n - 1) + 1) for a, n in zip(low, count, strict=True)
        )
        if not self._flat:
            return np.ascontiguousarray(flow.directions(ends, step=step))
        found = flow.directions(ends[1:], step=step)
        return np.ascontiguousarray(np.pad(found, [(0, 0), (0, 0), (1, 0)])[None])

    def _set_shifts(self, shifts: np.ndarray, node: np.ndarray, count: np.ndarray) -> None:
        """Set the shifts of `count` nodes from `node` on."""
        around, edges = self._edges(self.law.grain)
        low = np.floor(BLOCK * node / edges).astype(np.int64)
        high = np.floor(BLOCK * (node + count - 1) / edges).astype(np.int64) + 1
        vectors = np.empty((*(high - low + 1), 3), np.int16)
        draw_vectors(vectors, key(self.seed, "bubbles/shift"), low, around)
        scale = np.full(3, self.law.shift / 32767)
        if self._flat:
            scale[0] = 0.0
        step = np.full(3, BLOCK, np.int64)
        rest = (BLOCK * node, step, vectors, low, edges, scale)
        for_slabs(lambda a, b: shift_nodes(shifts, a, b, *rest), len(shifts), least=1)


_MIX = 0x9E3779B97F4A7C15  # odd, so that its multiples are spread over all words
_SEARCH = 48  # bytes for each bubble in every thread, beside those of a block
_FORMS = MOST * (64 + 3) * 4


@dataclass(frozen=True)
class BoxSizes:
    """Sizes of the arrays that a box is grown from.

    Attributes
    ----------
    nodes : three int
    cells, bubbles : int
        In reach of the box.
    points : three int, or None
        At which bubbles sample the flow; None without one.
    room : bool
        Whether bubbles outside of a room are left out.
    """

    nodes: tuple[int, ...]
    cells: int
    bubbles: int
    points: tuple[int, ...] | None
    room: bool


def expected_sizes(law: Law, shape: Sequence[int], *, flows: bool, room: bool) -> BoxSizes:
    """Return the sizes that a box (Z, Y, X) may have, wherever it lies; of bubbles those that are
    expected.
    """

    def along(step: float, more: float, ends: int) -> list[float]:
        """Return how many steps cover the box and `more` voxels of its surroundings."""
        counts = [(side + CUBE + more) / step + ends for side in shape]
        return counts if law.ndim == 3 else [1, *counts[1:]]

    bubbles = int(math.prod(along(law.apart, 2 * (law.reach + MARGIN * law.apart), 1)))
    nodes = tuple(map(int, along(BLOCK, 0, 1)))
    points = tuple(map(int, along(flow_step(law), 2 * law.reach, 3)))
    return BoxSizes(nodes, bubbles, bubbles, points if flows else None, room)


def box_stages(law: Law, sizes: BoxSizes) -> tuple[Stage, ...]:
    """Declare the arrays of growing a box beside its labels."""
    many = sizes.bubbles

    def each(dtype: Any, *more: int) -> Array:
        return Array((many, *more), dtype, at_most=True)

    place = each(np.int64, 3)
    starts = Array(sizes.cells + 1, np.int64)
    held = {
        "shifts": Array((*sizes.nodes, 3), np.float32) if law.shift else None,
        "node flow": Array((*sizes.nodes, 3), np.int8) if sizes.points else None,
    }
    drawn = {
        "starts": starts,
        "places": place,
        "moved": place if law.regularity else None,
        "sizes": each(np.int64),
        "names": each(np.uint32),
        "brakes": each(np.float64),
        "alive": each(bool),
    }
    kept = {
        "kept starts": starts,
        "kept places": place,
        "kept brakes": each(np.float64),
        "kept names": each(np.uint32),
    }
    # sums of bubbles up to each; or the voxels that they start in
    stages = [Stage("draw", {**held, **drawn, **kept}, (60 if sizes.room else 16) * many)]
    flows = {}
    if sizes.points:
        flows = {"flows": each(np.float64, 3)}
        points = {"points": Array((*sizes.points, 3), np.int8), "nearest": place}
        stages.append(Stage("sample the flow", {**held, **kept, **flows, **points}, 48 * many))
    exact = {"exact places": each(np.float64, 3)}
    search = thread_count() * (_SEARCH * many + _FORMS)
    return (*stages, Stage("grow", {**held, **kept, **flows, **exact}, search))

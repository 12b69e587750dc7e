"""`lattice`: a periodic function of the cell coordinates, cut at the level of a volume fraction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.expression import Expression
from trabecula.core.request import Request
from trabecula.core.target import densities_of, frame_of, porosity_of
from trabecula.engine.blocks import Box
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method
from trabecula.synth.api.windows import WindowModel, field_in
from trabecula.synth.lattice import CAPABILITIES
from trabecula.synth.lattice.config import NAMES, STRUTS, SURFACES, LatticeConfig
from trabecula.synth.lattice.mapping import CellMap, cell_map
from trabecula.synth.shared.frames import check_room

_LEAST, _USUAL = 4, 16  # voxels of a cell's edge
# From the middles of the voxels, in voxels: a lattice whose mirror planes went through them would
# put thousands of voxels on one level, and none between.
_SHIFT = (0.11, 0.23, 0.37)
_STEPS = 2**20  # values count in whole steps, so that the rounding of sines moves no voxel
_FRACTIONS = np.linspace(0, 1, 1025)
_NODE_BYTES = 1200  # while a map is found


def surface(cell: str, u: Sequence[np.ndarray]) -> np.ndarray:
    """Return the function whose zeros are a minimal surface, at cell coordinates (z, y, x)."""
    waves = [[f(2 * np.pi * n * one) for one in u] for n in (1, 2) for f in (np.sin, np.cos)]
    return np.asarray(sum(SURFACES[cell](*waves, i, i - 2, i - 1) for i in range(3)))


@cache
def struts(cell: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """List the struts of a cell, each once: its middle and half of its vector, in cell edges."""
    nodes = np.array(STRUTS[cell])
    ends = (nodes[:, None] + np.array(list(product((-1, 0, 1), repeat=3)))).reshape(-1, 3)
    found = {}
    for hub in nodes[:1] if cell == "fcc" else nodes:
        lengths = np.linalg.norm(ends - hub, axis=1)
        for end in ends[np.isclose(lengths, lengths[lengths > 0].min())]:
            found[tuple((hub + end) / 2 % 1)] = (hub + end) / 2, (end - hub) / 2
    return list(found.values())


def distance(cell: str, u: Sequence[np.ndarray]) -> np.ndarray:
    """Return the distance to the nearest strut's axis, in cell edges."""
    least = np.full(1, np.inf)
    for middle, half in struts(cell):
        away = [(one - m + 0.5) % 1 - 0.5 for one, m in zip(u, middle, strict=True)]
        along = np.clip(sum(a * h for a, h in zip(away, half, strict=True)) / (half @ half), -1, 1)
        squares = sum((a - along * h) ** 2 for a, h in zip(away, half, strict=True))
        least = np.minimum(least, squares)
    return np.sqrt(least)


def steps(cell: str, phase: str, u: Sequence[np.ndarray]) -> np.ndarray:
    """Return the function that is cut, low in the solid, in whole steps."""
    field = surface(cell, u) if cell in SURFACES else distance(cell, u)
    return np.rint((np.abs(field) if phase == "sheet" else field) * _STEPS)


@cache
def levels(cell: str, phase: str) -> np.ndarray:
    """Return the levels that leave the `_FRACTIONS` of a cell below them."""
    u = np.ix_(*((np.arange(96) + 0.5 + shift) / 96 for shift in _SHIFT))
    # of the last one the highest value as well
    return np.quantile(steps(cell, phase, u), _FRACTIONS) + (_FRACTIONS == 1)


class LatticeModel(WindowModel):
    """Settings, for voxels of a known size."""

    capabilities = CAPABILITIES
    config: LatticeConfig

    def __init__(self, config: LatticeConfig, exemplars: Sequence[ExemplarInfo]) -> None:
        super().__init__(config, exemplars)
        edge, size = self.facts[0].spacing[0], config.cell_size
        self.sizes = np.ones(3) * (_USUAL * edge if size is None else size)
        if self.sizes.min() < _LEAST * edge:
            raise InputError(f"cell_size={size}: give 4 voxels or more, {_LEAST * edge:g}")
        to = np.array(config.direction) / np.linalg.norm(config.direction)
        # Half a turn about z, then half a turn about the middle between z and the direction.
        axis = to + np.eye(3)[0] if to[0] > -1 else np.eye(3)[1]
        half = 2 * np.outer(axis, axis) / (axis @ axis) - np.eye(3)
        self.turn = half @ np.diag([1, -1, -1])
        self._mapped: tuple[Request, CellMap] | None = None

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        if frame_of(request.target):
            self._check_frame(request)
        if any(request.periodic) and (self.turn[0, 0] < 1 or self.config.coordinates):
            raise RequestError("a lattice is periodic without direction and coordinates only")

    def _check_frame(self, request: Request) -> None:
        """Raise where cells that follow a field contradict another part of the request."""
        if any(request.periodic):
            raise RequestError("cells that follow a field do not repeat: leave periodic out")
        if self.config.coordinates or self.turn[0, 0] < 1:
            raise RequestError(
                "coordinates and direction say how cells lie, as the target orientation or size "
                "does: give one of them"
            )
        least = float(np.min(request.target.get("size", 1.0))) * self.sizes.min()
        if least < _LEAST * self.facts[0].spacing[0] * (1 - 1e-6):
            raise RequestError(
                f"the target size makes cells of {least / self.facts[0].spacing[0]:.3g} voxels: "
                f"give {_LEAST} or more, or a larger cell_size"
            )
        check_room(request.mask, least / self.facts[0].spacing[0], what="edge of a cell")

    def _map(self, request: Request) -> CellMap:
        """Return the coordinates of cells that follow the request's field; the latest are kept."""
        if self._mapped is None or self._mapped[0] is not request:
            ways, size = (request.target.get(name) for name in ("orientation", "size"))
            found = cell_map(
                None if ways is None else np.asarray(ways),
                size,
                request.shape,
                self.sizes / self.facts[0].spacing[0],
                request.mask,
            )
            self._mapped = request, found
        return self._mapped[1]

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Return the whole volume, and what the map of a field's cells distorts."""
        values, report = super().make(request)
        if not frame_of(request.target):
            return values, report
        return values, {**report, "cells": self._map(request).report}

    def coordinates(self, request: Request, box: Box) -> Sequence[np.ndarray]:
        """Return the cell coordinates (z, y, x) of a box."""
        if frame_of(request.target):
            lines = [np.arange(*ends) + 0.5 + by for ends, by in zip(box, _SHIFT, strict=True)]
            return self._map(request).at((lines[0], lines[1], lines[2]))
        edge, sizes = self.facts[0].spacing[0], self.sizes.copy()
        sides, axes = np.array(request.shape) * edge, [np.arange(*ends) for ends in box]
        for i in np.flatnonzero(request.periodic):
            sizes[i] = sides[i] / max(1, round(sides[i] / sizes[i]))
            axes[i] %= request.shape[i]
        place = np.ix_(*((n + 0.5 + by) * edge for n, by in zip(axes, _SHIFT, strict=True)))
        if self.config.coordinates:
            values = dict(zip(NAMES, (*place, *sides), strict=True))
            return [Expression(text, NAMES)(**values) for text in self.config.coordinates]
        if self.turn[0, 0] < 1:
            place = tuple(
                sum(r * p for r, p in zip(row, place, strict=True)) for row in self.turn.T
            )
        return [one / size for one, size in zip(place, sizes, strict=True)]

    def make_box(self, request: Request, box: Box) -> np.ndarray:
        """Cut the function plane by plane."""
        cell, phase = self.config.cell, self.config.phase
        asked = porosity_of(densities_of(request.target))
        wanted = self.config.porosity if asked is None else asked
        if frame_of(request.target):
            self._map(request)  # before the threads, which would each find it
        values = np.empty([stop - start for start, stop in box], np.uint8)
        field = np.broadcast_to(field_in(wanted, box), values.shape)

        def work(start: int, stop: int) -> None:
            for n, z in enumerate(range(box[0][0] + start, box[0][0] + stop), start):
                u = self.coordinates(request, ((z, z + 1), *box[1:]))
                level = np.interp(1 - field[n], _FRACTIONS, levels(cell, phase))
                values[n] = (steps(cell, phase, u) < level)[0]

        for_slabs(work, len(values))
        return values

    def box_memory(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        """Forecast the planes that are worked on, of float64."""
        framed = bool(frame_of(request.target))
        bent = bool(self.config.coordinates or self.turn[0, 0] < 1 or framed)
        planes = 6 + 13 * bent + 4 * (self.config.cell in STRUTS) + 2 * bool(request.target)
        found = {"planes": thread_count() * planes * 8 * shape[1] * shape[2]}
        if framed:
            found["map"] = _NODE_BYTES * int(np.prod([min(side, 45) for side in request.shape]))
            ways = np.asarray(request.target.get("orientation", ()))
            found["directions"] = 7 * ways.nbytes * (ways.ndim > 1)
        return found


class Lattice(Method):
    """Periodic cells."""

    capabilities = CAPABILITIES
    config_type = LatticeConfig
    model_type = LatticeModel

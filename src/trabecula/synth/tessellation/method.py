"""`tessellation`: cells of a Laguerre diagram, whose sections are like a picture of boundaries.

fit finds cells in the picture, and the settings whose sections are most like it (`sections`);
generate grows cells of these volumes on a torus around the request (`grains`), and draws closed
boundaries of the picture's fraction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import ceil, prod
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.exemplar.views import View, views_of
from trabecula.measure.plane_cells import boundary_phase
from trabecula.synth.api.model import ModelState, as_request
from trabecula.synth.shared.pictures import PictureMethod, PictureModel
from trabecula.synth.tessellation import CAPABILITIES
from trabecula.synth.tessellation.config import TessellationConfig
from trabecula.synth.tessellation.grains import POINTS, grow_grains
from trabecula.synth.tessellation.laguerre import Diagram, PointGrid
from trabecula.synth.tessellation.sections import (
    SectionFigures,
    Shape,
    draw_boundaries,
    shape_of,
)

_LEAST = 12  # pixels of a picture along every side, less the room that neighbourhoods need
_MARGIN = 1.5  # edges of a cell by which the torus is larger than an axis that does not repeat
_PROCESS = 220 << 20
_VOXEL = 16.2  # bytes: cell, distance, its copy while boundaries are drawn, values
_MASKED = 6  # bytes a voxel more with a mask
_POINT = 24  # bytes of a point of the grid on which cells grow, while neighbours are found
_SEED = 1300  # bytes of a seed with the candidates of its blocks and the cells that touch it
_PIXEL = 72  # bytes of a pixel of a picture while its cells are found
_TRIAL, _SECTION = 840 << 10, 64  # bytes of a small tessellation, and of a pixel of its sections
_WIDEST = 200  # pixels of a section


@dataclass(frozen=True)
class Learned:
    """What a picture tells of the cells."""

    boundary: int
    """Label."""
    interiors: tuple[int, ...]
    """Labels of the cells."""
    fractions: tuple[float, ...]
    """Of the interiors in the interior as a whole."""
    stretch: tuple[float, float, float]
    """Lengths of cells along z, y, x over their geometric mean, in voxels."""
    shape: Shape


class Tessellation(PictureMethod):
    """Closed cells from a picture of boundaries."""

    capabilities = CAPABILITIES
    config_type = TessellationConfig
    config: TessellationConfig
    learning_cost = 20.0

    def _width(self) -> int:
        return _LEAST

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> TessellationModel:
        return TessellationModel(self.config, exemplars, views, _learned(self.config, views))

    def from_state(self, exemplars: Sequence[Image], state: ModelState) -> TessellationModel:
        """Build the model of what was learned, as `TessellationModel.state` gives it."""
        views = views_of(exemplars, self.config.views)
        plain = dict(state.plain)
        shape = Shape(**plain.pop("shape"))
        names = ("interiors", "fractions", "stretch")
        plain |= {name: tuple(plain[name]) for name in names}
        return TessellationModel(self.config, exemplars, views, Learned(**plain, shape=shape))

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the cells of the largest picture, or a trial with its sections."""
        cells = _PIXEL * max(prod(image.shape) for image in exemplars)
        width = min(_WIDEST, *(min(image.shape) for image in exemplars))
        trial = _TRIAL + _SECTION * width**2
        return {"interpreter and kernels": _PROCESS, "cells or trials": max(cells, trial)}


class TessellationModel(PictureModel):
    """Cells that are known by their sections."""

    capabilities = CAPABILITIES
    config: TessellationConfig

    def __init__(
        self,
        config: TessellationConfig,
        exemplars: Sequence[Image],
        views: Sequence[View],
        learned: Learned,
    ) -> None:
        super().__init__(config, exemplars, views)
        self.learned = learned

    def state(self) -> ModelState:
        """Return what was learned of the cells."""
        return ModelState(plain=asdict(self.learned))

    def grains(
        self, shape: Request | int | Sequence[int], *, seed: int | None = None
    ) -> np.ndarray:
        """Return the grain of every voxel of the result of the same request to `generate`.

        Returns
        -------
        grains : int32 array, (Z, Y, X)
            Numbers from 1; boundary voxels have the grain that they lie in.
        """
        request = as_request(shape, seed, {})
        self._check_request(request)
        diagram, _ = self._grow(request)
        return np.asarray(diagram.cells(self._grid(request)) + 1)

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Grow the cells and draw their boundaries."""
        found, shape = self.learned, self.learned.shape
        diagram, error = self._grow(request)
        grid = self._grid(request)
        owner = diagram.cells(grid)
        edge = shape.density ** (-1 / 3)
        touching = diagram.neighbours(_points(diagram.sides, edge))
        depth = diagram.face_distance(grid, owner, touching, shape.rounding * edge)
        walls = draw_boundaries(owner, depth, shape.walls, inside=request.mask)
        values = self._phases(request, diagram)[owner]
        values[walls] = found.boundary
        if request.mask is not None:
            values[~request.mask] = self.facts[0].empty_label
        report = {
            "cells": len(np.unique(owner)),
            "volume_error": error,
            "sections_difference": shape.difference,
        }
        return values, report

    def _grow(self, request: Request) -> tuple[Diagram, float]:
        """Return the cells of a request in voxels over the stretch, on a torus of its own."""
        shape = self.learned.shape
        return grow_grains(
            request.seed,
            self._torus(request),
            shape.density,
            spread=shape.spread,
            lloyd_steps=shape.lloyd_steps,
        )

    def _torus(self, request: Request) -> tuple[float, ...]:
        """Return the sides of the torus, in voxels over the stretch: those of periodic axes, and
        room for cells that the faces of the others cut.
        """
        room = _MARGIN * self.learned.shape.density ** (-1 / 3)
        sides = zip(request.shape, self.learned.stretch, request.periodic, strict=True)
        return tuple(side / long + (0.0 if wraps else room) for side, long, wraps in sides)

    def _grid(self, request: Request) -> PointGrid:
        sides = zip(request.shape, self.learned.stretch, strict=True)
        return PointGrid(*((np.arange(side) + 0.5) / long for side, long in sides))

    def _phases(self, request: Request, diagram: Diagram) -> np.ndarray:
        """Return the phase of every cell, (N,) uint8: in random order, each the phase that is
        farthest behind its fraction.
        """
        found = self.learned
        labels = np.array(found.interiors, np.uint8)
        if len(labels) == 1:
            return np.full(len(diagram.seeds), labels[0])
        edge = found.shape.density ** (-1 / 3)
        volumes = diagram.moments(_points(diagram.sides, edge))[:, 0]
        wanted, given = np.array(found.fractions), np.zeros(len(labels))
        chosen = np.empty(len(volumes), np.uint8)
        for cell in generator(request.seed, "tessellation/phases").permutation(len(volumes)):
            behind = wanted * (given.sum() + volumes[cell]) - given
            phase = int(np.argmax(behind))
            given[phase] += volumes[cell]
            chosen[cell] = labels[phase]
        return chosen

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the arrays of voxels, of the growth's points, and of seeds."""
        sides = self._torus(request)
        edge = self.learned.shape.density ** (-1 / 3)
        seeds = max(1.0, prod(sides) * self.learned.shape.density)
        voxel = _VOXEL + (0 if request.mask is None else _MASKED)
        drawing = int(voxel * prod(request.shape) + _SEED * seeds)
        growth = _POINT * prod(_points(sides, edge))
        output = self.output_bytes(request)
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": sum(image.values.nbytes for image in self.exemplars),
            "output": output,
            "cells and distances": max(drawing, growth) - output,
        }


def _points(sides: Sequence[float] | np.ndarray, edge: float) -> list[int]:
    return [max(1, ceil(side / edge * POINTS)) for side in sides]


def _learned(config: TessellationConfig, views: Sequence[View]) -> Learned:
    """Find the cells of pictures, and the settings whose sections are most like them."""
    pictures = {view.picture: view.image for view in views}
    first = pictures[min(pictures)]
    if config.boundary is None:
        boundary = boundary_phase(first)
    elif config.boundary in first.phases:
        boundary = first.phases.index(config.boundary)
    else:
        raise InputError(
            f"boundary={config.boundary!r} is no phase of the picture: it has "
            f"{', '.join(first.phases)}"
        )
    values = np.concatenate([image.values.ravel() for image in pictures.values()])
    counts = np.bincount(values, minlength=len(first.phases))
    interiors = [label for label in np.flatnonzero(counts) if label != boundary]
    stretch = _stretch(views, boundary)
    marks = [
        Image((image.values == boundary).astype(np.uint8), "labels") for image in pictures.values()
    ]
    figures = SectionFigures.mean([SectionFigures.of(mark, config.neck) for mark in marks])
    shape = shape_of(
        figures,
        min(min(mark.shape) for mark in marks),
        config.neck,
        spread=config.volume_spread,
        lloyd_steps=config.lloyd_steps,
        rounding=config.rounding,
    )
    inner = counts[interiors] / counts[interiors].sum()
    return Learned(boundary, tuple(map(int, interiors)), tuple(map(float, inner)), stretch, shape)


def _stretch(views: Sequence[View], boundary: int) -> tuple[float, float, float]:
    """Return the lengths of cells along z, y, x over their geometric mean: intercepts between
    boundaries. 1 where one picture stands for all three planes.
    """
    if len(views) == 3 and len({view.picture for view in views}) == 1:
        return 1.0, 1.0, 1.0
    lines: dict[int, list[float]] = {axis: [] for axis in range(3)}
    for view in views:
        inside = view.image.values != boundary
        for axis, along in zip(view.across, range(2), strict=True):
            crossings = np.count_nonzero(np.diff(inside, axis=along))
            lines[axis].append(np.log(inside.size / max(1, crossings)))
    means = np.array([np.mean(lines[axis]) for axis in range(3)])
    z, y, x = np.exp(means - means.mean())
    return float(z), float(y), float(x)

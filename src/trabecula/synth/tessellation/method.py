"""`tessellation`: cells of a Laguerre diagram, whose sections are like a picture of boundaries, or
like those of a scan.

fit finds cells in the picture, or in sections of the scan, and the settings whose sections are most
like it (`sections`); generate grows cells of these volumes on a torus around the request
(`grains`), and draws closed boundaries of the exemplar's fraction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import ceil, prod
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.core.target import porosity_of
from trabecula.exemplar.views import PLANES, View, as_axis, take_slices, views_of
from trabecula.measure.centre_crop import centre_box
from trabecula.measure.closed_cells import BOX as CENTRE
from trabecula.measure.closed_cells import BYTES as CENTRE_BYTES
from trabecula.measure.closed_cells import thickening, wall_phase
from trabecula.measure.plane_cells import boundary_phase
from trabecula.synth.api.model import ModelState, as_request
from trabecula.synth.shared.own_figures import BOX, OwnFigures, figure_stages, tell_off
from trabecula.synth.shared.pictures import ROOM, PictureMethod, PictureModel
from trabecula.synth.shared.slabs import tally_by_slabs
from trabecula.synth.tessellation import CAPABILITIES
from trabecula.synth.tessellation.config import TessellationConfig
from trabecula.synth.tessellation.grains import POINTS, grow_grains
from trabecula.synth.tessellation.laguerre import Diagram, PointGrid
from trabecula.synth.tessellation.sections import (
    SectionFigures,
    Shape,
    SolidWalls,
    draw_boundaries,
    draw_walls,
    shape_of,
)

_LEAST = 12  # pixels of a picture along every side, less the room that neighbourhoods need
_MARGIN = 1.5  # edges of a cell by which the torus is larger than an axis that does not repeat
_PROCESS = 220 << 20
_VOXEL = 16.2  # bytes: cell, distance, its copy while boundaries are drawn, values
_MASKED = 6  # bytes a voxel more with a mask
_SURFACE = 9  # bytes of a voxel of a box more while it is measured: in thin walls, most are surface
_GRADED = 24  # and with a target field
_POINT = 24  # bytes of a point of the grid on which cells grow, while neighbours are found
_SEED = 1300  # bytes of a seed with the candidates of its blocks and the cells that touch it
_PIXEL = 72  # bytes of a pixel of a picture while its cells are found
_TRIAL, _SECTION = 840 << 10, 64  # bytes of a small tessellation, and of a pixel of its sections
_TRIAL_BOX = 12 << 20  # bytes of a box of it in space, at most
_SCAN = 2  # bytes of a voxel of a scan while lengths along its axes are measured
_WIDEST = 256  # pixels of a section
_THIN, _THIN_BOX = 4.0, (24, 72)  # edges of cells in a box of walls of a voxel; its side, voxels


@dataclass(frozen=True)
class Learned:
    """What pictures, or a scan, tell of the cells."""

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
    """Closed cells from pictures of boundaries, or from a scan of them."""

    capabilities = CAPABILITIES
    config_type = TessellationConfig
    config: TessellationConfig
    learning_cost = 20.0

    def _width(self) -> int:
        return _LEAST

    def _check_exemplars(self, images: Sequence[Image]) -> None:
        if all(image.ndim == 2 for image in images):
            super()._check_exemplars(images)
            return
        if len(images) > 1:
            raise InputError(
                "method 'tessellation' learns from one volume, or from pictures: got "
                f"{len(images)} exemplars"
            )
        if self.config.views:
            raise InputError(
                f"views={list(self.config.views)} are planes of pictures: leave them out where a "
                "volume is learnt from"
            )
        self._check_exemplar(images[0])
        if min(images[0].shape) < _LEAST + ROOM:
            raise InputError(
                f"the exemplar is {images[0].shape}, cells need at least {_LEAST + ROOM} voxels "
                "along every side: give a larger scan"
            )

    def learn(self, exemplars: Sequence[Image]) -> PictureModel:
        if exemplars[0].ndim == 2:
            return super().learn(exemplars)
        return self._learn(exemplars, _views(exemplars, self.config))

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> TessellationModel:
        learned = _learned(self.config, exemplars, views)
        return TessellationModel(self.config, exemplars, views, learned)

    def from_state(self, exemplars: Sequence[Image], state: ModelState) -> TessellationModel:
        """Build the model of what was learned, as `TessellationModel.state` gives it."""
        views = _views(exemplars, self.config)
        plain = dict(state.plain)
        shape = Shape(**plain.pop("shape"))
        names = ("interiors", "fractions", "stretch")
        plain |= {name: tuple(plain[name]) for name in names}
        return TessellationModel(self.config, exemplars, views, Learned(**plain, shape=shape))

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the cells of the largest picture or section, or a trial with its sections."""
        cells = _PIXEL * max(prod(sorted(image.shape)[-2:]) for image in exemplars)
        width = min(_WIDEST, *(min(image.shape) for image in exemplars))
        trial = _TRIAL + _SECTION * width**2
        most = max(cells, trial)
        if exemplars[0].ndim == 3:
            box = CENTRE_BYTES * prod(min(CENTRE, side) for side in exemplars[0].shape)
            tried = _TRIAL_BOX if self.config.rounding is None else 0
            most = max(most, box, tried, _SCAN * prod(exemplars[0].shape))
        return {"interpreter and kernels": _PROCESS, "cells or trials": most}


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
        values, report = self._drawn(request)
        return values, report | self._compare(request, values)

    def _drawn(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the labels of a request, and what to report of its cells."""
        found, shape = self.learned, self.learned.shape
        diagram, error = self._grow(request)
        edge = shape.density ** (-1 / 3)
        owner, walls = draw_walls(
            diagram,
            diagram.neighbours(_points(diagram.sides, edge)),
            self._grid(request),
            shape.rounding * edge,
            self._wall_share(request),
            inside=request.mask,
        )
        values = self._phases(request, diagram)[owner]
        values[walls] = found.boundary
        if request.mask is not None:
            values[~request.mask] = self.facts[0].empty_label
        return values, {
            "cells": len(np.unique(owner)),
            "volume_error": error,
            "sections_difference": shape.difference,
        }

    def _wall_share(self, request: Request) -> float | np.ndarray:
        """Return the share of walls that is wanted, everywhere or around every place."""
        porosity = porosity_of(request.target)
        if porosity is None:
            return self.learned.shape.walls
        return porosity if self.learned.boundary == self.facts[0].empty_label else 1 - porosity

    def porosities(self) -> tuple[float, float]:
        """Return the least and greatest porosity that can be a target: with walls of a voxel, and
        with walls alone.
        """
        if self.learned.boundary == self.facts[0].empty_label:
            return self._thinnest, 1.0
        return 0.0, 1 - self._thinnest

    @cached_property
    def _thinnest(self) -> float:
        """Return the share of closed walls of a voxel, of a box of some cells."""
        edge = self.learned.shape.density ** (-1 / 3)
        request = Request((int(np.clip(_THIN * edge, *_THIN_BOX)),) * 3, seed=0)
        diagram, _ = self._grow(request)
        owner = diagram.cells(self._grid(request))
        return float(draw_boundaries(owner, np.zeros(owner.shape, np.float32), 0.0).mean())

    def _check_target(self, request: Request) -> None:
        wanted = porosity_of(request.target)
        if wanted is None:
            return
        if len(self.learned.interiors) > 1:
            raise RequestError(
                "a target is the share of walls between cells of one phase, and these are of "
                f"{len(self.learned.interiors)}: leave the target out"
            )
        inside = ... if request.mask is None or not np.ndim(wanted) else request.mask
        asked = np.asarray(wanted)[inside]
        least, most = self.porosities()
        if asked.min() < least or asked.max() > most:
            raise RequestError(
                f"a target porosity of {asked.min():.3g} .. {asked.max():.3g} would need walls "
                f"thinner than a voxel: closed ones leave {least:.3g} .. {most:.3g}; ask for one "
                "in between, or give an exemplar with smaller voxels"
            )

    def _compare(self, request: Request, values: np.ndarray) -> dict[str, Any]:
        """Tell what is off in a result of a scan, and return its figures for the report; none where
        it is to differ from the scan.
        """
        if self._figures is None or request.asks_for() - {"periodic"}:
            return {}
        return tell_off(self._figures.compare(self.exemplars[0], values))

    @cached_property
    def _figures(self) -> OwnFigures | None:
        """Return the figures of a scan; None of pictures."""
        exemplar = self.exemplars[0]
        return OwnFigures.of(exemplar, box=BOX) if exemplar.ndim == 3 else None

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
        voxel += _GRADED if any(np.ndim(one) for one in request.target.values()) else 0
        drawing = int(voxel * prod(request.shape) + _SEED * seeds)
        growth = _POINT * prod(_points(sides, edge))
        output = self.output_bytes(request)
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": sum(image.values.nbytes for image in self.exemplars),
            "output": output,
            "cells and distances": max(
                drawing, growth, self._figure_bytes(request), _TRIAL_BOX if request.target else 0
            )
            - output,
        }

    def _figure_bytes(self, request: Request) -> int:
        """Return the bytes that it takes to say what is off, beside the output."""
        exemplar = self.exemplars[0]
        if exemplar.ndim == 2 or request.asks_for() - {"periodic"}:
            return 0
        stages = figure_stages(request.shape, exemplar.shape, box=BOX)
        copy = _SURFACE * prod(min(side, BOX) for side in request.shape)
        return self.output_bytes(request) + copy + sum(stage.working for stage in stages)


def _points(sides: Sequence[float] | np.ndarray, edge: float) -> list[int]:
    return [max(1, ceil(side / edge * POINTS)) for side in sides]


def _views(exemplars: Sequence[Image], config: TessellationConfig) -> tuple[View, ...]:
    """Return the views of pictures; of a volume its middle slices."""
    if exemplars[0].ndim == 2:
        return views_of(exemplars, config.views)
    middle = [take_slices(exemplars[0], plane, 1)[0] for plane in PLANES]
    pairs = enumerate(zip(PLANES, middle, strict=True))
    return tuple(View(as_axis(plane), image, n) for n, (plane, image) in pairs)


def _learned(
    config: TessellationConfig, exemplars: Sequence[Image], views: Sequence[View]
) -> Learned:
    """Find the cells of pictures, or of sections of a volume, and the settings whose sections are
    most like them.
    """
    first, phases = exemplars[0], exemplars[0].phases
    if config.boundary not in (None, *phases):
        raise InputError(
            f"boundary={config.boundary!r} is no phase of the exemplar: it has {', '.join(phases)}"
        )
    named = None if config.boundary is None else phases.index(config.boundary)
    if first.ndim == 3:
        boundary = _walls_of(first, views) if named is None else named
        counts = _count_labels([first])
        stretch = _over_mean(_log_intercepts(first, boundary))
        pictures = [one for plane in PLANES for one in take_slices(first, plane)]
        solid = _solid_walls(first, boundary, stretch) if config.rounding is None else None
    else:
        numbered = {view.picture: view.image for view in views}
        pictures = [numbered[number] for number in sorted(numbered)]
        boundary = boundary_phase(pictures[0]) if named is None else named
        counts = _count_labels(pictures)
        stretch, solid = _stretch(views, boundary), None
    figures = SectionFigures.of_several(
        [Image((one.values == boundary).astype(np.uint8), "labels") for one in pictures],
        config.neck,
        some=first.ndim == 3,
    )
    if first.ndim == 3:
        figures = replace(figures, walls=float(counts[boundary] / counts.sum()))
    shape = shape_of(
        figures,
        min(min(one.shape) for one in pictures),
        config.neck,
        solid,
        spread=config.volume_spread,
        lloyd_steps=config.lloyd_steps,
        rounding=config.rounding,
    )
    interiors = [int(label) for label in np.flatnonzero(counts) if label != boundary]
    inner = counts[interiors] / counts[interiors].sum()
    return Learned(boundary, tuple(interiors), tuple(map(float, inner)), stretch, shape)


def _walls_of(volume: Image, views: Sequence[View]) -> int:
    """Return the label of the even walls of a volume; where there are none, what its middle slices
    say as pictures.
    """
    walls = wall_phase(volume)
    return boundary_phase(*(view.image for view in views)) if walls is None else walls


def _count_labels(images: Sequence[Image]) -> np.ndarray:
    """Return how many voxels or pixels of all images have every label, int64."""

    def count(image: Image) -> np.ndarray:
        values = image.values if image.ndim == 3 else image.values[None]
        return tally_by_slabs(
            lambda start, stop: np.bincount(
                values[start:stop].ravel(), minlength=len(image.phases)
            ),
            values.shape,
        )

    return np.asarray(np.sum([count(image) for image in images], axis=0))


def _solid_walls(
    volume: Image, boundary: int, stretch: tuple[float, float, float]
) -> SolidWalls | None:
    """Return what the centre of a volume tells of its walls; None where it holds none, or nothing
    else.
    """
    walls = centre_box(volume.values, CENTRE) == boundary
    return SolidWalls(thickening(walls), stretch) if 0 < walls.mean() < 1 else None


def _stretch(views: Sequence[View], boundary: int) -> tuple[float, float, float]:
    """Return the lengths of cells along z, y, x over their geometric mean: intercepts between
    boundaries. 1 where one picture stands for all three planes.
    """
    if len(views) == 3 and len({view.picture for view in views}) == 1:
        return 1.0, 1.0, 1.0
    lines: dict[int, list[float]] = {axis: [] for axis in range(3)}
    for view in views:
        for axis, length in zip(view.across, _log_intercepts(view.image, boundary), strict=True):
            lines[axis].append(length)
    return _over_mean([float(np.mean(lines[axis])) for axis in range(3)])


def _log_intercepts(image: Image, boundary: int) -> list[float]:
    """Return the logarithm of the mean length between changes of a line, along every axis."""
    inside = image.values != boundary
    counts = [np.count_nonzero(np.diff(inside, axis=axis)) for axis in range(image.ndim)]
    return [float(np.log(inside.size / max(1, count))) for count in counts]


def _over_mean(lengths: Sequence[float]) -> tuple[float, float, float]:
    """Return lengths, given by their logarithms, over their geometric mean."""
    z, y, x = np.exp(np.array(lengths) - np.mean(lengths))
    return float(z), float(y), float(x)

"""Sections of tessellations beside a picture: the settings whose sections are most like it.

The sizes of cells in a section say little of a single cell in space, but their distribution follows
from that of the volumes (Saltykov's problem). Instead of an unfolding, which is ill-posed, small
tessellations are made, cut, drawn with walls of the picture's thickness and measured as the picture
is; of a coarse grid of settings the nearest is taken (minimum contrast: Redenbach 2009,
doi:10.1016/j.commatsci.2008.09.018). Seeds of these trials are fixed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.closed_cells import thickening
from trabecula.measure.plane_cells import plane_cells
from trabecula.synth.tessellation.grains import grow_grains
from trabecula.synth.tessellation.laguerre import Diagram, PointGrid

SPREADS = (0.0, 0.25, 0.5, 0.75, 1.0)
STEPS = (0, 1, 3, 8)
ROUNDINGS, FINER = (0.0, 0.1, 0.2, 0.3, 0.4), 0.05

Touching = tuple[np.ndarray, np.ndarray]
"""Cells that touch every cell, as `Diagram.neighbours` returns them."""

_SHARES = np.linspace(0.1, 0.9, 9)
_CELLS = 216
_PLANES = 4  # along every axis
_WIDTH = 10.0  # of a section over the edge of a cell, at most; sections go around the torus
_PIXELS = 20.0  # of a cell's edge in a trial, at most
_BOX, _BOX_SIDES = 5.0, (32, 72)  # edges of cells in a box whose walls are looked at; its sides
_SURE, _SURER = 0.1, 0.01  # what round corners have to be nearer by, in sections and in space
_MARKS = np.linspace(0, 1, 1025)  # shares whose depth is known
_FINE = 256.0  # pixels of a section whose walls are looked at, at most
_POINTS = 5.0
_SEED = 0
_PER_SECTION = 1.2  # cells per area of a section over the 2/3 power of those per volume, at first


@dataclass(frozen=True, eq=False)
class SectionFigures:
    """Cells of a section, or the mean of several."""

    density: float
    """Cells per area: half of the points where three meet (Euler's formula), which no edge of the
    picture cuts."""
    sizes: np.ndarray
    """(9,) deciles of the square root of the area, over its root mean square."""
    aspect: float
    neighbours: float
    """Standard deviation of the number of neighbours."""
    walls: float
    """Share of the boundary."""
    thick: float
    """Mean square of the depth in the boundary over the square of its mean: 4 / 3 of even walls,
    more where corners are thick."""

    @classmethod
    def of(cls, image: Image, neck: float) -> SectionFigures:
        """Measure a picture whose boundaries are label 1."""
        cells = plane_cells(image, boundary=1, neck=neck)
        area = cells.mean_area
        return cls(
            cells.triple_points / 2,
            np.sqrt(cells.quantiles(cells.area, _SHARES) / area),
            cells.mean(cells.aspect),
            cells.spread(cells.neighbours),
            float(np.mean(image.values == 1)),
            thickening(image.values == 1),
        )

    @classmethod
    def of_several(
        cls, images: Sequence[Image], neck: float, *, some: bool = False
    ) -> SectionFigures:
        """Return the mean of pictures whose boundaries are label 1.

        Raises
        ------
        InputError
            No cells in one of them; where `some` suffice, in all.
        """
        found, last = [], None
        for image in images:
            try:
                found.append(cls.of(image, neck))
            except InputError as error:
                if not some:
                    raise
                last = error
        if last is not None and not found:
            raise last
        return cls.mean(found)

    @classmethod
    def mean(cls, found: Sequence[SectionFigures]) -> SectionFigures:
        """Return the mean of several sections."""
        names = ("density", "sizes", "aspect", "neighbours", "walls", "thick")
        means = {name: np.mean([getattr(one, name) for one in found], axis=0) for name in names}
        sizes = means.pop("sizes")
        return cls(sizes=sizes, **{name: float(value) for name, value in means.items()})

    def difference(self, other: SectionFigures) -> float:
        """Return how far the cells of two sections are apart: mean difference of the deciles of
        sizes, and differences of the mean aspect and of the spread of neighbours.
        """
        sizes = float(np.abs(self.sizes - other.sizes).mean())
        return (
            sizes
            + 0.3 * abs(self.aspect - other.aspect)
            + 0.1 * abs(self.neighbours - other.neighbours)
        )


@dataclass(frozen=True)
class Shape:
    """What sections tell of the cells in space."""

    density: float
    """Cells per voxel."""
    spread: float
    lloyd_steps: int
    rounding: float
    walls: float
    """Volume fraction of the boundary."""
    difference: float
    """Of the sections that were made to the picture's."""


@dataclass(frozen=True)
class SolidWalls:
    """What a scan tells of its walls in space."""

    thick: float
    """Thickening."""
    stretch: tuple[float, float, float]
    """Lengths of cells along z, y, x over their geometric mean, in voxels."""


def shape_of(
    picture: SectionFigures,
    width: float,
    neck: float,
    solid: SolidWalls | None = None,
    *,
    spread: float | None,
    lloyd_steps: int | None,
    rounding: float | None,
) -> Shape:
    """Return the settings whose sections are most like the picture; those that are given stay.

    `width` is the shorter side of the picture, pixels. Spread and steps are searched in turns along
    `SPREADS` and `STEPS`, then the rounding: in space where a scan tells of its walls.
    """
    density = (picture.density / _PER_SECTION) ** 1.5
    trial = _Trial(picture, width, neck, density, solid)
    found = Shape(density, 0.4, 3, 0.0, picture.walls, np.inf)
    found = replace(
        found,
        spread=0.4 if spread is None else spread,
        lloyd_steps=3 if lloyd_steps is None else lloyd_steps,
        rounding=0.0 if rounding is None else rounding,
    )
    for _ in range(2):
        if spread is None:
            nearest = min(SPREADS, key=lambda one: trial.off(replace(found, spread=one)))
            found = replace(found, spread=nearest)
        if lloyd_steps is None:
            steps = min(STEPS, key=lambda one: trial.off(replace(found, lloyd_steps=one)))
            found = replace(found, lloyd_steps=steps)
    if rounding is None:
        off = {one: trial.corners_off(replace(found, rounding=one)) for one in ROUNDINGS}
        best = min(off, key=lambda one: off[one])
        for near in (best - FINER, best + FINER):
            if near >= 0:
                off[near] = trial.corners_off(replace(found, rounding=near))
        found = replace(found, rounding=min(off, key=lambda one: off[one]))
    made = trial.figures(found)
    scale = (picture.density / made.density) ** 1.5
    return replace(found, density=density * scale, difference=picture.difference(made))


class _Trial:
    """Small tessellations, cut and measured; each is made once."""

    def __init__(
        self,
        picture: SectionFigures,
        width: float,
        neck: float,
        density: float,
        solid: SolidWalls | None = None,
    ) -> None:
        self.picture, self.width, self.neck, self.density = picture, width, neck, density
        self.solid = solid
        self.edge, self.side = density ** (-1 / 3), (_CELLS / density) ** (1 / 3)
        self._grown: dict[tuple[float, int], tuple[Diagram, Touching]] = {}
        self._seen: dict[tuple[float, int, float], SectionFigures] = {}

    def off(self, shape: Shape) -> float:
        """Return how far the cells of sections are from the picture's."""
        return self.picture.difference(self.figures(shape))

    def corners_off(self, shape: Shape) -> float:
        """Return how far the corners of boundaries are off; sharp ones are taken unless round ones
        are nearer by more than what is looked at scatters.
        """
        if self.solid is not None:
            return abs(self.solid.thick - self._thick_in_space(shape, self.solid.stretch)) + (
                _SURER * shape.rounding
            )
        return abs(self.picture.thick - self.thick(shape)) + _SURE * shape.rounding

    def thick(self, shape: Shape) -> float:
        """Return the thickening of the walls of sections with pixels as fine as the picture's:
        coarser ones take walls of few pixels for even ones.
        """
        width = min(self.width, _WIDTH * self.edge, _FINE)
        return float(np.mean([thickening(plane) for plane in self._sections(shape, width, 1.0)]))

    def _thick_in_space(self, shape: Shape, stretch: Sequence[float]) -> float:
        """Return the thickening of the walls of a box with voxels as fine as the scan's."""
        sides = [int(np.clip(_BOX * self.edge * long, *_BOX_SIDES)) for long in stretch]
        axes = zip(sides, stretch, strict=True)
        grid = PointGrid(*((np.arange(side) + 0.5) / long for side, long in axes))
        return thickening(self._walls(shape, grid))

    def figures(self, shape: Shape) -> SectionFigures:
        """Return the figures of sections of a trial."""
        key = (shape.spread, shape.lloyd_steps, shape.rounding)
        if key not in self._seen:
            self._seen[key] = self._measure(shape)
        return self._seen[key]

    def _measure(self, shape: Shape) -> SectionFigures:
        pixel = max(1.0, self.edge / _PIXELS)
        found = []
        for plane in self._sections(shape, min(self.width, _WIDTH * self.edge), pixel):
            image = Image(
                plane.astype(np.uint8),
                "labels",
                (pixel,) * 2,
                "voxel",
                ("interior", "boundary"),
            )
            try:
                found.append(SectionFigures.of(image, self.neck))
            except InputError:
                continue  # a section of few cells
        if not found:
            raise InputError(
                "no cells found in sections of the tessellation: the picture's boundaries are too "
                "thick for its cells; give a picture of higher resolution"
            )
        return SectionFigures.mean(found)

    def _sections(self, shape: Shape, width: float, pixel: float) -> Iterator[np.ndarray]:
        """Yield the walls of sections across every axis, bool."""
        line = (np.arange(max(1, round(width / pixel))) + 0.5) * pixel
        cuts = (np.arange(_PLANES) + 0.5) * (self.side / _PLANES)
        for axis in range(3):
            grid = PointGrid(*(cuts if axis == each else line for each in range(3)))
            walls = self._walls(shape, grid, across=axis)
            yield from (np.ascontiguousarray(plane) for plane in np.moveaxis(walls, axis, 0))

    def _walls(self, shape: Shape, grid: PointGrid, *, across: int | None = None) -> np.ndarray:
        """Return the walls of a tessellation at the points of a grid."""
        key = (shape.spread, shape.lloyd_steps)
        if key not in self._grown:
            diagram, _ = grow_grains(
                _SEED,
                (self.side,) * 3,
                self.density,
                spread=shape.spread,
                lloyd_steps=shape.lloyd_steps,
                points=_POINTS,
            )
            points = [round(self.side / self.edge * _POINTS)] * 3
            self._grown[key] = diagram, diagram.neighbours(points)
        radius = shape.rounding * self.edge
        return draw_walls(*self._grown[key], grid, radius, self.picture.walls, across=across)[1]


def draw_walls(
    diagram: Diagram,
    touching: Touching,
    grid: PointGrid,
    radius: float,
    share: float | np.ndarray,
    *,
    across: int | None = None,
    inside: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the cell of every point of a grid, (Z, Y, X) int32, and which are boundary, bool:
    corners are rounded by a radius, the rest is as in `draw_boundaries`.
    """
    owner = diagram.cells(grid)
    depth = diagram.face_distance(grid, owner, touching, radius)
    return owner, draw_boundaries(owner, depth, share, across=across, inside=inside)


def draw_boundaries(
    owner: np.ndarray,
    depth: np.ndarray,
    share: float | np.ndarray,
    *,
    across: int | None = None,
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """Return the boundary of cells, (Z, Y, X) bool: the voxels nearest to faces, as many as make a
    share of all, and at least those that keep the cells apart.

    Of two voxels of different cells that share a face one is boundary: the nearer to a face of its
    cell. So every boundary is closed, however thin.

    Parameters
    ----------
    owner : int32 array, (Z, Y, X)
        Cells.
    depth : float32 array, (Z, Y, X)
        Distance to the faces of the cells. It is written to.
    share : float, or float array, (Z, Y, X)
        Of the boundary; or around every voxel.
    across : int, optional
        An axis whose planes are sections of their own.
    inside : bool array, optional
        Voxels that count. Default: all.
    """
    for axis in range(3):
        if axis == across:
            continue
        first, second = (
            tuple(part if n == axis else slice(None) for n in range(3))
            for part in (slice(None, -1), slice(1, None))
        )
        apart = owner[first] != owner[second]
        nearer = depth[first] <= depth[second]
        depth[first][apart & nearer] = -np.inf
        depth[second][apart & ~nearer] = -np.inf
    inner = ... if inside is None else inside
    known = depth[inner].ravel()
    if isinstance(share, np.ndarray):
        depth = _rank(depth, known) - share.astype(np.float32)
        known, share = depth[inner].ravel(), float(share[inner].mean(dtype=np.float64))
    count = round(share * known.size)
    if count == 0 or known.size == 0:
        return np.asarray(depth == -np.inf)
    level = np.partition(known, min(count, known.size - 1))[min(count, known.size - 1)]
    return np.asarray((depth < level) | (depth == -np.inf))


def _rank(depth: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the share of the voxels `known` that are less deep than every voxel, float32; -inf
    stays.
    """
    deeper = known[known > -np.inf]
    if not deeper.size:
        return depth
    closed = 1 - deeper.size / known.size
    ranks = np.interp(depth, np.quantile(deeper, _MARKS), closed + (1 - closed) * _MARKS)
    return np.where(depth == -np.inf, np.float32(-np.inf), ranks.astype(np.float32))

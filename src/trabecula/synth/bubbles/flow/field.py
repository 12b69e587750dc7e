"""`Flow`: direction of bubbles and room for them at any voxel, slice by slice and on demand.

Later rules of a slice go before earlier ones:

1. the flow of the settings, about the slice's centre; in a wide or tall slice the horizontal or
vertical one, with `flow_aspect`; 2. the flows of regions; 3. near the border of the mask the
outline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_spacing
from trabecula.core.errors import InputError
from trabecula.engine.blocks import Box
from trabecula.synth.bubbles.flow.config import FlowConfig
from trabecula.synth.bubbles.flow.given import Given
from trabecula.synth.bubbles.flow.slices import (
    KEPT,
    MARGIN,
    ORDER,
    SLAB,
    MaskSlices,
    Room,
    Slice,
    cell_of,
)
from trabecula.synth.bubbles.flow.systems import (
    Frames,
    System,
    condition_of,
    pack_int8,
    step_direction,
    system_of,
)

Centre = tuple[np.ndarray | float, np.ndarray | float]


def flow_of(
    config: FlowConfig,
    shape: Sequence[int],
    spacing: float | Sequence[float],
    mask: np.ndarray | None = None,
    *,
    distance: float = 1.0,
) -> Flow | None:
    """Return the flow of a request; None where bubbles grow everywhere and alike in all directions.

    Parameters
    ----------
    config : FlowConfig
    shape : of the request, (Z, Y, X) or (Y, X)
    spacing : float or floats
        Edges of its voxels.
    mask : bool array of that shape, optional
        The form. Without, there is neither outline nor crust.
    distance : float
        Mean distance between bubbles, in the unit of the spacing; for lengths that are shares of
        it.

    Raises
    ------
    InputError
        Labels of another number of axes than the request; a crust that leaves no room.

    Examples
    --------
    >>> flow = flow_of(FlowConfig(flow="-y, x"), (3, 3), 1.0)
    >>> flow.directions(((0, 1), (0, 3))).tolist()
    [[[-90, 90], [0, 127], [90, 90]]]
    """
    silhouette, crust = (
        0.0 if mask is None else config.flow_length(name, distance)
        for name in ("silhouette", "crust")
    )
    if not crust and not config.has_direction(masked=mask is not None):
        return None
    edges = as_spacing(spacing, ndim=len(shape))
    if isinstance(config.flow_labels, Given) and _labels(config).ndim != len(shape):
        raise InputError(
            f"flow_labels has shape {_labels(config).shape}, the request {tuple(shape)}: give as "
            "many axes as the request"
        )
    return Flow(config, tuple(shape), edges, mask, silhouette=silhouette, crust=crust)


class Flow:
    """Directions and room of one request (see `flow_of`)."""

    def __init__(
        self,
        config: FlowConfig,
        shape: tuple[int, ...],
        spacing: tuple[float, ...],
        mask: np.ndarray | None,
        *,
        silhouette: float,
        crust: float,
    ) -> None:
        self._config, self._step = config, min(spacing)
        self._room = Room(mask, crust, spacing) if crust and mask is not None else None
        self._flat = len(shape) == 2
        self._order = ORDER["z" if self._flat else config.flow_axis]
        self._frames = Frames(
            self._solid(shape, 1), self._solid(spacing, 1.0), self._order, config.flow_extent
        )
        self._edges = tuple(self._frames.spacing[axis] for axis in self._order[1:])
        self._slices = self._slices_of(mask, silhouette)
        self._system = system_of(config.flow)
        self._wide, self._tall = system_of("horizontal"), system_of("vertical")
        self._regions = [
            (condition_of(where), system_of(flow)) for where, flow in config.flow_regions
        ]
        self._labels = (
            None
            if config.flow_labels is None
            else _labels(config).reshape(self._solid(_labels(config).shape, 1))
        )

    def directions(self, box: Box, step: int = 1) -> np.ndarray:
        """Return the direction of bubbles at every voxel of a box or at every `step`-th.

        Parameters
        ----------
        box : pairs of int, as many as axes
            May reach beyond the request.
        step : int
            Voxels first, first + step, ... along every axis.

        Returns
        -------
        vectors : (Z, Y, X, 3) int8 array; (Y, X, 2) of a picture
            Unit vectors along z, y, x times 127, 0 where there is no direction.
        """
        nodes = [np.arange(first, last, step) for first, last in self._solid(box, (0, 1))]
        along, tall, wide = (nodes[axis] for axis in self._order)
        found = np.empty((*(len(places) for places in nodes), 3), np.int8)
        turned, back = found.transpose(*self._order, 3), np.argsort(self._order)
        known: dict[object, np.ndarray] = {}
        for i, place in enumerate(along):
            turned[i] = self._slice(int(place), tall, wide, known)[..., back]
        return np.ascontiguousarray(found[0, ..., 1:]) if self._flat else found

    def room(self, box: Box) -> np.ndarray | None:
        """Return a bool mask of the room for bubbles in a box; None without a crust."""
        return None if self._room is None else self._room(box)

    def _slices_of(self, mask: np.ndarray | None, silhouette: float) -> MaskSlices | None:
        """Return the slices of a mask; None without one."""
        if mask is None:
            return None
        turned = (mask[None] if self._flat else mask).transpose(self._order)
        return MaskSlices(
            turned,
            self._edges,
            by_component=self._config.flow_centre == "piece",
            silhouette=silhouette,
        )

    def _slice(
        self, place: int, tall: np.ndarray, wide: np.ndarray, known: dict[object, np.ndarray]
    ) -> np.ndarray:
        """Return the vectors of one slice, (rows, columns, 3) along the slices' order of axes."""
        form = None if self._slices is None else self._slices[place]
        system, centre = self._choose_system(form), self._centre(form, tall, wide)
        alike = not self._regions and (
            system is None or (system.frame == "slice" and "z" not in system.names)
        )
        key = (system, centre) if alike and not isinstance(centre[0], np.ndarray) else None
        if key is None or key not in known:
            known.clear()  # the last one is enough: slices follow each other
            vectors = self._directions_of(system, place, tall, wide, centre)
            for where, other in reversed(self._regions):
                inside = self._inside_region(where, place, tall, wide)
                there = self._directions_of(other, place, tall, wide, centre)
                vectors = np.where(inside[..., None], there, vectors)
            known[key] = pack_int8(vectors)
        return (
            known[key]
            if form is None or form.outline is None
            else self._follow_outline(known[key], form, tall, wide)
        )

    def _choose_system(self, form: Slice | None) -> System | None:
        """Return the flow of a slice, by its shape with `flow_aspect`."""
        ratio = self._config.flow_aspect
        if not ratio:
            return self._system
        voxels = (
            [self._frames.shape[axis] for axis in self._order[1:]] if form is None else form.extent
        )
        height, width = (side * edge for side, edge in zip(voxels, self._edges, strict=True))
        if width >= ratio * height:
            return self._wide
        return self._tall if height >= ratio * width else self._system

    def _centre(self, form: Slice | None, tall: np.ndarray, wide: np.ndarray) -> Centre:
        """Return the origin of x and y, as lengths from the corner of the slice."""
        if form is None or self._config.flow_centre == "box":
            down, right = (self._frames.middle[axis] for axis in self._order[1:])
            return down, right
        if form.centres is None:
            return form.centre[0] * self._edges[0], form.centre[1] * self._edges[1]
        rows, columns = (
            np.clip(nodes, 0, side - 1)
            for nodes, side in zip((tall, wide), form.centres[0].shape, strict=True)
        )
        down, right = (part[np.ix_(rows, columns)] for part in form.centres)
        return down * self._edges[0], right * self._edges[1]

    def _directions_of(
        self, system: System | None, place: int, tall: np.ndarray, wide: np.ndarray, centre: Centre
    ) -> np.ndarray:
        """Return the directions of a system in a slice, (rows, columns, 3) float64."""
        found = np.zeros((len(tall), len(wide), 3))
        if system is not None:
            point = self._frames.points(place, tall, wide)
            velocity = self._frames.velocity(system, centre)
            for axis, part in enumerate(step_direction(velocity, point, self._step)):
                # some are constant over the slice
                found[..., axis] = part if part.ndim < 3 else part[0]
        return found

    def _inside_region(self, where, place: int, tall: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """Return a mask of a region in a slice, (rows, columns) bool."""
        z, y, x = self._frames.of_volume(self._frames.points(place, tall, wide))
        label: np.ndarray | float = 0.0
        if self._labels is not None:
            label = self._frames.nearest(self._labels, place, tall, wide)
        holds = np.nan_to_num(where(z=z, y=y, x=x, label=label)) != 0
        return np.broadcast_to(holds, (1, len(tall), len(wide)))[0]

    def _follow_outline(
        self, vectors: np.ndarray, form: Slice, tall: np.ndarray, wide: np.ndarray
    ) -> np.ndarray:
        """Return the vectors of a slice, turned along its border near to it."""
        assert form.outline is not None and self._slices is not None
        sides = self._slices.shape
        inside = [
            (nodes >= 0) & (nodes < side) for nodes, side in zip((tall, wide), sides, strict=True)
        ]
        box = np.ix_(*inside)
        cells = np.ix_(
            *(nodes[kept] // form.every for nodes, kept in zip((tall, wide), inside, strict=True))
        )
        along = form.outline[cells]
        found = vectors.copy()
        border = np.zeros(found.shape[:2], bool)
        border[box] = along.any(axis=-1)
        found[border] = np.pad(along[border[box]], [(0, 0), (1, 0)])
        return found

    def _solid(self, values, default):
        """Extend the values of a picture by the default for z."""
        return (default, *values) if self._flat else tuple(values)


def _labels(config: FlowConfig) -> np.ndarray:
    """Return the array of labels of the settings."""
    array = config.flow_labels.array
    assert array is not None  # checked by the config
    return array


_OWN = 1000  # bytes of a stored slice beside its arrays
_STEP = 340  # bytes a node of a slice during the Runge-Kutta step
_COMPONENTS = 60  # bytes a voxel of a slice during the labelling of its components
_DISTANCE = 7  # bytes a voxel of a slab during the distance transform
_LEAST = 100_000


def bytes_of_flow(
    config: FlowConfig,
    shape: Sequence[int],
    spacing: float | Sequence[float],
    *,
    masked: bool,
    distance: float = 1.0,
    step: int = 1,
) -> int:
    """Return the memory of the flow of a request beside its directions, 3 bytes a node.

    Parameters
    ----------
    config, shape, spacing, distance : as of `flow_of`
    masked : bool
        Whether there is a mask.
    step : int
        Voxels from node to node.
    """
    edges = as_spacing(spacing, ndim=len(shape))
    silhouette, crust = (
        config.flow_length(name, distance) if masked else 0.0 for name in ("silhouette", "crust")
    )
    flat = len(shape) == 2
    along, tall, wide = (
        (1, *shape)[axis] if flat else shape[axis]
        for axis in ORDER["z" if flat else config.flow_axis]
    )
    voxels = tall * wide
    work = _STEP * voxels / step**2
    kept = 0.0
    if masked:
        each: float = _OWN
        if silhouette:
            every, cells = cell_of(silhouette / min(edges))
            around = (tall / every + 2 * cells) * (wide / every + 2 * cells)
            each += 2 * voxels / every**2
            work += 64 * around
        if config.flow_centre == "piece":
            each += 8 * voxels
            work += _COMPONENTS * voxels
        kept = min(KEPT + each, math.ceil(along / step) * each)
        work += 3 * voxels
    return int(work + kept + (_of_room(shape, crust, edges) if crust else 0)) + _LEAST


def _of_room(shape: Sequence[int], crust: float, edges: Sequence[float]) -> float:
    """Return the memory of one bit a voxel, and of a slab while its distances are found."""
    margin = [2 * (math.ceil(crust / edge) + MARGIN) for edge in edges]
    first = min(SLAB, shape[0]) if len(shape) == 3 else shape[0]
    slab = [side + far for side, far in zip((first, *shape[1:]), margin, strict=True)]
    return math.prod(shape) / 8 + _DISTANCE * math.prod(slab) + 2 * first * math.prod(shape[1:])

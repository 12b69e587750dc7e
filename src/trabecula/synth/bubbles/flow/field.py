"""`Flow`: which way bubbles stretch at any voxel, and where they may grow; slice by slice, and only
where it is asked for.

What a slice says, later lines over earlier ones:

1. the flow of the settings, about the slice's centre; in a wide or tall slice the horizontal or
vertical one, where asked for;
2. the flows of regions;
3. near the border of the mask the outline.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_spacing
from trabecula.core.errors import InputError
from trabecula.engine.blocks import Box
from trabecula.synth.bubbles.flow.config import FlowConfig
from trabecula.synth.bubbles.flow.frames import Frames
from trabecula.synth.bubbles.flow.given import Given
from trabecula.synth.bubbles.flow.room import Room
from trabecula.synth.bubbles.flow.slices import ORDER, Slice, Slices
from trabecula.synth.bubbles.flow.step import packed, step_direction
from trabecula.synth.bubbles.flow.systems import System, condition_of, system_of

Centre = tuple[np.ndarray | float, np.ndarray | float]


def flow_of(
    config: FlowConfig,
    shape: Sequence[int],
    spacing: float | Sequence[float],
    mask: np.ndarray | None = None,
    *,
    distance: float = 1.0,
) -> Flow | None:
    """The flow of a request; None where bubbles grow everywhere, and alike in all directions.

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
    if not crust and not config.directed(masked=mask is not None):
        return None
    edges = as_spacing(spacing, ndim=len(shape))
    if isinstance(config.flow_labels, Given) and _labels(config).ndim != len(shape):
        raise InputError(
            f"flow_labels has shape {_labels(config).shape}, the request {tuple(shape)}: give as many axes as the request"
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
        """The way that bubbles stretch, at every voxel of a box or at every `step`-th.

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
        """Which voxels of a box bubbles may grow in, a bool array of its size; None where there is
        no crust.
        """
        return None if self._room is None else self._room(box)

    def _slices_of(self, mask: np.ndarray | None, silhouette: float) -> Slices | None:
        if mask is None:
            return None
        turned = (mask[None] if self._flat else mask).transpose(self._order)
        return Slices(
            turned, self._edges, pieces=self._config.flow_centre == "piece", silhouette=silhouette
        )

    def _slice(
        self, place: int, tall: np.ndarray, wide: np.ndarray, known: dict[object, np.ndarray]
    ) -> np.ndarray:
        """Vectors of one slice, (rows, columns, 3) along the slices' order of axes."""
        form = None if self._slices is None else self._slices[place]
        system, centre = self._chosen(form), self._centre(form, tall, wide)
        alike = not self._regions and (
            system is None or (system.frame == "slice" and "z" not in system.names)
        )
        key = (system, centre) if alike and not isinstance(centre[0], np.ndarray) else None
        if key is None or key not in known:
            known.clear()  # the last one is enough: slices follow each other
            vectors = self._flowing(system, place, tall, wide, centre)
            for where, other in reversed(self._regions):
                inside = self._holds(where, place, tall, wide)
                there = self._flowing(other, place, tall, wide, centre)
                vectors = np.where(inside[..., None], there, vectors)
            known[key] = packed(vectors)
        return (
            known[key]
            if form is None or form.outline is None
            else self._outlined(known[key], form, tall, wide)
        )

    def _chosen(self, form: Slice | None) -> System | None:
        """The flow of a slice, by its shape where that is asked for."""
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
        """Where x and y are 0, as lengths from the corner of the slice."""
        if form is None or self._config.flow_centre == "box":
            down, right = (self._frames.middle[axis] for axis in self._order[1:])
            return down, right
        if form.pieces is None:
            return form.centre[0] * self._edges[0], form.centre[1] * self._edges[1]
        rows, columns = (
            np.clip(nodes, 0, side - 1)
            for nodes, side in zip((tall, wide), form.pieces[0].shape, strict=True)
        )
        down, right = (part[np.ix_(rows, columns)] for part in form.pieces)
        return down * self._edges[0], right * self._edges[1]

    def _flowing(
        self, system: System | None, place: int, tall: np.ndarray, wide: np.ndarray, centre: Centre
    ) -> np.ndarray:
        """Directions of a system in a slice, (rows, columns, 3) float64."""
        found = np.zeros((len(tall), len(wide), 3))
        if system is not None:
            point = self._frames.points(place, tall, wide)
            velocity = self._frames.velocity(system, centre)
            for axis, part in enumerate(step_direction(velocity, point, self._step)):
                # some are the same all over the slice
                found[..., axis] = part if part.ndim < 3 else part[0]
        return found

    def _holds(self, where, place: int, tall: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """Where a region lies in a slice, (rows, columns) bool."""
        z, y, x = self._frames.of_volume(self._frames.points(place, tall, wide))
        label: np.ndarray | float = 0.0
        if self._labels is not None:
            label = self._frames.nearest(self._labels, place, tall, wide)
        holds = np.nan_to_num(where(z=z, y=y, x=x, label=label)) != 0
        return np.broadcast_to(holds, (1, len(tall), len(wide)))[0]

    def _outlined(
        self, vectors: np.ndarray, form: Slice, tall: np.ndarray, wide: np.ndarray
    ) -> np.ndarray:
        """Vectors of a slice, those near its border along it."""
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
        """What is told for each axis, for three axes."""
        return (default, *values) if self._flat else tuple(values)


def _labels(config: FlowConfig) -> np.ndarray:
    array = config.flow_labels.array
    assert array is not None  # checked by the config
    return array

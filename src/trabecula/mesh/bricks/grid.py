"""Voxels of some phases as bricks: their nodes and numbers, plane by plane.

A voxel (z, y, x) has the nodes (z .. z + 1, y .. y + 1, x .. x + 1) of the grid of corners. Only
nodes of bricks have numbers, in raster order, and so have bricks. No more than three planes of
voxels and two of nodes are in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.core.progress import track
from trabecula.engine.lazy_volume import Slabs
from trabecula.mesh.bricks.contacts import ContactTally

AT_ONCE = 16
"""Planes that are read at once, unless a chunk of the store has more."""

CORNERS = np.array(
    [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0), (1, 0, 0), (1, 0, 1), (1, 1, 1), (1, 1, 0)]
)
"""Corners (z, y, x) of a brick in the order of Abaqus and VTK: around the lower face, seen from
above counterclockwise, then around the upper one."""


@dataclass(frozen=True, eq=False)
class BrickLayer:
    """The bricks of one plane of voxels.

    Attributes
    ----------
    z : int
    members : int16 array, (Y, X)
        Number of the phase among those chosen; -1 of voxels that are no bricks.
    low, high : int64 array, (Y + 1, X + 1)
        Numbers of the nodes below and above, from 0; -1 where no brick is.
    first : int
        Number of the first brick of the plane.
    """

    z: int
    members: np.ndarray
    low: np.ndarray
    high: np.ndarray
    first: int

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Return y and x of the bricks, in raster order."""
        y, x = np.nonzero(self.members >= 0)
        return y, x

    def nodes(self) -> np.ndarray:
        """Return the eight nodes of every brick, (bricks, 8), in the order of `CORNERS`."""
        y, x = self.places
        return np.stack([(self.low, self.high)[k][y + j, x + i] for k, j, i in CORNERS], axis=1)


@dataclass(frozen=True)
class BrickCount:
    """Sizes of a mesh of bricks.

    Attributes
    ----------
    nodes : int
    bricks : tuple of int
        Of every phase that was chosen.
    edge_contacts, node_contacts : int
        Edges and nodes of the grid at which bricks touch that share no face there (at nodes no
        edge either).
    """

    nodes: int
    bricks: tuple[int, ...]
    edge_contacts: int
    node_contacts: int


@dataclass(frozen=True, eq=False)
class BrickGrid:
    """Voxels of some phases of a volume, as bricks.

    Parameters
    ----------
    volume : Slabs
    members : int16 array, (256,)
        Label -> number of its phase among those chosen, -1 of others.
    names : tuple of str
        Of the phases that are chosen.
    keep : bool array, (Z, Y, X), optional
        Voxels that may become bricks. Default: all.
    """

    volume: Slabs
    members: np.ndarray
    names: tuple[str, ...]
    keep: np.ndarray | None = None

    def planes(self) -> Iterator[np.ndarray]:
        """Yield the members of every plane, (Y, X) int16."""
        z, depth = 0, max(AT_ONCE, self.volume.grain)
        slabs = self.volume.slabs(depth)
        for slab in track(slabs, "bricks", total=-(-self.volume.shape[0] // depth)):
            for plane in np.asarray(slab.values):
                found = self.members[plane]
                if self.keep is not None:
                    found = np.where(self.keep[z], found, np.int16(-1))
                yield found
                z += 1

    def layers(self) -> Iterator[BrickLayer]:
        """Yield the bricks of every plane with the numbers of their nodes."""
        planes = self.planes()
        plane: np.ndarray | None = next(planes)
        assert plane is not None
        low, nodes = _numbers(_corners(plane >= 0), 0)
        z = bricks = 0
        while plane is not None:
            above = next(planes, None)
            used = _corners(plane >= 0)
            if above is not None:
                used |= _corners(above >= 0)
            high, nodes = _numbers(used, nodes)
            yield BrickLayer(z, plane, low, high, bricks)
            bricks += int(np.count_nonzero(plane >= 0))
            plane, low, z = above, high, z + 1

    def node_layers(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the numbers of the nodes of every layer of corners, k = 0 .. Z."""
        layer = None
        for layer in self.layers():
            yield layer.z, layer.low
        assert layer is not None
        yield layer.z + 1, layer.high

    @cached_property
    def count(self) -> BrickCount:
        """Return the sizes of the mesh, of one pass over the voxels."""
        tally, bricks, nodes = ContactTally(), np.zeros(len(self.names), np.int64), 0
        for layer in self.layers():
            inside = layer.members >= 0
            bricks += np.bincount(layer.members[inside], minlength=len(self.names))
            nodes += int(np.count_nonzero(layer.low >= 0))
            tally.add(inside)
        nodes += int(np.count_nonzero(layer.high >= 0))
        edges, corners = tally.finish()
        return BrickCount(nodes, tuple(bricks.tolist()), edges, corners)

    def coordinates(self, k: int, numbers: np.ndarray, scale: float = 1.0) -> np.ndarray:
        """Return x, y, z of the nodes of a layer of corners, (nodes, 3) float64."""
        j, i = np.nonzero(numbers >= 0)
        dz, dy, dx = (scale * edge for edge in self.volume.spacing)
        return np.stack([i * dx, j * dy, np.full(len(i), k * dz)], axis=1)


def _corners(inside: np.ndarray) -> np.ndarray:
    """Return the corners of the voxels of a plane, (Y + 1, X + 1) bool."""
    found = np.zeros((inside.shape[0] + 1, inside.shape[1] + 1), bool)
    for j in (0, 1):
        for i in (0, 1):
            found[j : j + inside.shape[0], i : i + inside.shape[1]] |= inside
    return found


def _numbers(used: np.ndarray, first: int) -> tuple[np.ndarray, int]:
    """Return numbers of the corners that are used, from `first` on, and the next number."""
    numbers = np.full(used.shape, -1, np.int64)
    count = int(np.count_nonzero(used))
    numbers[used] = np.arange(first, first + count)
    return numbers, first + count

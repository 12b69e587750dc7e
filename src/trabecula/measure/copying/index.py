"""The neighbourhoods of an image as bits, and those of an exemplar as a tree for exact search.

Memory: 16 bytes a voxel of either image for two phases and 9 x 9 x 9 voxels, and 35 for each
candidate of the exemplar.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from trabecula.engine.parallel import for_slabs
from trabecula.measure.copying.kernels import FAR, gather_features, grow_tree, nearest, pack_planes


@dataclass(frozen=True)
class Geometry:
    """The voxels of a neighbourhood: `width` of them along every axis (odd, or 1), `step` apart."""

    width: tuple[int, ...]
    step: int
    bits: int  # of a label
    phase: int  # whose voxels are counted in blocks

    @property
    def span(self) -> tuple[int, ...]:
        """Return the voxels from the first to the last of a neighbourhood, along every axis."""
        return tuple((width - 1) * self.step for width in self.width)

    @property
    def centre(self) -> np.ndarray:
        """Return the step from a neighbourhood's corner to its voxel."""
        return np.asarray(self.span) // 2

    @property
    def block(self) -> tuple[int, ...]:
        """Return the width of a block."""
        return tuple(max(1, width // 3) for width in self.width)

    @property
    def offsets(self) -> np.ndarray:
        """Return the blocks' corners from the neighbourhood's."""
        sides = [
            [i * block * self.step for i in range(min(3, width))]
            for width, block in zip(self.width, self.block, strict=True)
        ]
        return np.stack(np.meshgrid(*sides, indexing="ij"), -1).reshape(-1, 3)


@dataclass(frozen=True)
class Neighbourhoods:
    """The neighbourhoods of an image: their bits by plane, counts by block, and which of them
    count.
    """

    planes: np.ndarray  # (Z, Yc, Xc, words) uint64
    blocks: np.ndarray  # (., ., .) uint8
    counts: np.ndarray  # (Zc, Yc, Xc) bool: holds an interface near its centre


@dataclass(frozen=True)
class Tree:
    """The exemplar's candidates, split so that few have to be compared."""

    cubes: Neighbourhoods
    corners: np.ndarray  # (N,) int64, flat in cubes.counts.shape
    features: np.ndarray  # (N, F) uint8
    nodes: np.ndarray
    low: np.ndarray
    high: np.ndarray


def neighbourhoods_of(values: np.ndarray, geometry: Geometry) -> Neighbourhoods:
    """Return the neighbourhoods of (Z, Y, X) labels."""
    planes, blocks = pack_neighbourhoods(values, geometry)
    return Neighbourhoods(planes, blocks, _near_interface(values, geometry))


def pack_neighbourhoods(values: np.ndarray, geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Return the bits of the neighbourhoods by plane, and their counts by block."""
    _, height, breadth = geometry.width
    rows = 64 // breadth
    words = -(-height // rows) * geometry.bits
    shape = (
        values.shape[0],
        values.shape[1] - geometry.span[1],
        values.shape[2] - geometry.span[2],
    )
    planes = np.empty((*shape, words), np.uint64)
    width = np.asarray(geometry.width)
    for_slabs(
        lambda a, b: pack_planes(values, planes, width, geometry.step, geometry.bits, rows, a, b),
        shape[0],
    )
    counted = (values == geometry.phase).astype(np.uint8)
    blocks = over_windows(np.add, counted, geometry.block, geometry.step)
    return planes, np.ascontiguousarray(blocks)


def over_windows(
    combine: np.ufunc, values: np.ndarray, width: tuple[int, ...], step: int
) -> np.ndarray:
    """Apply `combine` over every window that fits, `width` values along every axis, `step`
    apart.
    """
    for axis, count in enumerate(width):
        side = values.shape[axis] - (count - 1) * step
        parts = [
            values[(slice(None),) * axis + (slice(i * step, i * step + side),)]
            for i in range(count)
        ]
        values = reduce(combine, parts)
    return values


def _near_interface(values: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Mark where the middle (half as wide) of a neighbourhood holds more than one phase."""
    inner = tuple((width + 1) // 2 // 2 * 2 + 1 if width > 1 else 1 for width in geometry.width)
    rim = [
        (width - small) // 2 * geometry.step
        for width, small in zip(geometry.width, inner, strict=True)
    ]
    middle = values[tuple(slice(r, side - r) for r, side in zip(rim, values.shape, strict=True))]
    highest = over_windows(np.maximum, middle, inner, geometry.step)
    return highest != over_windows(np.minimum, middle, inner, geometry.step)


def features_at(cubes: Neighbourhoods, corners: np.ndarray, geometry: Geometry) -> np.ndarray:
    """Return the features (N, F) uint8 of the neighbourhoods with these flat indices."""
    offsets = geometry.offsets
    features = np.empty((len(corners), len(offsets)), np.uint8)
    gather_features(cubes.blocks, corners, np.asarray(cubes.counts.shape), offsets, features)
    return features


def build_tree(cubes: Neighbourhoods, geometry: Geometry, *, leaf: int) -> Tree:
    """Build the tree over every neighbourhood that counts; a leaf holds at most `leaf`, unless
    their features agree.
    """
    corners = np.flatnonzero(cubes.counts)
    features = features_at(cubes, corners, geometry)
    order = np.arange(len(corners), dtype=np.int32)
    most = 8 * (len(corners) // leaf) + 3
    nodes = np.zeros((most, 4), np.int32)
    low, high = np.empty((2, most, features.shape[1]), np.uint8)
    count = grow_tree(features, order, np.empty_like(order), nodes, low, high, leaf)
    return Tree(
        cubes,
        corners[order],
        np.ascontiguousarray(features[order].T),
        nodes[:count],
        low[:count],
        high[:count],
    )


def search(
    tree: Tree,
    cubes: Neighbourhoods,
    geometry: Geometry,
    sites: np.ndarray,
    moves: np.ndarray,
    bound: np.ndarray,
    *,
    first: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the nearest candidates of neighbourhoods, exactly.

    Parameters
    ----------
    tree : Tree
    cubes : Cubes
        Of the image.
    geometry : Geometry
    sites : (S, 3) int64
        Corners in the image.
    moves : (S, M, 3) int64
    bound : (S,) int32
        Distances up to which a candidate is looked for.
    first : bool
        Any candidate nearer than the bound will do.

    Returns
    -------
    best : (S,) int32
        Number of differing voxels.
    source : (S,) int64
        A candidate that has it, flat in the exemplar's corners; -1 where there is none.
    along : (S, M) int32
        Over all candidates that have it, the least distance when site and candidate both move.
    """
    best, source = bound.astype(np.int32), np.full(len(sites), -1, np.int64)
    along = np.full(moves.shape[:2], FAR, np.int32)
    wanted = features_at(cubes, np.ravel_multi_index(tuple(sites.T), cubes.counts.shape), geometry)
    shape = np.asarray(tree.cubes.counts.shape)

    def work(start: int, stop: int) -> None:
        nearest(
            cubes.planes, tree.cubes.planes, tree.features, tree.corners, shape, tree.nodes,
            tree.low, tree.high, sites, wanted, moves, geometry.width[0], geometry.step,
            geometry.bits, first, best, source, along, start, stop,
        )  # fmt: skip

    for_slabs(work, len(sites), least=64)
    return best, source, along

"""Sources of voxels: a map of where each was taken from, and its patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.copying.index import Geometry, Neighbourhoods, Tree, neighbourhoods_of
from trabecula.measure.copying.kernels import FAR, corner_of, differing, least_between, scan
from trabecula.measure.copying.pair import exemplar_tree, mirror_images, pad_to_image, prepare_pair
from trabecula.measure.union_find import join, root_of

_SIDES = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))


@dataclass(frozen=True)
class Sources:
    """Source of each voxel of an image in its exemplar.

    Attributes
    ----------
    position : (Z, Y, X, 3) or (Y, X, 2) int32
        The source's voxel in the exemplar; -1 where a voxel does not count.
    distance : (Z, Y, X) or (Y, X) float32
        Share of the neighbourhood's voxels that differ, 0..1; NaN where a voxel does not count.
    mirror : (Z, Y, X) or (Y, X) uint8
        How the exemplar was flipped: 1 along the first axis, plus 2 along the second, plus 4 along
        the third.
    """

    position: np.ndarray
    distance: np.ndarray
    mirror: np.ndarray


@dataclass(frozen=True)
class CoherentPatches:
    """Patches of an image that were taken from the exemplar as they are.

    Attributes
    ----------
    sizes : int64 array
        Voxels of every patch, largest first. Together they are the voxels that count.
    largest : int
    mean : float
        Mean size of the patch of a voxel: sum of squares over sum.
    """

    sizes: np.ndarray
    largest: int
    mean: float


def sources(
    exemplar: Image | ArrayLike,
    image: Image | ArrayLike,
    *,
    size: int | None = None,
    mirrors: bool = False,
    half: bool = False,
    sweeps: int = 8,
) -> Sources:
    """Find where each voxel was taken from: a map, exact for copies and nearly so elsewhere.

    Each voxel starts from the nearest candidate in one leaf of a tree, which holds the source of an
    exact copy; then neighbours pass their sources on (Barnes et al. 2009, PatchMatch, section 3.2,
    doi:10.1145/1531326.1531330). Passing on favours sources that move along: use `coherence` for a
    figure, this for a picture and for patch sizes.

    Parameters
    ----------
    exemplar, image, size, mirrors, half
        As in `coherence`.
    sweeps : int
        How far, in voxels, a source may be passed on, 0..100.

    Returns
    -------
    taken : Sources

    Raises
    ------
    InputError
        Images that do not go together or are too small, no interface.
    """
    pair = prepare_pair(exemplar, image, size=size, half=half)
    sweeps = int(as_number(sweeps, name="sweeps", low=0, high=100, whole=True))
    tree = exemplar_tree(pair, leaf=256)
    counts = neighbourhoods_of(pair.image, pair.geometry).counts
    best = np.full(counts.shape, FAR, np.int32)
    position = np.full((*counts.shape, 3), -1, np.int32)
    mirror = np.zeros(counts.shape, np.uint8)
    for flips, cubes in mirror_images(pair, mirrors):
        found, distance = _propagate(tree, cubes, pair.geometry, sweeps)
        found, distance = np.flip(found, flips), np.flip(distance, flips)
        better = distance < best
        best[better] = distance[better]
        corner = np.unravel_index(found[better], tree.cubes.counts.shape)
        position[better] = np.transpose(corner) + pair.geometry.centre
        mirror[better] = sum(1 << (axis - pair.lifted) for axis in flips)
    share = np.where(best < FAR, best / np.float32(np.prod(pair.geometry.width)), np.nan).astype(
        np.float32
    )
    return Sources(
        pad_to_image(position, pair, -1)[..., pair.lifted :],
        pad_to_image(share, pair, np.nan),
        pad_to_image(mirror, pair, 0),
    )


def coherent_patches(taken: Sources) -> CoherentPatches:
    """Measure the patches that were copied as they are: connected regions (by faces) whose source
    less position is constant.

    Independent material falls into crumbs; copied material into patches as wide as what was copied,
    less about half a neighbourhood at every cut (Ashikhmin 2001, doi:10.1145/364338.364405, shows
    such patches).

    Parameters
    ----------
    taken : Sources
        What `sources` returns.

    Returns
    -------
    patches : Patches
        Sizes in voxels.

    Raises
    ------
    InputError
        No voxel has a source.
    """
    check_type(taken, Sources, name="taken", advice="measure.sources gives them")
    counted = taken.position[..., 0] >= 0
    if not counted.any():
        raise InputError("no voxel of the map has a source: the image has no interface")
    ndim = taken.position.shape[-1]
    here = np.indices(counted.shape)
    key = taken.mirror.astype(np.int64)
    for axis in range(ndim):
        sign = 1 - 2 * (taken.mirror.astype(np.int64) >> axis & 1)
        key = (key << 20) + taken.position[..., axis] - sign * here[axis] + (1 << 19)
    key[~counted] = -1
    parent = np.arange(key.size)
    _join_equal(key if ndim == 3 else key[None], parent)
    sizes = np.bincount(parent[counted.ravel()])
    sizes = np.sort(sizes[sizes > 0])[::-1]
    return CoherentPatches(
        sizes, int(sizes[0]), float(np.sum(sizes.astype(np.float64) ** 2) / sizes.sum())
    )


def _propagate(
    tree: Tree, cubes: Neighbourhoods, geometry: Geometry, sweeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the source (flat in the exemplar's corners, -1 where a site does not count) and the
    distance of every site, nearly nearest.
    """
    shape = np.asarray(tree.cubes.counts.shape)
    source = np.empty(cubes.counts.shape, np.int32)
    distance = np.full(source.shape, FAR, np.int32)
    depth, offsets = geometry.width[0], geometry.offsets

    def begin(start: int, stop: int) -> None:
        start_sources(
            cubes.planes, tree.cubes.planes, tree.features, tree.corners, shape, tree.nodes,
            tree.low, tree.high, cubes.blocks, offsets, cubes.counts, depth, geometry.step,
            geometry.bits, source, distance, start, stop,
        )  # fmt: skip

    for_slabs(begin, len(source), least=2)
    for _ in range(sweeps):
        source, distance = _sweep(tree, cubes, geometry, source, distance)
    return source, distance


def _sweep(
    tree: Tree, cubes: Neighbourhoods, geometry: Geometry, old: np.ndarray, far: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    source, distance = np.empty_like(old), np.empty_like(far)
    shape = np.asarray(tree.cubes.counts.shape)

    def work(start: int, stop: int) -> None:
        _pass_sources(
            cubes.planes, tree.cubes.planes, shape, old, far, geometry.width[0], geometry.step,
            geometry.bits, source, distance, start, stop,
        )  # fmt: skip

    for_slabs(work, len(old), least=2)
    return source, distance


@inline
def _find_leaf(wanted, nodes, low, high):
    """Return the leaf that features lead to, by the nearer child of every node."""
    at = 0
    while nodes[at, 2]:
        left, right = nodes[at, 2], nodes[at, 3]
        nearer = least_between(wanted, low[left], high[left]) <= least_between(
            wanted, low[right], high[right]
        )
        at = left if nearer else right
    return at


@inline
def _fits(z, y, x, shape):
    return 0 <= z < shape[0] and 0 <= y < shape[1] and 0 <= x < shape[2]


@kernel
def start_sources(
    image, exemplar, features, corners, shape, nodes, low, high, blocks, offsets, counts, depth,
    step, bits, source, distance, start, stop,
):  # fmt: skip
    """Find the nearest candidate of one leaf of the tree, for sites that count in planes
    start..stop: exact for a true copy.

    distance: what it holds already is a bound that candidates have to be below; source is -1 where
    none is.
    """
    wanted = np.empty(len(offsets), np.uint8)
    sums = np.empty(1024, np.uint16)
    for z in range(start, stop):
        for y in range(counts.shape[1]):
            for x in range(counts.shape[2]):
                source[z, y, x] = -1
                if not counts[z, y, x]:
                    distance[z, y, x] = FAR
                    continue
                for j in range(len(offsets)):
                    wanted[j] = blocks[z + offsets[j, 0], y + offsets[j, 1], x + offsets[j, 2]]
                node = nodes[_find_leaf(wanted, nodes, low, high)]
                best = distance[z, y, x]
                b = min(node[0] + len(sums), node[1])
                scan(features, wanted, node[0], b, sums)
                for n in range(node[0], b):
                    if sums[n - node[0]] >= best:
                        continue
                    u, v, w = corner_of(corners[n], shape)
                    d = differing(image, z, y, x, exemplar, u, v, w, depth, step, bits, best)
                    if d < best:
                        best, source[z, y, x] = d, corners[n]
                distance[z, y, x] = best


@kernel
def _pass_sources(
    image, exemplar, shape, old, far, depth, step, bits, source, distance, start, stop
):
    """Sweep once: try the six neighbours' sources, moved along; of equal ones that of more
    neighbours wins.

    old, far: sources and distances before; source, distance: after, in planes start..stop (Jacobi).
    """
    tried = np.empty(6, np.int64)
    for z in range(start, stop):
        for y in range(old.shape[1]):
            for x in range(old.shape[2]):
                own, best = np.int64(old[z, y, x]), far[z, y, x]
                source[z, y, x], distance[z, y, x] = own, best
                if own < 0:
                    continue
                support = 0
                for side in range(6):
                    dz, dy, dx = _SIDES[side]
                    tried[side] = -1
                    i, j, k = z + dz, y + dy, x + dx
                    if not _fits(i, j, k, old.shape):
                        continue
                    near = np.int64(old[i, j, k])
                    if near < 0:
                        continue
                    u, v, w = corner_of(near, shape)
                    u, v, w = u - dz, v - dy, w - dx
                    if _fits(u, v, w, shape):
                        tried[side] = (u * shape[1] + v) * shape[2] + w
                        support += tried[side] == own
                for side in range(6):
                    if tried[side] < 0 or tried[side] == own:
                        continue
                    agree, first = 0, side
                    for other in range(6):
                        if tried[other] == tried[side]:
                            agree, first = agree + 1, min(first, other)
                    if first < side:
                        continue
                    u, v, w = corner_of(tried[side], shape)
                    d = differing(image, z, y, x, exemplar, u, v, w, depth, step, bits, best)
                    if d < best or (d == best and agree > support):
                        own, best, support = tried[side], d, agree
                source[z, y, x], distance[z, y, x] = own, best


@kernel
def _join_equal(keys, parent):
    """Unite 6-neighbours with the same key, none of it negative; parent (Z * Y * X,) int64 holds 0,
    1, 2, ... at first.
    """
    Z, Y, X = keys.shape
    for z in range(Z):
        for y in range(Y):
            for x in range(X):
                if keys[z, y, x] < 0:
                    continue
                n = (z * Y + y) * X + x
                for axis in range(3):
                    i, j, k = z - (axis == 0), y - (axis == 1), x - (axis == 2)
                    if i >= 0 and j >= 0 and k >= 0 and keys[i, j, k] == keys[z, y, x]:
                        join(parent, n, (i * Y + j) * X + k)
    for n in range(len(parent)):
        parent[n] = root_of(parent, n)

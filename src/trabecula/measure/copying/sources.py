"""Where each voxel was taken from: a map, and the pieces it falls into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.parallel import for_slabs
from trabecula.measure.copying.index import Cubes, Geometry, Tree, cut
from trabecula.measure.copying.kernels import FAR
from trabecula.measure.copying.map_kernels import join_equal, pass_sources, start_sources
from trabecula.measure.copying.pair import checked_pair, framed, grown, mirrored


@dataclass(frozen=True)
class Sources:
    """Where each voxel of an image was taken from.

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
class Patches:
    """Pieces of an image that were taken from the exemplar as they are.

    Attributes
    ----------
    sizes : int64 array
        Voxels of every piece, largest first. Together they are the voxels that count.
    largest : int
    mean : float
        Mean size of the piece that a voxel lies in: sum of squares over sum.
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
    """Where each voxel was taken from: a map, exact for copies and nearly so elsewhere.

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
    pair = checked_pair(exemplar, image, size=size, half=half)
    sweeps = int(as_number(sweeps, name="sweeps", low=0, high=100, whole=True))
    tree = grown(pair, leaf=256)
    counts = cut(pair.image, pair.geometry).counts
    best = np.full(counts.shape, FAR, np.int32)
    position = np.full((*counts.shape, 3), -1, np.int32)
    mirror = np.zeros(counts.shape, np.uint8)
    for flips, cubes in mirrored(pair, mirrors):
        found, distance = _propagated(tree, cubes, pair.geometry, sweeps)
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
        framed(position, pair, -1)[..., pair.lifted :],
        framed(share, pair, np.nan),
        framed(mirror, pair, 0),
    )


def coherent_patches(taken: Sources) -> Patches:
    """Connected regions (by faces) whose source less position is constant: the pieces that were
    copied as they are.

    Independent material falls into crumbs; copied material into pieces as wide as what was copied,
    less about half a neighbourhood at every cut (Ashikhmin 2001, doi:10.1145/364338.364405, shows
    such pieces).

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
    join_equal(key if ndim == 3 else key[None], parent)
    sizes = np.bincount(parent[counted.ravel()])
    sizes = np.sort(sizes[sizes > 0])[::-1]
    return Patches(sizes, int(sizes[0]), float(np.sum(sizes.astype(np.float64) ** 2) / sizes.sum()))


def _propagated(
    tree: Tree, cubes: Cubes, geometry: Geometry, sweeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Source (flat in the exemplar's corners, -1 where a site does not count) and distance of every
    site, nearly nearest.
    """
    shape = np.asarray(tree.cubes.counts.shape)
    source = np.empty(cubes.counts.shape, np.int32)
    distance = np.empty(source.shape, np.int32)
    depth, step, bits = geometry.width[0], geometry.step, geometry.bits
    offsets = geometry.offsets

    def begin(start: int, stop: int) -> None:
        start_sources(
            cubes.planes, tree.cubes.planes, tree.features, tree.corners, shape, tree.nodes, tree.low, tree.high,
            cubes.blocks, offsets, cubes.counts, depth, step, bits, source, distance, start, stop,
        )  # fmt: skip

    for_slabs(begin, len(source), least=2)
    for _ in range(sweeps):
        source, distance = _swept(tree, cubes, geometry, source, distance)
    return source, distance


def _swept(
    tree: Tree, cubes: Cubes, geometry: Geometry, old: np.ndarray, far: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    source, distance = np.empty_like(old), np.empty_like(far)
    shape = np.asarray(tree.cubes.counts.shape)

    def work(start: int, stop: int) -> None:
        pass_sources(
            cubes.planes, tree.cubes.planes, shape, old, far, geometry.width[0], geometry.step, geometry.bits, source,
            distance, start, stop,
        )  # fmt: skip

    for_slabs(work, len(old), least=2)
    return source, distance

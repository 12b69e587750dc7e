"""The surface of a volume that is read plane by plane: the triangles of `mesh`, in its order.

1. Count vertices and triangles of every layer of cubes.
2. March and smooth slabs of layers with a halo on either side, and keep the triangles of the layers
   without it.

A half round of smoothing moves a vertex by its neighbours, which are in the same or the next layer
of cubes: n half rounds need a halo of n layers. A slab is closed by void planes beyond its halo;
one more layer keeps their effect out.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.progress import track
from trabecula.core.recipe import digest_of
from trabecula.engine.files import replacing
from trabecula.engine.lazy_volume import Slabs, depth_within
from trabecula.engine.memory import Plan
from trabecula.measure.phases import indicator
from trabecula.mesh import kernels
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import FORMATS
from trabecula.mesh.sizes import notify_size
from trabecula.mesh.surface import as_rounds, check_not_empty, march, smooth_vertices
from trabecula.mesh.table import case_table

_AT_ONCE = 64
"""Planes in which vertices are counted at once."""

_IN_CORE = 60
"""Bytes a voxel of a surface in memory and of its check, where it has a vertex for five voxels: a
fine foam.
"""


@dataclass(frozen=True)
class Layers:
    """Sizes of the surface of a volume.

    Attributes
    ----------
    vertices, faces : int64 array, (Z + 1,)
        Numbers in layer k, between the voxel planes k - 1 and k: the vertices in plane k - 1 and
        between the two, and the triangles.
    extent : three floats
        Sides of the smallest box around the surface along z, y, x, in the volume's unit; set once
        it has been written.
    """

    vertices: np.ndarray
    faces: np.ndarray
    extent: tuple[float, ...] = ()

    def need(self, depth: int, halo: int, plane: int, writing: Callable[[int], int]) -> Plan:
        """Return the memory of `depth` layers at a time.

        `plane` is the voxels of a plane, `writing` the bytes needed to write so many triangles.
        """
        starts = np.arange(0, len(self.faces), depth)
        low = np.maximum(starts - halo - 1, 0)
        high = np.minimum(starts + depth + halo, len(self.faces))
        most = [
            int((sums[high] - sums[low]).max())
            for sums in (_running_sum(self.vertices), _running_sum(self.faces))
        ]
        planes = 3 * plane * int((high - low).max() + 1)
        # Vertices and their sums in float64, the float32 copy and degrees.
        vertices, faces = 72 * most[0], 12 * most[1]
        records = writing(int(np.add.reduceat(self.faces, starts).max()))
        return Plan({"planes": planes, "vertices": vertices, "faces": faces, "records": records})


def export_slabs(
    volume: Slabs,
    path: str | os.PathLike[str],
    *,
    phase: str | int | None = None,
    smooth: int | None = None,
    depth: int | None = None,
    memory: int | None = None,
) -> Layers:
    """Write the closed surface of a phase slab by slab, without the volume in memory.

    The file is that of `write_mesh(mesh(image), path)`.

    Parameters
    ----------
    volume : Slabs
    path : path
        `.stl`; it appears whole or not at all.
    phase, smooth
        As of `mesh`.
    depth : int, optional
        Layers of cubes in a slab. Default: as many as fit into `memory`. The file does not depend
        on it.
    memory : int, optional
        Bytes that may be used. Default: what is available.

    Returns
    -------
    Layers
        Vertices and triangles by layer, and the extent of them all.

    Raises
    ------
    InputError
        Another suffix, an empty phase, rounds out of range, more triangles than an STL can count.
    MemoryBudgetError
        Not even a slab of one layer fits.
    FileError
        The file cannot be written.
    """
    path, rounds = Path(path), as_rounds(smooth)
    suffixes = [suffix for suffix, form in FORMATS.items() if form.in_slabs]
    if path.suffix.lower() not in suffixes:
        raise InputError(
            f"{path}: a surface is written slab by slab as {', '.join(suffixes)} alone; name it so"
        )
    writer_type = FORMATS[path.suffix.lower()].member("Writer")
    layers = count_layers(volume, phase)
    check_not_empty(bool(layers.faces.any()), phase, volume.phases)
    writer_type.check_count(int(layers.faces.sum()))
    if depth is None:
        plane = (volume.shape[1] + 2) * (volume.shape[2] + 2)
        advice = "export fewer voxels, such as a coarser level"
        need = partial(layers.need, halo=2 * rounds, plane=plane, writing=writer_type.memory)
        depth = depth_within(volume, need, memory=memory, advice=advice)
    depth = int(as_number(depth, name="depth", low=1, high=2**62, whole=True))
    slabs = surface_slabs(volume, layers, phase=phase, rounds=rounds, depth=depth)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    with replacing(path) as temporary, writer_type(temporary) as writer:

        def write_slabs() -> Iterator[np.ndarray]:
            """Write every slab; yield its own vertices, for the digest."""
            for surface, own in slabs:
                writer.add(surface)
                np.minimum(low, surface.vertices[own].min(axis=0, initial=np.inf), out=low)
                np.maximum(high, surface.vertices[own].max(axis=0, initial=-np.inf), out=high)
                yield surface.vertices[own]

        sha256 = digest_of(np.dtype(np.float32), (int(layers.vertices.sum()), 3), write_slabs())
        writer.finish(
            volume.unit, volume.recipe.then_digest("mesh", sha256, phase=phase, smooth=rounds)
        )
    layers = replace(layers, extent=tuple((high - low)[::-1].tolist()))
    notify_size(layers.extent, volume.unit)
    return layers


def in_core_bytes(shape: tuple[int, ...]) -> int:
    """Return about the memory of a surface as a whole; its size is not known before a count."""
    return _IN_CORE * math.prod(shape)


def count_layers(volume: Slabs, phase: str | int | None = None) -> Layers:
    """Count vertices and triangles of every layer of cubes; see `Layers`."""
    table, found = case_table()[0], []
    count = volume.shape[0] + 1
    for first in track(range(0, count, _AT_ONCE), "surface"):
        solid = _planes(volume, first, min(first + _AT_ONCE, count) + 1, phase)
        found += [kernels.count(solid[z : z + 2], table) for z in range(len(solid) - 1)]
    return Layers(*np.array(found, np.int64).T)


def surface_slabs(
    volume: Slabs, layers: Layers, *, phase: str | int | None, rounds: int, depth: int
) -> Iterator[tuple[Mesh, slice]]:
    """Yield the triangles of `depth` layers of cubes at a time.

    With them come the vertices of the slab and its halo, and the slice of those that belong to the
    slab alone.
    """
    count = volume.shape[0] + 1
    starts = [z for z in range(0, count, depth) if layers.faces[z : z + depth].any()]
    for first in track(starts, "surface"):
        last = min(first + depth, count)
        # The padded planes low .. high, of which those cut out of the volume are void.
        low, high = max(0, first - 2 * rounds - 1), min(count, last + 2 * rounds + 1)
        solid = _planes(volume, low, high + 1, phase)
        solid[0] = solid[-1] = 0
        vertices, faces = march(solid)
        vertices[:, 2] += low
        own = np.searchsorted(np.floor(vertices[:, 2]), (first, last))
        # Layers cut by the void planes have other triangles than the volume's: count them here.
        before = kernels.count(solid[: first - low + 1], case_table()[0])[1]
        own_faces = faces[before : before + int(layers.faces[first:last].sum())]
        points = smooth_vertices(
            vertices, faces, shape=volume.shape, spacing=volume.spacing, rounds=rounds
        )
        yield Mesh(points, own_faces, volume.unit), slice(*own)


def _planes(volume: Slabs, first: int, last: int, phase: str | int | None) -> np.ndarray:
    """Return planes of the volume padded by one voxel of void; plane 0 is padding."""
    depth, height, width = volume.shape
    solid = np.zeros((last - first, height + 2, width + 2), np.uint8)
    low, high = max(first - 1, 0), min(last - 1, depth)
    if high > low:
        inside = indicator(volume.planes(low, high), phase)[1]
        solid[low + 1 - first : high + 1 - first, 1:-1, 1:-1] = inside
    return solid


def _running_sum(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)])

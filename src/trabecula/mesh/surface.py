"""`mesh`: the closed surface of one phase of a volume.

1. Pad by one voxel of void, so that the surface closes where the phase meets the border.
2. Run marching cubes on the binary volume with the table of `mesh.table`: count, then fill.
3. Smooth: rounds of Taubin's lambda|mu filter remove the staircase and keep the volume; the faces,
   and so closedness, cannot change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.engine.memory import Plan, check_budget
from trabecula.measure.phases import indicator
from trabecula.mesh import kernels
from trabecula.mesh.base import Mesh
from trabecula.mesh.table import EDGES, case_table

ROUNDS = 10
"""Default rounds of smoothing."""

# Taubin 1995 (doi:10.1145/218380.218473), section 3: pass-band frequency 1 / lambda + 1 / mu = 0.1.
SHRINK, GROW = 0.5, -1.0 / (1.0 / 0.5 - 0.1)


def mesh(
    image: Image | ArrayLike, *, phase: str | int | None = None, smooth: int | None = None
) -> Mesh:
    """Return the closed, outward-facing surface of a phase.

    Parameters
    ----------
    image : Image or array, (Z, Y, X)
        Labels.
    phase : str or int, optional
        Default: the solid, which is every phase but "void".
    smooth : int, optional
        Rounds of smoothing, 0..1000; 0 leaves the vertices at the middle of the voxel edges.
        Default 10.

    Returns
    -------
    Mesh
        Vertices (V, 3) float32 as x, y, z in the image's unit, the origin at the corner of voxel 0;
        faces (F, 3) int32. Every edge is in exactly two faces, in opposite directions, and the
        connected components are those of the voxels with 6 neighbours. Where the phase meets the
        border of the image the surface is flat.

    Raises
    ------
    InputError
        Not labels, not 3-D, an empty phase, rounds out of range.
    MemoryBudgetError
        The surface would not fit into memory.

    References
    ----------
    Lorensen and Cline 1987, doi:10.1145/37401.37422; Taubin 1995, doi:10.1145/218380.218473.
    """
    image = as_image(image)
    rounds = as_rounds(smooth)
    solid = _pad_phase(image, phase)
    vertices, faces = march(solid)
    points = smooth_vertices(
        vertices, faces, shape=image.shape, spacing=image.spacing, rounds=rounds
    )
    return Mesh(
        points, faces, image.unit, image.recipe.then("mesh", points, phase=phase, smooth=rounds)
    )


def as_rounds(smooth: int | None) -> int:
    """Return the rounds of smoothing, checked; `ROUNDS` for None."""
    if smooth is None:
        return ROUNDS
    if (
        isinstance(smooth, bool)
        or not isinstance(smooth, (int, np.integer))
        or not 0 <= smooth <= 1000
    ):
        raise InputError(
            f"smooth {quote(smooth)} is not a number of rounds: give a whole number from 0 to 1000"
        )
    return int(smooth)


def _pad_phase(image: Image, phase: str | int | None) -> np.ndarray:
    """Return the indicator of a phase with one voxel of void around it, uint8."""
    check_labels(image)
    if image.ndim != 3:
        raise InputError(
            f"a surface needs a volume, the image has shape {image.shape}: give 3 axes (z, y, x)"
        )
    inside = indicator(image, phase)[1]
    check_not_empty(bool(inside.any()), phase, image.phases)
    return np.pad(inside.view(np.uint8), 1)


def check_not_empty(found: bool, phase: str | int | None, phases: Sequence[str]) -> None:
    """Raise where no voxel of the phase was found."""
    if not found:
        name = "solid" if phase is None else phase
        raise InputError(
            f"the phase {name!r} is empty, nothing to export: choose one of {', '.join(phases)}"
        )


def march(solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) float64 in voxels and faces (F, 3) int32 of a padded volume."""
    counts, triangles = case_table()
    n_vertices, n_faces = kernels.count(solid, counts)
    # While smoothing: vertices and sums in float64, degrees; afterwards the float32 copy.
    check_budget(Plan({"vertices": n_vertices * 64, "faces": n_faces * 12}), advice="mesh a crop")
    if n_vertices >= 2**31:
        raise InputError(
            f"the surface has {n_vertices} vertices, 2**31 - 1 can be numbered: mesh a crop"
        )
    vertices, faces = np.empty((n_vertices, 3)), np.empty((n_faces, 3), np.int32)
    offsets = np.array([(c & 1, c >> 1 & 1, c >> 2 & 1, axis) for c, _, axis in EDGES], np.int64)
    kernels.fill(solid, counts, triangles, offsets, vertices, faces)
    return vertices, faces


def smooth_vertices(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    shape: Sequence[int],
    spacing: Sequence[float],
    rounds: int,
) -> np.ndarray:
    """Smooth vertices in voxels by Taubin's filter, in place; return them in the image's unit.

    The result is float32. Weights are uniform, so smoothing commutes with the scaling to `spacing`.
    """
    if rounds:
        degree, sums = np.zeros(len(vertices), np.int32), np.empty_like(vertices)
        box = np.array(shape[::-1], np.float64)
        kernels.degrees(faces, degree)
        for _ in range(rounds):
            for factor in (SHRINK, GROW):
                kernels.relax(vertices, faces, degree, factor, box, sums)
    vertices *= spacing[::-1]
    return vertices.astype(np.float32)

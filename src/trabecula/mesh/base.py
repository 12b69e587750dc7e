"""`Mesh`: a closed surface of triangles with its unit and its recipe.

Columns of the vertices are x, y, z (the convention of mesh files; images are indexed z, y, x). The
origin is the corner of voxel (0, 0, 0), so a block of n voxels along an axis reaches from 0 to n
times the spacing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in space.

    Parameters
    ----------
    vertices : (V, 3) float32 or float64
        x, y, z in `unit`.
    faces : (F, 3) int32
        Vertex numbers, counter-clockwise seen from outside.
    unit : str
        As of an Image.
    recipe : Recipe
        How it came to be.

    Raises
    ------
    InputError
        Wrong shapes or types, numbers of vertices that do not exist, vertices that are not finite.
    """

    vertices: np.ndarray
    faces: np.ndarray
    unit: str = "voxel"
    recipe: Recipe = field(default_factory=Recipe)

    def __post_init__(self) -> None:
        vertices, faces = np.asarray(self.vertices), np.asarray(self.faces)
        if (
            vertices.ndim != 2
            or vertices.shape[1] != 3
            or vertices.dtype not in (np.float32, np.float64)
        ):
            raise InputError(
                f"vertices are floats of shape (V, 3): got {vertices.dtype}, shape {vertices.shape}"
            )
        if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
            raise InputError(
                f"faces are integers of shape (F, 3): got {faces.dtype}, shape {faces.shape}"
            )
        if not np.isfinite(vertices).all():
            raise InputError("the mesh holds vertices that are NaN or infinite: remove them first")
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise InputError(
                f"faces name vertices {faces.min()}..{faces.max()}, the mesh has "
                f"0..{len(vertices) - 1}"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int32, copy=False))

    def __repr__(self) -> str:
        return f"<Mesh {len(self.vertices)} vertices, {len(self.faces)} faces, {self.unit}>"

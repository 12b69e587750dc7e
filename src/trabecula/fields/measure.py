"""Fields of an image's own descriptors: what each place has around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.image import Image, as_image
from trabecula.fields.grid import of_image
from trabecula.fields.local import windowed
from trabecula.measure.orientation import structure_tensor


def measure(
    image: Image | ArrayLike,
    name: str = "volume_fraction",
    *,
    size: int,
    phase: str | int | None = None,
    connectivity: int | None = None,
) -> Image:
    """A descriptor of the window around every voxel, on the image's grid.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    name : str
        As for `windowed`: "volume_fraction", "porosity", "volume_fraction:PHASE", "surface"
        ("perimeter" in 2-D), "mean_curvature" (3-D), "euler".
    size : int
        Side of the windows in voxels.
    phase, connectivity
        As for `windowed`.

    Returns
    -------
    field : Image
        Grey, float32, the image's shape. Densities are per voxel. Windows lie wholly inside: within
        half a window of a face the nearest such window counts.

    Raises
    ------
    InputError, UnknownNameError
        As `windowed`.

    Examples
    --------
    >>> steps = np.repeat([[0, 0, 0, 1, 1, 1]], 3, axis=0)
    >>> measure(steps, size=3).values[1].round(2)
    array([0.  , 0.  , 0.33, 0.67, 1.  , 1.  ], dtype=float32)
    """
    source = as_image(image)
    width = int(as_number(size, name="size", low=2, high=1 << 20, whole=True))
    inside = windowed(source, size=width, names=[name], phase=phase, connectivity=connectivity)[
        name
    ]
    settings = {"name": name, "size": width, "phase": phase, "connectivity": connectivity}
    return of_image(centred(inside, width), "measure", settings, source)


def centred(windows: np.ndarray, size: int) -> np.ndarray:
    """Values of windows as a field on the voxels in their middles, with the outermost going on to
    the faces.
    """
    return np.pad(windows, [((size - 1) // 2, size // 2)] * windows.ndim, mode="edge")


def directions(
    image: Image | ArrayLike, *, sigma: float = 1.0, window: float = 4.0
) -> tuple[np.ndarray, np.ndarray]:
    """The local orientation of every voxel: the direction in which values change least, and how
    clear it is.

    The eigenvector of the structure tensor's smallest eigenvalue (see `measure.orientation`).

    Parameters
    ----------
    image, sigma, window
        As for `measure.structure_tensor`.

    Returns
    -------
    vectors : (ndim, ...) float32
        Unit vectors in the order of the axes, the last component that is not 0 positive. 0 where
        nothing changes.
    clarity : (...) float32
        0 .. 1: in 2-D (l1 - l2) / (l1 + l2) of the eigenvalues l1 >= l2, in 3-D (l2 - l3) / l1.

    Raises
    ------
    InputError
        As `measure.structure_tensor`.
    """
    tensor = structure_tensor(image, sigma=sigma, window=window)
    ndim = len(tensor)
    vectors = np.empty((ndim, *tensor.shape[2:]), np.float32)
    clarity = np.empty(tensor.shape[2:], np.float32)
    # by slices: eigenvectors in float64 take 24 times the memory of a field
    for k in range(tensor.shape[2]):
        values, axes = np.linalg.eigh(
            np.moveaxis(tensor[:, :, k].astype(np.float64), (0, 1), (-2, -1))
        )
        most = values[..., -1] + (values[..., 0] if ndim == 2 else 0)
        apart = values[..., 1] - values[..., 0]
        clarity[k] = np.where(most > 0, apart / np.where(most > 0, most, 1), 0)
        least = np.moveaxis(axes[..., 0], -1, 0)
        sign = np.sign(least[0])
        for component in least[1:]:
            sign = np.where(component == 0, sign, np.sign(component))
        vectors[:, k] = np.where(most > 0, least * sign, 0)
    return vectors, clarity

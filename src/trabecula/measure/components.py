"""Connected components of a phase: their number, their sizes, and those that float.

Neighbours share a face unless a connectivity is given. Every measure takes a mask, the region that
counts: what is beyond it is neither phase, so it joins nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.image import Image
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import indicator_in_mask

__all__ = [
    "component_distance",
    "component_sizes",
    "components",
    "floating",
    "floating_voxels",
    "label_components",
    "largest_fraction",
    "share_of_largest",
    "size_distribution",
    "sizes_distance",
]


def component_sizes(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> np.ndarray:
    """Return the voxels of every connected component of a phase, largest first.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    mask : bool array, the image's shape, optional
        Components of the phase inside the mask.
    periodic : bool or one per axis
        Voxels at opposite faces of these axes are neighbours.

    Returns
    -------
    sizes : int64 array, (components,)

    Raises
    ------
    InputError
        A mask of another shape, not boolean or empty, another connectivity, or no such phase.

    Examples
    --------
    >>> component_sizes(np.array([[1, 0, 1, 1], [1, 0, 0, 1]])).tolist()
    [3, 2]
    """
    _, inside, _ = indicator_in_mask(image, phase, mask)
    return np.sort(label_components(inside, connectivity=connectivity, periodic=periodic)[1])[::-1]


def size_distribution(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the distribution of component sizes: each size that occurs, and the share of
    components up to it.

    Every component counts alike, whatever its size.

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `component_sizes`.

    Returns
    -------
    sizes : int64 array, (n,)
        Distinct sizes in voxels, rising.
    share : float64 array, (n,)
        Share of the components that have at most this many voxels; the last is 1.

    Raises
    ------
    InputError
        As `component_sizes`.

    Examples
    --------
    >>> sizes, share = size_distribution(np.array([[1, 0, 1, 0, 1, 1]]))
    >>> sizes.tolist(), share.round(2).tolist()
    ([1, 2], [0.67, 1.0])
    """
    found = component_sizes(
        image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic
    )
    sizes, counts = np.unique(found, return_counts=True)
    return sizes, np.cumsum(counts) / max(1, len(found))


def component_distance(
    a: Image | ArrayLike,
    b: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    relative_to: str = "image",
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the Wasserstein distance between the component sizes of two materials.

    D_w, equation (5) of Zhang, Yang, Li, Wu and Wang 2021 (ScaffoldGAN).

    A material is the set of its components, each with the same mass, at the place on a line that is
    its size over the volume of the model; the distance is the area between the two cumulative
    distributions, 0..1.

    Parameters
    ----------
    a, b : Image or array of labels
        Their shapes may differ.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Default: neighbours share a face.
    relative_to : {"image", "phase"}
        What "volume of the model" means: the voxels of the whole image, or of the phase alone. The
        paper does not say; its figures fit the first, in per cent (its table prints 100 times
        this).
    periodic : bool or one per axis
        Voxels at opposite faces of these axes are neighbours.

    Returns
    -------
    distance : float
        0..1, no unit.

    Raises
    ------
    InputError
        No such phase, another connectivity, or `relative_to` neither of the two.

    Notes
    -----
    A material without any component counts as one component of size 0.

    Examples
    --------
    >>> component_distance(np.array([[1, 1, 0, 1, 0]]), np.array([[1, 1, 1, 1, 0]]))
    0.5
    """
    check_name(relative_to, ("image", "phase"), name="relative_to")
    places = []
    for image in (a, b):
        _, inside, _ = indicator_in_mask(image, phase, None)
        sizes = label_components(inside, connectivity=connectivity, periodic=periodic)[1]
        whole = inside.size if relative_to == "image" else max(1, int(sizes.sum()))
        places.append(sizes / whole)
    return sizes_distance(*places)


def components(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> int:
    """Count the connected components of a phase (default "solid": every phase but "void").

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `component_sizes`.

    Returns
    -------
    components : int
        0 where the phase is empty.

    Raises
    ------
    InputError
        As `component_sizes`.
    """
    return len(
        component_sizes(image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic)
    )


def largest_fraction(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the share of the phase's voxels in its largest component.

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `component_sizes`.

    Returns
    -------
    fraction : float
        0..1; 0 where the phase is empty.

    Raises
    ------
    InputError
        As `component_sizes`.
    """
    return share_of_largest(
        component_sizes(image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic)
    )


def floating(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    smaller_than: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> int:
    """Count the floating components of a phase (default "solid").

    Components that touch a face of the image count as well: whether they continue beyond it cannot
    be known.

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `component_sizes`.
    smaller_than : int, optional
        A component floats when it has fewer voxels than this; Zhang et al. 2021 (section 6.2) take
        10. Default: every component but the largest floats.

    Returns
    -------
    floating : int

    Raises
    ------
    InputError
        As `component_sizes`, and `smaller_than` below 1.
    """
    sizes = component_sizes(
        image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic
    )
    return len(_floating_sizes(sizes, smaller_than))


def floating_voxels(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    smaller_than: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> int:
    """Count the voxels of the floating components.

    Parameters
    ----------
    image, phase, connectivity, smaller_than, mask, periodic
        As for `floating`.

    Returns
    -------
    voxels : int

    Raises
    ------
    InputError
        As `floating`.
    """
    sizes = component_sizes(
        image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic
    )
    return int(_floating_sizes(sizes, smaller_than).sum())


def share_of_largest(sizes: np.ndarray) -> float:
    """Return the largest of `sizes` over their sum; 0 where there are none."""
    return float(sizes.max() / sizes.sum()) if len(sizes) else 0.0


def _floating_sizes(sizes: np.ndarray, smaller_than: int | None) -> np.ndarray:
    """Return, of `sizes`, largest first, those of components that float."""
    if smaller_than is None:
        return sizes[1:]
    return sizes[
        sizes < as_number(smaller_than, name="smaller_than", low=1, high=2**62, whole=True)
    ]


def sizes_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the Wasserstein distance of two samples of sizes.

    The area between their cumulative distributions, where each value of a sample has the same mass.
    An empty sample counts as one value of 0.
    """
    a, b = (np.sort(sample) if len(sample) else np.zeros(1) for sample in (a, b))
    places = np.sort(np.concatenate([a, b]))
    below = [np.searchsorted(sample, places[:-1], side="right") / len(sample) for sample in (a, b)]
    return float(np.abs(below[0] - below[1]) @ np.diff(places))

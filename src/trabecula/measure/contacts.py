"""Contact areas: the interface between two phases of several, per volume.

The interface of two phases together is that of the one and that of the other less twice their
contact, so S_ab = (S_a + S_b - S_a+b) / 2, where S is `specific_surface` (Crofton's formula over 13
directions, 4 in 2-D; Legland, Kieu, Devaux 2007, doi:10.5566/ias.v26.p83-92). That counts each pair
of voxels of two phases for one contact: the contacts of a phase add up to its specific surface, and
with three phases S_ab = (S_a + S_b - S_c) / 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, phase_index
from trabecula.measure.configurations import count_cubes
from trabecula.measure.minkowski import append_wrapped, densities
from trabecula.measure.phases import as_mask, as_periodic, check_sides


def contacts(
    image: Image | ArrayLike,
    *,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> dict[tuple[str, str], float]:
    """Return the contact area per volume of every pair of phases, 1 / length (2-D: length per
    area).

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    mask : bool array, the image's shape, optional
        Only 2x2x2 configurations wholly inside it count.
    periodic : bool or one per axis
        Configurations wrap around the faces.

    Returns
    -------
    areas : dict
        (name, name), in the order of the labels -> area; 0 where two phases never meet. The areas
        of all pairs with a phase add up to its `specific_surface`.

    Raises
    ------
    InputError
        Not labels, a side of one voxel, or a mask that no configuration fits into.

    Notes
    -----
    A flat interface along an axis comes out 8 % low (see `minkowski`).

    Examples
    --------
    >>> stripes = np.repeat([0, 1, 1, 2], 3)[None] * np.ones((4, 1), int)
    >>> {pair: round(area, 3) for pair, area in contacts(stripes).items()}
    {('void', 'solid'): 0.086, ('void', 'phase2'): 0.0, ('solid', 'phase2'): 0.086}
    """
    image = as_image(image)
    check_labels(image)
    labels = range(len(image.phases))
    return _areas(image, list(combinations(labels, 2)), mask, periodic)


def contact(
    image: Image | ArrayLike,
    *,
    first: str | int,
    second: str | int,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the contact area of two phases per volume, 1 / length (2-D: length per area).

    Parameters
    ----------
    image, mask, periodic
        As for `contacts`.
    first, second : str or int
        Two phases; their order does not matter.

    Returns
    -------
    area : float

    Raises
    ------
    InputError
        As `contacts`, no such phase, or one phase given twice.
    """
    image = as_image(image)
    check_labels(image)
    a, b = sorted(phase_index(image, phase, default="") for phase in (first, second))
    if a == b:
        raise InputError(
            f"the contact of {image.phases[a]} with itself is not defined: give two phases"
        )
    return next(iter(_areas(image, [(a, b)], mask, periodic).values()))


def _areas(
    image: Image,
    pairs: list[tuple[int, int]],
    mask: ArrayLike | None,
    periodic: bool | Sequence[bool],
) -> dict[tuple[str, str], float]:
    check_sides(image.shape, what="has no surface inside")
    wraps = as_periodic(periodic, image.ndim)
    values, region = append_wrapped(image.values, wraps), as_mask(mask, image.shape)
    where = None if region is None else append_wrapped(region, wraps)
    counts = {
        label: count_cubes(values == label, where)
        for label in sorted({label for pair in pairs for label in pair})
    }
    if not next(iter(counts.values())).any():
        raise InputError(
            "no 2x2x2 block of voxels (2x2 in 2-D) is wholly in the mask: give a thicker one"
        )

    def joint(a: int, b: int) -> np.ndarray:
        """Count the configurations of two phases together; of three phases they are those of the
        third, turned over.
        """
        rest = set(counts) - {a, b}
        if len(image.phases) == 3 and len(rest) == 1:
            return counts[rest.pop()][::-1]
        return count_cubes((values == a) | (values == b), where)

    return {
        (image.phases[a], image.phases[b]): contact_area(
            counts[a], counts[b], joint(a, b), image.spacing
        )
        for a, b in pairs
    }


def contact_area(
    first: np.ndarray, second: np.ndarray, joint: np.ndarray, spacing: tuple[float, ...]
) -> float:
    """Return the contact area of two phases per volume.

    Parameters
    ----------
    first, second, joint : int64 array, (256,)
        How often each 2x2x2 configuration occurs of either phase, and of the two as one.
    spacing : two or three floats
    """
    # Counts are subtracted, not areas: without any contact the sum is exactly 0.
    return densities(first + second - joint, spacing, 6 if len(spacing) == 3 else 4).surface / 2

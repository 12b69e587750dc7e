"""Two points in a phase, or in two phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.correlation.pair_geometry import positive_fits, probability, select_pairs
from trabecula.measure.correlation.window import as_window
from trabecula.measure.phases import indicator


def two_point(
    image: Image | ArrayLike,
    *,
    r_max: int,
    phase: str | int | None = None,
    axis: int | None = None,
    direction: Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the two-point probability S2(r) of a phase, r = 0 .. r_max.

    The probability that two points a distance r apart are both in the phase, in Torquato's
    normalisation: S2(0) = phi, and S2 tends to phi^2 (Torquato 2002, doi:10.1007/978-1-4757-6355-3,
    section 2.2). `covariance_form` scales it to 1 .. 0. Here it is the number of pairs of voxels in
    the phase over the number of pairs that fit.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest distance, in voxels (of the smallest edge, where edges differ), or in steps of
        `direction`.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Only pairs along this axis, r in voxels of it. Default, without `direction` too: the radial
        average, over every offset whose length rounds to r; the length is in units of the smallest
        voxel edge.
    direction : sequence of float, one per axis, optional
        Only pairs along this vector of voxels, slowest axis first: the ends of sample r are `r *
        direction` apart, a length of `r * norm(direction * spacing)`. Where that is a voxel, as
        always with whole numbers such as (1, 1, 0), that offset is used; otherwise pairs are
        interpolated linearly between the offsets around it. A direction `u` of length 1 in space,
        in steps of the smallest edge, is `u * min(spacing) / spacing`.
    periodic : bool or one per axis
        Pairs wrap around the faces.
    mask : bool array, the image's shape, optional
        Only pairs with both ends in the mask count.

    Returns
    -------
    s2 : float64 array, (r_max + 1,)
        0 .. 1; S2(0) is the fraction of the phase.

    Raises
    ------
    InputError
        r_max that does not fit the image, or a distance at which the mask holds no pair.

    Examples
    --------
    >>> two_point(np.array([[1, 1, 0, 0, 1, 1, 0, 0]]), r_max=2, axis=1, periodic=True).tolist()
    [0.5, 0.25, 0.0]
    >>> two_point(np.eye(4, dtype=int), r_max=3, direction=(1, 1)).tolist()
    [0.25, 0.3333333333333333, 0.5, 1.0]
    """
    image, inside = indicator(image, phase)
    window = as_window(image.shape, periodic, mask)
    pairs = select_pairs(image, window, r_max=r_max, axis=axis, direction=direction)
    fits = positive_fits(pairs)
    return probability(pairs.count(window.within(inside), None, fits), fits)


def cross_correlation(
    image: Image | ArrayLike,
    *,
    first: str | int,
    second: str | int,
    r_max: int,
    axis: int | None = None,
    direction: Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the two-point probability S_ij(r) across phases, r = 0 .. r_max: one end in phase i,
    the other in phase j.

    Torquato 2002, doi:10.1007/978-1-4757-6355-3, section 2.2. Both orders of the two ends are
    counted and averaged, so that S_ij = S_ji, and each probability is out of all pairs that fit:
    the sum over all i and j is 1 at every r, and the sum over j is the fraction of ends in
    phase i (phi_i, where the image is periodic). S_ii is `two_point`.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    first, second : str or int
        The phases i and j.
    r_max, axis, direction, periodic, mask
        As in `two_point`.

    Returns
    -------
    s_ij : float64 array, (r_max + 1,)
        0 .. 1; 0 at r = 0 where the phases differ; tends to phi_i phi_j.

    Raises
    ------
    InputError
        As `two_point`, and no such phase.

    Examples
    --------
    >>> stripes = np.array([[1, 1, 0, 0, 1, 1, 0, 0]])
    >>> cross_correlation(stripes, first=0, second=1, r_max=2, axis=1, periodic=True).tolist()
    [0.0, 0.25, 0.5]
    """
    image, ours = indicator(image, first)
    theirs = indicator(image, second)[1]
    window = as_window(image.shape, periodic, mask)
    pairs = select_pairs(image, window, r_max=r_max, axis=axis, direction=direction)
    fits = positive_fits(pairs)
    return probability(pairs.count(window.within(ours), window.within(theirs), fits), fits)

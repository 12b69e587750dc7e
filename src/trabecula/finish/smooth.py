"""Smooth: a phase without the roughness of its surface, at the same volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, with_values
from trabecula.finish.connect import background_of
from trabecula.finish.labels import repainted
from trabecula.measure.phases import indicator
from trabecula.measure.smooth import gaussian


def smooth(image: Image | ArrayLike, *, sigma: float, phase: str | int | None = None) -> Image:
    """Smooth the surface of a phase: a Gaussian over its indicator, cut at the level that keeps its
    volume.

    The first of the two operations of Zhang, Chen, Wang and Wang 2017, section 5.4. Struts thinner
    than about `sigma` vanish: thicken afterwards, and remove what floats.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    sigma : float
        Standard deviation in the image's unit, above 0 and at most the longest side.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.

    Returns
    -------
    image : Image
        As many voxels of the phase as before (but for voxels of one level, which come or go
        together). New voxels take the nearest label. The recipe's step holds a `report`: `added`,
        `removed` (voxels), `level` (of the cut, 0..1).

    Raises
    ------
    InputError
        The phase is empty; sigma out of range; the void of an image of several phases.

    Examples
    --------
    >>> rough = np.zeros((30, 30), int); rough[10:20] = 1; rough[9, 8] = 1; rough[10, 21] = 0
    >>> even = smooth(rough, sigma=2).values
    >>> int(even[9, 8]), int(even[10, 21])
    (0, 1)
    """
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    extent = max(side * edge for side, edge in zip(image.shape, image.spacing, strict=True))
    sigma = as_number(sigma, name="sigma", low=0, high=extent)
    if sigma == 0:
        raise InputError("sigma 0 smooths nothing: give a length above 0, in the image's unit")
    if not inside.any():
        raise InputError(
            f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing to smooth"
        )
    level = gaussian(inside, [sigma / edge for edge in image.spacing])
    # Other phases keep their place: only the phase and the background share out what is theirs.
    free = inside | (image.values == background)
    after, cut = _largest(level, free, int(np.count_nonzero(inside)))
    values = repainted(image, inside, after, background)
    report = {
        "added": np.count_nonzero(after & ~inside),
        "removed": np.count_nonzero(inside & ~after),
        "level": round(float(cut), 6),
    }
    settings = {"sigma": sigma, "phase": phase}
    recipe = image.recipe.then(
        "finish", values, operation="smooth", settings=settings, report=report
    )
    return with_values(image, values, recipe=recipe)


def _largest(level: np.ndarray, free: np.ndarray, count: int) -> tuple[np.ndarray, np.float32]:
    """The `count` free voxels of highest level, all or none of those that share the last level; and
    that level.
    """
    among = level[free]
    cut = np.partition(among, len(among) - count)[len(among) - count]
    above, reach = np.count_nonzero(among > cut), np.count_nonzero(among >= cut)
    with_last = reach - count <= count - above or above == 0
    return free & (level >= cut if with_last else level > cut), cut

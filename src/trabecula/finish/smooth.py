"""Smooth: a phase without the roughness of its surface, at the same volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.finish.labels import background_of, check_present, relabel, with_step
from trabecula.measure.phases import indicator
from trabecula.measure.smooth import gaussian


def smooth(image: Image | ArrayLike, *, sigma: float, phase: str | int | None = None) -> Image:
    """Smooth the surface of a phase: a Gaussian of its indicator, cut at the same volume.

    The first of the two operations of Zhang, Chen, Wang and Wang 2017, section 5.4. Struts thinner
    than about `sigma` vanish: thicken afterwards, and remove the floaters.

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
    check_present(bool(inside.any()), phase, "to smooth")
    level = gaussian(inside, [sigma / edge for edge in image.spacing])
    # Other phases stay as they are: voxels change between the phase and the background alone.
    free = inside | (image.values == background)
    after, cut = _cut_at_volume(level, free, int(np.count_nonzero(inside)))
    values = relabel(image, inside, after, background)
    report = {
        "added": np.count_nonzero(after & ~inside),
        "removed": np.count_nonzero(inside & ~after),
        "level": round(float(cut), 6),
    }
    return with_step(image, values, "smooth", {"sigma": sigma, "phase": phase}, report)


def _cut_at_volume(
    level: np.ndarray, free: np.ndarray, count: int
) -> tuple[np.ndarray, np.float32]:
    """Return the `count` free voxels of highest level, and the level of the last of them.

    Of the voxels that share this level all or none are taken, whichever is nearer to `count`.
    """
    among = level[free]
    cut = np.partition(among, len(among) - count)[len(among) - count]
    above, reach = np.count_nonzero(among > cut), np.count_nonzero(among >= cut)
    with_last = reach - count <= count - above or above == 0
    return free & (level >= cut if with_last else level > cut), cut

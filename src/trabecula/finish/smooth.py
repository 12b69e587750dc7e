"""Smooth: a phase without the roughness of its surface, at the same volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, check_present, relabel, with_step
from trabecula.finish.periodic import gaussian_around, periodic_setting
from trabecula.measure.phases import as_periodic, indicator


def smooth(
    image: Image | ArrayLike,
    *,
    sigma: float,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
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
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): the mean is over voxels inside it, so
        that its surface is no surface of the phase, and nothing outside of it changes.
    periodic : bool or one per axis
        The image continues at the opposite face. Default: beyond a face its last voxel is repeated.

    Returns
    -------
    image : Image
        As many voxels of the phase as before (but for voxels of one level, which come or go
        together). New voxels take the nearest label. The recipe's step holds a `report`: `added`,
        `removed` (voxels), `level` (of the cut, 0..1).

    Raises
    ------
    InputError
        The phase is empty; sigma out of range; a mask of another shape; the void of an image of
        several phases.

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
    wraps, form = as_periodic(periodic, image.ndim), as_form(mask, image.shape)
    widths = [sigma / edge for edge in image.spacing]
    # Other phases stay as they are: voxels change between the phase and the background alone.
    free = inside | (image.values == background)
    if form is None:
        level = gaussian_around(inside, widths, wraps)
    else:
        free &= form
        level = gaussian_around(inside & form, widths, wraps)
        level /= np.where(form, gaussian_around(form, widths, wraps), np.float32(1))
    check_present(bool((inside & free).any()), phase, "to smooth inside the form")
    after, cut = _cut_at_volume(level, free, int(np.count_nonzero(inside & free)))
    after |= inside & ~free
    values = relabel(image, inside, after, background, wraps)
    report = {
        "added": np.count_nonzero(after & ~inside),
        "removed": np.count_nonzero(inside & ~after),
        "level": round(float(cut), 6),
    }
    settings = {"sigma": sigma, "phase": phase, "periodic": periodic_setting(wraps)}
    return with_step(image, values, "smooth", settings, report, **form_recipe(mask))


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

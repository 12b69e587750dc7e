"""Thicken: struts that are too thin grow to a least thickness, the others stay as they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, check_present, relabel, with_step
from trabecula.finish.periodic import periodic_setting
from trabecula.finish.struts import balls, thin_cores
from trabecula.measure.phases import as_periodic, indicator

# Radius of the balls of each round, over half the thickness, in voxels. A ball of voxels is half a
# voxel wider than its radius, give or take rounding: struts that are still too thin after a round
# get a little more in the next.
_MORE = (-0.5, -0.25, 0.0, 0.25)


def thicken(
    image: Image | ArrayLike,
    *,
    thickness: float,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Grow the struts and walls of a phase to a least thickness, only where they are thinner.

    The second operation of Zhang, Chen, Wang and Wang 2017, section 5.4, which dilates everything
    alike; here balls of that diameter are put along the middle of struts that are thinner.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    thickness : float
        Least thickness in the image's unit, above 0 and at most the longest side. By rounding, a
        strut may become one and a half voxels thicker; one that is thinner by less than half a
        voxel counts as thick enough.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): nothing grows outside of it.
    periodic : bool or one per axis
        The image continues at the opposite face.

    Returns
    -------
    image : Image
        No voxel of the phase is lost, and only void is replaced. New voxels take the nearest
        label. The recipe's step holds a `report`: `added` (voxels), `thin_before`, `thin_after`
        (share of the phase in struts that are too thin, 0..1), `rounds`.

    Raises
    ------
    InputError
        The phase is empty; a thickness out of range; a mask of another shape; the void of an image
        of several phases.

    Notes
    -----
    At the surface of a form struts grow to the inside alone and may stay thinner: `thin_after`
    counts them. Pores narrower than twice the added layer close. Sharp edges of thick regions are
    no struts and stay sharp.

    Examples
    --------
    >>> wire = np.zeros((11, 11, 30), int); wire[5, 5] = 1
    >>> int(thicken(wire, thickness=5).values[:, 5, 15].sum())
    5
    """
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    extent = max(side * edge for side, edge in zip(image.shape, image.spacing, strict=True))
    thickness = as_number(thickness, name="thickness", low=0, high=extent)
    if thickness == 0:
        raise InputError("thickness 0 thickens nothing: give a length above 0, in the image's unit")
    check_present(bool(inside.any()), phase, "to thicken")
    wraps, form = as_periodic(periodic, image.ndim), as_form(mask, image.shape)
    free = image.values == background
    if form is not None:
        free &= form
    after, shares = _grow_struts(inside, free, image.spacing, thickness, wraps)
    values = relabel(image, inside, after, background, wraps)
    report = {
        "added": np.count_nonzero(after & ~inside),
        "thin_before": round(shares[0], 6),
        "thin_after": round(shares[-1], 6),
        "rounds": len(shares) - 1,
    }
    settings = {"thickness": thickness, "phase": phase, "periodic": periodic_setting(wraps)}
    return with_step(image, values, "thicken", settings, report, **form_recipe(mask))


def _grow_struts(
    inside: np.ndarray,
    free: np.ndarray,
    spacing: tuple[float, ...],
    thickness: float,
    wraps: tuple[bool, ...],
) -> tuple[np.ndarray, list[float]]:
    """Grow the thin struts of a phase into the free voxels.

    Returns the phase, and the share of thin struts before every round and at the end.
    """
    shares: list[float] = []
    for more in (*_MORE, None):
        if inside.all():
            return inside, [*shares, 0.0]
        cores = thin_cores(inside, spacing, thickness, wraps)
        shares.append(cores.share)
        if more is None or not len(cores.places):
            break
        reach = np.maximum(thickness / 2 + more * min(spacing) - cores.aside, 0)
        inside = inside | (balls(cores.places, reach, inside.shape, spacing, wraps) & free)
    return inside, shares

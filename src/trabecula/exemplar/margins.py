"""Margins that hold no material: blank planes, frames, the outside of a round field of view."""

from __future__ import annotations

from trabecula.core.image import Image
from trabecula.exemplar.crop import crop
from trabecula.measure.margins import MarginFace, Margins, find_margins, margin_note

__all__ = ["MarginFace", "Margins", "crop_margins", "find_margins", "margin_note"]


def crop_margins(image: Image) -> Image:
    """Cut off the margins that `find_margins` finds; a round field of view becomes the inscribed
    square.

    Parameters
    ----------
    image : Image
        2-D or 3-D; labels, grey or colour.

    Returns
    -------
    image : Image
        The same one where it has no margins. The crop is a step of the recipe, by its size and
        corner.

    Examples
    --------
    >>> import numpy as np
    >>> scan = np.random.default_rng(0).integers(0, 2, (40, 40, 40))
    >>> scan[:2] = 0
    >>> crop_margins(Image(scan, "labels")).shape
    (38, 40, 40)
    """
    margins = find_margins(image)
    return crop(image, margins.size, corner=margins.corner) if margins else image

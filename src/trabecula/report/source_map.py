"""Source maps: from which place of the exemplar voxels of a middle slice might have been taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values
from trabecula.measure.copying import coherent_patches, sources

SLAB = 15
"""Planes around the middle slice that are searched; neighbourhoods are 9 wide."""
SIDE = 160
"""Voxels a side of the part of a slice that is drawn, in its middle."""
PIXELS = 320
"""Of the longer side of a drawing, at least."""
_COLOURS = 4093


@dataclass(frozen=True)
class SourceMap:
    """A slice in the colours of its shifts, and the mean size of the patch of a voxel in the
    searched slab, voxels.
    """

    picture: Image
    patch: float


def source_map(exemplar: Image, image: Image) -> SourceMap | None:
    """Draw the middle slice of an image, each voxel in the colour of its source's shift.

    Where material was copied the source moves along with the voxel: a patch of one colour.
    Voxels far from any interface have no source: void is white and solid grey there.

    Parameters
    ----------
    exemplar, image : Image of labels, of one dimension
    """
    if exemplar.kind != "labels" or exemplar.ndim != image.ndim:
        return None
    box = [(side, SIDE) for side in image.shape]
    if image.ndim == 3:
        box[0] = (image.shape[0], SLAB)
    slab = tuple(
        slice(max(0, (side - most) // 2), (side - most) // 2 + most if side > most else side)
        for side, most in box
    )
    part = with_values(image, np.ascontiguousarray(image.values[slab]))
    try:
        taken = sources(exemplar, part)
        patches = coherent_patches(taken)
    except InputError:  # too small, or too plain
        return None
    shift = taken.position - np.moveaxis(np.indices(part.shape), 0, -1)
    at = part.shape[0] // 2 if part.ndim == 3 else slice(None)
    shift, counted = shift[at], taken.position[at][..., 0] >= 0
    void = part.phases.index("void") if "void" in part.phases else 0
    solid = part.values[at] != void
    colours = _colours()[(shift @ np.array([1, 61, 3721])[: shift.shape[-1]]) % _COLOURS]
    plain = np.where(solid, 205, 255)[..., None]
    pixels = np.where(
        counted[..., None], np.where(solid[..., None], colours, 128 + colours // 2), plain
    )
    enlarge = max(1, -(-PIXELS // max(pixels.shape[:2])))
    large = pixels.astype(np.uint8).repeat(enlarge, 0).repeat(enlarge, 1)
    return SourceMap(Image(large, "colour"), patches.mean)


def own_source_map(exemplar: Image) -> SourceMap | None:
    """Draw the map of one half of an exemplar, searched in its other half: real material that was
    not copied.
    """
    middle = exemplar.shape[0] // 2
    one, other = (
        with_values(exemplar, np.ascontiguousarray(values))
        for values in (exemplar.values[:middle], exemplar.values[middle:])
    )
    return source_map(other, one)


def _colours() -> np.ndarray:
    """Return clear colours, (n, 3): full hues of two brightnesses."""
    rng = np.random.default_rng(5)
    hue = rng.random(_COLOURS)[:, None] * 6 + np.array([0, 4, 2])
    wave = np.clip(np.abs(hue % 6 - 3) - 1, 0, 1)
    return (255 * (0.15 + 0.8 * wave) * rng.choice([0.6, 1.0], (_COLOURS, 1))).astype(np.int64)

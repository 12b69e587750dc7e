"""Mend contacts: places where a phase touches itself by an edge or a corner alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image, as_image
from trabecula.engine.compile import inline, kernel
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, check_present, lift, relabel, with_step
from trabecula.finish.periodic import periodic_setting
from trabecula.measure.neighbours import place_along
from trabecula.measure.phases import as_periodic, indicator


def mend_contacts(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Fill voxels until a phase touches itself by faces alone: its surface is a manifold.

    Such an image is well-composed (Latecki 1997, doi:10.1006/cviu.1997.0552): no edge of the grid
    has the phase on one diagonal and not on the other, and no corner has opposite voxels alone on
    one side. Voxels are filled where that goes wrong until it nowhere does (Siqueira, Latecki,
    Tustison, Gallier and Gee 2008, doi:10.1007/s10851-007-0054-1); of several the one that leaves
    the fewest such places, then the one with the most neighbours in the phase, then the first.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Of a picture the corners of pixels count.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): nothing is filled outside of it; where
        that is the only way a voxel is removed.
    periodic : bool or one per axis
        The image continues at the opposite face.

    Returns
    -------
    image : Image
        Only void is filled. New voxels take the nearest label. The recipe's step holds a `report`:
        `contacts` (before), `added`, `removed` (voxels), `left` (contacts that stay).

    Raises
    ------
    InputError
        The phase is empty; a mask of another shape; the void of an image of several phases.

    Notes
    -----
    What touched becomes one body: contacts between grains turn into necks.

    Examples
    --------
    >>> values = np.zeros((3, 4, 4), int); values[1, 1, 1] = values[1, 2, 2] = 1
    >>> mended = mend_contacts(values)
    >>> int(mended.values.sum()), mended.recipe.steps[-1]["report"]["contacts"]
    (3, 1)
    """
    image = as_image(image)
    background = background_of(image, phase)
    image, inside = indicator(image, phase)
    check_present(bool(inside.any()), phase, "to mend")
    wraps, form = as_periodic(periodic, image.ndim), as_form(mask, image.shape)
    # other phases stay: voxels change between the phase and the background alone
    free = inside | (image.values == background)
    if form is not None:
        free &= form
    after = inside.copy()
    volume, around = lift(after), np.array((False,) * (3 - image.ndim) + tuple(wraps))
    report = {"contacts": _count(volume, around)}
    report["added"], report["removed"] = _mend(volume, lift(free), around)
    report["left"] = _count(volume, around)
    values = relabel(image, inside, after, background, wraps)
    settings = {"phase": phase, "periodic": periodic_setting(wraps)}
    return with_step(image, values, "mend_contacts", settings, report, **form_recipe(mask))


@inline
def _at(inside, wraps, z, y, x):
    """Return whether a voxel is of the phase; those outside of the image are not."""
    k = place_along(z, inside.shape[0], wraps[0])
    j = place_along(y, inside.shape[1], wraps[1])
    i = place_along(x, inside.shape[2], wraps[2])
    return int(k >= 0 and j >= 0 and i >= 0 and inside[k, j, i])


@inline
def _contacts(inside, wraps, z, y, x):
    """Count what is wrong at the lowest corner of a voxel: three edges, and the corner.

    Every edge of the grid leaves one corner towards higher z, y or x.
    """
    code = 0
    for n in range(8):
        code |= _at(inside, wraps, z - (n >> 2 & 1), y - (n >> 1 & 1), x - (n & 1)) << n
    found = 0
    for one, other in ((1, 2), (2, 4), (1, 4)):
        a, b, c, d = code & 1, code >> one & 1, code >> other & 1, code >> (one + other) & 1
        found += a == d and b == c and a != b
    for n in range(4):
        pair = (1 << n) | (1 << (7 - n))
        found += code in (pair, 255 - pair)
    return found


@inline
def _contacts_around(inside, wraps, z, y, x):
    """Count what is wrong at the corners of a voxel."""
    found = 0
    for n in range(8):
        found += _contacts(inside, wraps, z + (n >> 2 & 1), y + (n >> 1 & 1), x + (n & 1))
    return found


@inline
def _neighbours(inside, wraps, z, y, x):
    """Count the voxels of the phase that share a face with a voxel."""
    found = 0
    for step in (-1, 1):
        found += _at(inside, wraps, z + step, y, x)
        found += _at(inside, wraps, z, y + step, x)
        found += _at(inside, wraps, z, y, x + step)
    return found


@inline
def _choose(inside, free, wraps, corner, chosen):
    """Write the voxel around a corner whose change mends most; return whether there is one.

    Voxels to fill come before those to remove.
    """
    shape = inside.shape
    for value in (1, 0):
        least, most = 1 << 30, -1
        for n in range(8):
            k = place_along(corner[0] - (n >> 2 & 1), shape[0], wraps[0])
            j = place_along(corner[1] - (n >> 1 & 1), shape[1], wraps[1])
            i = place_along(corner[2] - (n & 1), shape[2], wraps[2])
            if k < 0 or j < 0 or i < 0 or inside[k, j, i] == value or not free[k, j, i]:
                continue
            before = _contacts_around(inside, wraps, k, j, i)
            inside[k, j, i] = value
            more = _contacts_around(inside, wraps, k, j, i) - before
            inside[k, j, i] = 1 - value
            like = _neighbours(inside, wraps, k, j, i)
            like = like if value == 1 else 6 - like
            if more < least or (more == least and like > most):
                least, most = more, like
                chosen[0], chosen[1], chosen[2] = k, j, i
        if most >= 0:
            return True
    return False


@kernel
def _count(inside, wraps):
    """Count what is wrong at all corners."""
    found = 0
    for z in range(inside.shape[0] + 1 - wraps[0]):
        for y in range(inside.shape[1] + 1 - wraps[1]):
            for x in range(inside.shape[2] + 1 - wraps[2]):
                found += _contacts(inside, wraps, z, y, x)
    return found


@kernel
def _mend(inside, free, wraps):
    """Mend in place, corner after corner, and at once around every voxel that changed; return how
    many were filled and removed. A voxel that changed is no longer free, so this ends.
    """
    added = removed = 0
    chosen = np.empty(3, np.int64)
    for z in range(inside.shape[0] + 1 - wraps[0]):
        for y in range(inside.shape[1] + 1 - wraps[1]):
            for x in range(inside.shape[2] + 1 - wraps[2]):
                if _contacts(inside, wraps, z, y, x) == 0:
                    continue
                todo = [(z, y, x)]
                while len(todo):
                    corner = todo.pop()
                    k, j, i = corner
                    if _contacts(inside, wraps, k, j, i) == 0:
                        continue
                    if not _choose(inside, free, wraps, corner, chosen):
                        continue
                    k, j, i = chosen[0], chosen[1], chosen[2]
                    filled = not inside[k, j, i]
                    inside[k, j, i] = filled
                    free[k, j, i] = False
                    added += filled
                    removed += not filled
                    for n in range(8):
                        todo.append((k + (n >> 2 & 1), j + (n >> 1 & 1), i + (n & 1)))
    return added, removed

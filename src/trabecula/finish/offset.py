"""Offset: a phase with its surface moved until it has a volume fraction, its topology kept.

The surface moves voxel by voxel, and a voxel changes only where that joins nothing, breaks nothing
and neither opens nor closes a loop: simple points (Lee, Kashyap and Chu 1994). Of the voxels at the
surface those go first that stand out from the surface around them, with a part by chance that is
alike over a voxel or two: without it the surface would be smoothed, and by chance from voxel to
voxel it would be cut into teeth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.seeds import generator
from trabecula.engine.compile import kernel
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, check_present, lift, relabel, with_step
from trabecula.finish.periodic import (
    gaussian_around,
    material_origin,
    periodic_setting,
    roll_by,
)
from trabecula.measure.dilate import dilate
from trabecula.measure.phases import as_periodic, indicator
from trabecula.measure.skeleton.simple import around, euler_changes, is_simple, neighbourhood

_NEAR = 1.0  # sigma, voxels, of the share of the phase that a voxel of the surface sees
_AROUND = 4.0  # sigma, voxels, of the mean that it is held against
_CHANCE = 0.15  # of that share, standard deviation


def offset(
    image: Image | ArrayLike,
    *,
    fraction: float,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Move the surface of a phase until it has a volume fraction: no join, no break, no new loop.

    For small corrections: a porosity that is known from elsewhere, a property that is nearly met,
    or what a threshold that is a little off would change.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    fraction : float
        Of the phase in the image, or in the form that it fills, 0 .. 1.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): nothing outside of it changes.
    periodic : bool or one per axis
        The image continues at the opposite face.

    Returns
    -------
    image : Image
        The fraction is met to the voxel. Components, loops and cavities are those of before, with
        26 neighbours in the phase. New voxels take the nearest label. The recipe's step holds a
        `report`: `added`, `removed` (voxels), `layers` (rounds over the surface).

    Raises
    ------
    InputError
        The phase is empty; a fraction out of range, or one that no surface of this topology has
        (which the message names); a mask of another shape; the void of an image of several phases.

    Notes
    -----
    What lies outside of the image counts as void, so that pores that are open at a face stay open.
    Thin parts end as lines of voxels, which stay.

    Examples
    --------
    >>> wire = np.zeros((9, 9, 20), int); wire[3:6, 3:6] = 1
    >>> float(offset(wire, fraction=0.2).values.mean().round(3))
    0.2
    """
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    fraction = as_number(fraction, name="fraction", low=0, high=1)
    check_present(bool(inside.any()), phase, "to move")
    wraps, form = as_periodic(periodic, image.ndim), as_form(mask, image.shape)
    free = inside | (image.values == background)
    if form is not None:
        free &= form
    room = image.values.size if form is None else int(np.count_nonzero(form))
    held = int(np.count_nonzero(inside if form is None else inside & form))
    wanted = round(fraction * room)
    shift = material_origin(image.values, wraps)
    back = [-step for step in shift]
    after, layers = _moved(roll_by(inside, back), roll_by(free, back), wanted - held, wraps)
    after = roll_by(after, shift)
    left = wanted - held - (int(np.count_nonzero(after)) - int(np.count_nonzero(inside)))
    if left:
        raise InputError(
            f"fraction {fraction:.4g} is beyond what the surface can reach, which is "
            f"{(wanted - left) / room:.4g} where nothing joins or breaks: ask for one nearer to "
            f"{held / room:.4g}, or use smooth or thicken"
        )
    values = relabel(image, inside, after, background, wraps)
    report = {
        "added": np.count_nonzero(after & ~inside),
        "removed": np.count_nonzero(inside & ~after),
        "layers": layers,
    }
    settings = {"fraction": fraction, "phase": phase, "periodic": periodic_setting(wraps)}
    return with_step(image, values, "offset", settings, report, **form_recipe(mask))


def _moved(
    inside: np.ndarray, free: np.ndarray, change: int, wraps: Sequence[bool]
) -> tuple[np.ndarray, int]:
    """Return a phase with `change` voxels more or less, or as many as can be, and how many layers
    that took.
    """
    now, layers = inside, 0
    chance = _chance(inside.shape, wraps)
    while change:
        side = now if change < 0 else ~now
        surface = free & side & dilate(~side, wraps=wraps)
        at = np.flatnonzero(surface)
        level = _levels(now, surface, at, wraps)
        rank = chance.ravel()[at] + (level if change < 0 else -level)
        order = at[np.argsort(rank, kind="stable")]
        after, moved = _flip(now, order, abs(change), wraps)
        if not moved:
            break
        now, layers = after, layers + 1
        change -= moved if change > 0 else -moved
    return now, layers


def _chance(shape: Sequence[int], wraps: Sequence[bool]) -> np.ndarray:
    """Return a smooth random number of every voxel."""
    white = generator(0, "offset").standard_normal(shape, np.float32)
    smooth = gaussian_around(white, [_NEAR] * len(shape), wraps)
    # a Gaussian takes a standard deviation of 1 to this along every axis
    left = (2 * np.sqrt(np.pi) * _NEAR) ** -0.5
    return np.asarray(smooth * np.float32(_CHANCE / left ** len(shape)))


def _levels(
    inside: np.ndarray, surface: np.ndarray, at: np.ndarray, wraps: Sequence[bool]
) -> np.ndarray:
    """Return how much more of the phase the voxels `at` of the surface have around than the surface
    around them.
    """
    near = gaussian_around(inside, [_NEAR] * inside.ndim, wraps)
    own, widths = near.ravel()[at], [_AROUND] * inside.ndim
    near *= surface
    total = gaussian_around(near, widths, wraps).ravel()[at]
    del near
    weight = gaussian_around(surface, widths, wraps).ravel()[at]
    return np.asarray(own - total / np.maximum(weight, np.float32(1e-6)))


def _flip(
    inside: np.ndarray, order: np.ndarray, most: int, wraps: Sequence[bool]
) -> tuple[np.ndarray, int]:
    """Return a phase with up to `most` voxels changed, the first of `order` that are simple, and
    how many these are.
    """
    volume = lift(inside)
    wrap = np.array([False] * (3 - inside.ndim) + [bool(one) for one in wraps])
    state = np.pad(volume, 1)
    for axis in np.flatnonzero(wrap):
        planes = np.moveaxis(state, axis, 0)
        planes[0], planes[-1] = planes[-2], planes[1]
    state = np.ascontiguousarray(state).view(np.uint8)
    steps, sides = around(state.shape), np.array(volume.shape)
    moved = _flip_simple(state.reshape(-1), sides, wrap, order, most, steps, euler_changes())
    return state[1:-1, 1:-1, 1:-1].astype(bool).reshape(inside.shape), int(moved)


@kernel
def _flip_simple(state, sides, wrap, order, most, steps, changes):
    """Change simple voxels of a flat padded volume in this order, with their images beyond periodic
    faces; return how many.
    """
    height, width = sides[1] + 2, sides[2] + 2
    moved = 0
    for n in range(len(order)):
        if moved == most:
            break
        x = order[n] % sides[2] + 1
        y = order[n] // sides[2] % sides[1] + 1
        z = order[n] // (sides[2] * sides[1]) + 1
        at = (z * height + y) * width + x
        if not is_simple(neighbourhood(state, at, steps), changes):
            continue
        moved += 1
        value = state[at] ^ 1
        for az in (z, _image_of(z, sides[0], wrap[0])):
            for ay in (y, _image_of(y, sides[1], wrap[1])):
                for ax in (x, _image_of(x, sides[2], wrap[2])):
                    state[(az * height + ay) * width + ax] = value
    return moved


@kernel
def _image_of(at, side, wrap):
    """Return where a padded axis holds the same voxel once more; `at` where it does not."""
    if wrap and at == 1:
        return side + 1
    if wrap and at == side:
        return 0
    return at

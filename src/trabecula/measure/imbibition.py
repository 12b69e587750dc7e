"""Imbibition by morphology: the wetting fluid comes back along the walls, from small radii to large
ones.

Hilpert and Miller 2001 (doi:10.1016/S0309-1708(00)00056-7): at a radius R the non-wetting fluid
fills the opening of where it was at the beginning, by balls of R and larger; narrower throats snap
off. What is cut off from the inlet, through which the non-wetting fluid goes back, is trapped as it
is. All radii at once: the largest ball that holds each voxel (`measure.spheres`), and the widest
path of those from the inlet (`measure.flooding`); a voxel that balls of R still hold, but no path
of them joins to the inlet, is trapped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.displacement import (
    Displacement,
    Face,
    capillary_pressure,
    curve,
    find_pores,
)
from trabecula.measure.flooding import widest_paths


def imbibition(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    inlet: Face | str = (0, 0),
    start: ArrayLike | None = None,
    trapping: bool = False,
    surface_tension: float | None = None,
    contact_angle: float = 0.0,
    connectivity: int | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Displacement:
    """Displace the non-wetting fluid in a phase by a wetting one, from small radii to large ones.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase, surface_tension, contact_angle, connectivity, periodic
        As for `drainage`.
    inlet : (axis, side) or "all"
        Where the non-wetting fluid entered, and leaves now. The wetting fluid needs no way: it is
        there in films.
    start : bool array, the image's shape, optional
        Where the non-wetting fluid is at the beginning, as `drainage(...).nonwetting(radius)`.
        Default: all of the phase that is connected to the inlet.
    trapping : bool
        Non-wetting fluid that is cut off from the inlet stays.

    Returns
    -------
    displacement : Displacement
        `trapped` is the residual saturation of the non-wetting fluid.

    Raises
    ------
    InputError
        As `drainage`; a start of another shape, not boolean, empty or beyond the phase.

    Examples
    --------
    >>> bottle = np.ones((9, 12), int)
    >>> bottle[3:6, :6] = bottle[1:8, 6:11] = 0
    >>> found = imbibition(bottle, inlet=(1, 0), trapping=True)
    >>> round(found.trapped, 2)  # the neck snaps off before the body empties
    0.74
    """
    pores = find_pores(image, phase, inlet, None, connectivity, periodic)
    capillary_pressure(np.ones(1), pores.image, surface_tension, contact_angle)
    begin = pores.inside
    if start is None:
        begin = widest_paths(begin.astype(np.int32), pores.inlet, top=1, **pores.neighbours) > 0
    else:
        begin = _as_start(start, pores.image.shape, pores.inside)
    spheres = pores.spheres(begin)
    radii = pores.radii(spheres)
    rank = pores.paint(spheres.radius, spheres)
    stays = np.zeros(rank.shape, bool)
    if trapping:
        stays = widest_paths(rank, pores.inlet, top=spheres.top, **pores.neighbours) < rank
    moves, saturation = curve(pores, rank, stays, radii, rising=True)
    shape = pores.image.shape
    found = radii[rank]
    found[stays] = np.inf
    return Displacement(
        moves,
        saturation,
        capillary_pressure(moves, pores.image, surface_tension, contact_angle),
        float(saturation[-1]),
        found.reshape(shape),
        stays.reshape(shape),
    )


def _as_start(start: ArrayLike, shape: tuple[int, ...], inside: np.ndarray) -> np.ndarray:
    """Return where the non-wetting fluid is at the beginning, (Z, Y, X) bool."""
    array = np.asarray(start)
    if array.dtype != bool or array.shape != shape:
        raise InputError(
            f"start is {array.dtype} of shape {array.shape}: a boolean array of shape {shape} is "
            "needed"
        )
    lifted = np.ascontiguousarray(array.reshape(inside.shape))
    if not lifted.any() or bool((lifted & ~inside).any()):
        raise InputError("start is empty, or beyond the phase: mark voxels of the phase")
    return lifted

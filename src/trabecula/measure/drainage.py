"""Drainage by morphology: a non-wetting fluid enters through throats that let its menisci pass.

Hazlett 1995 (Transport in Porous Media 20, 21-35), Hilpert and Miller 2001
(doi:10.1016/S0309-1708(00)00056-7): at a radius R the phase is eroded by a ball of R, what is
connected to the inlet is kept, and dilated by the ball again; the fluid does not go back. Here all
radii are done at once, exactly:

1. the distance of every voxel of the phase to the rest: the largest ball about it;
2. the widest path from the inlet to every voxel: the largest ball that gets there
   (`measure.flooding`);
3. those balls are painted from the largest down, as for the local thickness (`measure.spheres`);
4. with trapping, the widest path in reverse: from the outlet to every voxel the path that stays
   open longest. A voxel whose every path closes before it is invaded itself keeps its fluid (the
   rule of Wilkinson and Willemsen 1983, doi:10.1088/0305-4470/16/14/028).
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
    Pores,
    capillary_pressure,
    curve,
    find_pores,
)
from trabecula.measure.flooding import widest_paths
from trabecula.measure.phases import as_connectivity, indicator
from trabecula.measure.spheres import inscribed_spheres


def drainage(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    inlet: Face | str = (0, 0),
    outlet: Face | str | None = None,
    trapping: bool = False,
    surface_tension: float | None = None,
    contact_angle: float = 0.0,
    connectivity: int | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Displacement:
    """Displace the wetting fluid in a phase by a non-wetting one, from large radii to small ones.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        What holds the fluids. Default: "void".
    inlet : (axis, side) or "all"
        Where the non-wetting fluid enters; side 0 is the first layer along the axis, -1 the last.
        "all" faces: as a porosimeter does, by mercury.
    outlet : (axis, side) or "all", optional
        Where the wetting fluid leaves; "all" faces but the inlet. Default: the face opposite to the
        inlet, none where all faces are the inlet.
    trapping : bool
        Wetting fluid whose every path to the outlet is invaded stays. Without, it leaves by films
        along the walls (or is a vacuum).
    surface_tension : float, optional
        Between the fluids, N/m: gives the pressure.
    contact_angle : float
        Degrees, in either fluid; it scales the pressure and does not change the shape of menisci.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours that fluids move between. Default: those that share a face.
    periodic : bool or one per axis
        Balls and paths wrap around the faces; never along the axis of inlet or outlet.

    Returns
    -------
    displacement : Displacement
        A radius is the distance from a voxel's centre to that of the nearest voxel of the rest.
        Necks of round tubes come out .1 to .25 voxels too small on average along an axis, .1 to .6
        in other directions (.1 to .4 with connectivity=26, which also joins voxels by an edge or a
        corner alone), plates a quarter too large. The faces of the image are no walls.

    Raises
    ------
    InputError
        The phase is empty, fills the image or does not reach the inlet; a face that does not exist;
        trapping without an outlet; a tension that is not positive, or in an image without a unit.

    Examples
    --------
    >>> bottle = np.ones((9, 12), int)
    >>> bottle[3:6, :6] = bottle[1:8, 6:11] = 0
    >>> found = drainage(bottle, inlet=(1, 0))  # a neck 3 wide before a body 7 wide
    >>> found.radii.tolist(), found.saturation.round(2).tolist()
    ([2.0], [1.0])
    """
    pores = find_pores(image, phase, inlet, outlet, connectivity, periodic)
    if trapping and pores.outlet is None:
        raise InputError(
            "trapping needs an outlet, and all faces are the inlet: name one, or leave out trapping"
        )
    capillary_pressure(np.ones(1), pores.image, surface_tension, contact_angle)
    spheres = pores.spheres(pores.inside)
    radii = pores.radii(spheres)
    passing = widest_paths(
        spheres.rank(spheres.radius), pores.inlet, top=spheres.top, **pores.neighbours
    )
    entry = None
    if pores.outlet is not None:
        entry = float(radii[passing[pores.outlet].max()])
    rank = pores.paint(spheres.levels[passing], spheres)
    del passing
    lost = np.zeros(rank.shape, bool)
    if trapping and pores.outlet is not None:
        lost = _trapped(pores, rank, pores.outlet, top=spheres.top)
        rank[lost] = 0
    moves, saturation = curve(pores, rank, np.zeros(rank.shape, bool), radii, rising=False)
    shape = pores.image.shape
    return Displacement(
        moves,
        saturation,
        capillary_pressure(moves, pores.image, surface_tension, contact_angle),
        int(np.count_nonzero(lost)) / int(np.count_nonzero(pores.inside)),
        radii[rank].reshape(shape),
        lost.reshape(shape),
        entry,
    )


def entry_radius(
    image: Image | ArrayLike, *, phase: str | int | None = None
) -> dict[str, float | None]:
    """Return, for every axis, the radius of the largest ball that passes through a phase from end
    face to end face, in the image's unit: where drainage along that axis breaks through.

    See `drainage` for the definition; here nothing but the widest path is sought, in a tenth of
    the time.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "void".

    Returns
    -------
    radii : dict
        By axis; 0.0 where the phase does not percolate.

    Raises
    ------
    InputError
        No such phase, or one that fills the image.

    Examples
    --------
    >>> entry_radius(np.pad(np.zeros((3, 4), int), ((0, 0), (1, 1)), constant_values=1))
    {'y': 2.0, 'x': 0.0}
    """
    image, inside = indicator(image, phase, default="void")
    if inside.all():
        raise InputError(
            "the phase fills the whole image: its balls have no bound; choose another one"
        )
    steps = np.array(image.spacing) / min(image.spacing)
    lift = 3 - image.ndim
    lifted = np.ascontiguousarray(inside.reshape((1,) * lift + image.shape))
    wraps = (False,) * 3
    spheres = inscribed_spheres(lifted, np.array([steps.max()] * lift + steps.tolist()), wraps)
    rank = spheres.rank(spheres.radius)
    connectivity = as_connectivity(None, image.ndim)
    found: dict[str, float | None] = {}
    for axis, name in enumerate("zyx"[lift:], lift):
        start = np.zeros(lifted.shape, bool)
        np.moveaxis(start, axis, 0)[0] = True
        best = widest_paths(
            rank, start, top=spheres.top, connectivity=connectivity, wraps=wraps
        ).take(-1, axis=axis)
        found[name] = float(spheres.levels[best.max()]) * min(image.spacing)
    return found


def _trapped(pores: Pores, rank: np.ndarray, outlet: np.ndarray, *, top: int) -> np.ndarray:
    """Return the voxels whose last path to the outlet is invaded at a larger radius than they."""
    # Turned round, the path whose first invasion comes last is a widest path.
    stays = np.where(pores.inside, np.int32(top + 1) - rank, np.int32(0))
    escape = widest_paths(stays, outlet, top=top + 1, **pores.neighbours)
    return (rank > 0) & (escape < stays)

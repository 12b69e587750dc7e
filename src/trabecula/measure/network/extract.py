"""`network`: pores and throats of a phase.

1. The phase is cut at its necks (`measure.partition`): a region is a pore, an interface a throat.
2. Every throat's section is measured: area, perimeter, radius.
3. Conductances, from centre to centre: along the widest path from the throat to the pore's peak,
   the section grows with the distance to the wall (`_profile`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.measure.network.pore_network import PoreNetwork, Throats
from trabecula.measure.partition import (
    REACH,
    SMOOTHING,
    Interfaces,
    Partition,
    cut_phase,
    find_interfaces,
    measure_shapes,
)
from trabecula.measure.partition.partition import PEAK, STEPS
from trabecula.measure.phases import indicator

_TO_WALL = 0.25
"""Edges between the distance to the next voxel's centre and that to the wall, on the mean of voids
of odd and even width, as for `local_thickness`."""

_ALPHA = 0.6  # Dong and Blunt 2009

# Shape factors of an equilateral triangle, a square and a circle, and the conductance of each over
# G A^2 / length (Patzek and Silin 2001, doi:10.1006/jcis.2000.7413).
_SHAPES = np.array([3**0.5 / 36, 1 / 16, 1 / (4 * np.pi)])
_FACTORS = np.array([0.6, 0.5623, 0.5])


def network(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    periodic: bool | Sequence[bool] = False,
    smoothing: float = SMOOTHING,
    reach: float = REACH,
) -> PoreNetwork:
    """Extract the pore network of a phase: pores, throats, and how well these conduct.

    Gostick 2017 (SNOW, doi:10.1103/PhysRevE.96.023307): peaks of the smoothed distance map, without
    those on saddles and those nearer to a higher one than that is to the wall, are pores, and a
    watershed from them cuts the phase at its necks. The same on any number of threads.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        Default: "void".
    periodic : bool or one per axis
        Distances, pores and throats wrap around the faces.
    smoothing : float, 0 .. 10
        Standard deviation of the Gaussian on the distance map, in smallest voxel edges.
    reach : float, 1 .. 50
        A peak is the highest voxel of its component within so many smallest edges.

    Returns
    -------
    network : PoreNetwork

    Raises
    ------
    InputError
        A 2-D image, no such phase, one that is empty or fills the image, a side of one voxel.

    Notes
    -----
    Conductance of a throat: k G A^2 / length for a straight duct of area A and shape factor G
    (Patzek and Silin 2001, doi:10.1006/jcis.2000.7413: k is .6 for triangles, .5623 for squares, .5
    for circles). From the throat to a pore's centre the section widens: the mean of (r_throat /
    r)^4 along the widest path takes the place of 1, and of (r_throat / r)^2 for diffusion, where r
    is the distance to the wall: the theory of lubrication.

    Examples
    --------
    >>> two = np.ones((9, 9, 20), int)
    >>> two[1:8, 1:8, 1:8] = two[1:8, 1:8, 11:18] = two[3:6, 3:6, 8:11] = 0
    >>> found = network(two)
    >>> len(found), found.throats.pores.tolist(), found.throats.area.tolist()
    (2, [[0, 1]], [9.0])
    """
    image, inside = indicator(image, phase, default="void")
    cut = cut_phase(
        image, inside, periodic, smoothing=smoothing, reach=reach, name="a pore network"
    )
    scale = min(image.spacing)
    found = find_interfaces(cut)
    shapes = measure_shapes(cut)
    peaks = cut.peaks * cut.steps
    radius = cut.distance[tuple(cut.peaks.T)].astype(np.float64) - _TO_WALL
    between = found.second >= 0
    touches = np.zeros((cut.count, 6), bool)
    touches[found.first[~between], -1 - found.second[~between]] = True
    throats = _throats(cut, found, peaks, radius, scale)
    return PoreNetwork(
        centres=peaks * scale,
        centroids=shapes.centroid * scale,
        radius=radius * scale,
        volume=shapes.volume * scale**3,
        surface=shapes.surface * scale**2,
        touches=touches,
        throats=throats.rows(between),
        openings=throats.rows(~between),
        regions=cut.labels,
        shape=image.shape,
        spacing=image.spacing,
        unit=image.unit,
        periodic=cut.wraps,
    )


def coordination(image: Image | ArrayLike, *, phase: str | int | None = None) -> float | None:
    """Return the mean number of throats of the pores that no face of the image cuts; None where
    each is cut.

    Parameters
    ----------
    image, phase
        As for `network`.

    Raises
    ------
    InputError
        As `network`.
    """
    net = network(image, phase=phase)
    return float(net.coordination[net.inside].mean()) if net.inside.any() else None


def throat_radius(image: Image | ArrayLike, *, phase: str | int | None = None) -> float | None:
    """Return the mean radius of the throats between pores, in the image's unit; None without any.

    Parameters
    ----------
    image, phase
        As for `network`.

    Raises
    ------
    InputError
        As `network`.
    """
    radius = network(image, phase=phase).throats.radius
    return float(radius.mean()) if len(radius) else None


def _throats(
    cut: Partition, found: Interfaces, peaks: np.ndarray, radius: np.ndarray, scale: float
) -> Throats:
    """Return all interfaces as throats, openings among them."""
    between = found.second >= 0
    second = np.where(between, found.second, found.first)
    throat = found.radius - _TO_WALL
    sides = np.array(cut.labels.shape) * cut.steps
    ends = (peaks[found.first], peaks[second] + found.shift * sides)
    lengths = [np.maximum(np.linalg.norm(end - found.centre, axis=1), 0.5) for end in ends]
    lengths[1][~between] = 0.0
    # a curved interface can cancel out, but a ball of half an edge less passes for sure
    least = np.pi * (found.radius - 0.5) ** 2
    area = np.maximum(found.area, least)
    rim = np.maximum(found.perimeter, 2 * np.sqrt(np.pi * area))
    shape = area / rim**2
    straight = np.interp(shape, _SHAPES, _FACTORS) * shape * area**2
    flow, diffusion = np.zeros(len(area)), np.zeros(len(area))
    for side in (0, 1):
        wide, wider = _profile(
            cut.distance.ravel(),
            cut.ways.ravel(),
            np.array(cut.labels.shape),
            STEPS,
            found.start[:, side],
            throat,
        )
        flow += lengths[side] * wider / straight
        diffusion += lengths[side] * wide / area
    narrow = [
        length * (1 - _ALPHA * np.minimum(1.0, throat / radius[pore]))
        for length, pore in zip(lengths, (found.first, second), strict=True)
    ]
    middle = lengths[0] + lengths[1] - narrow[0] - narrow[1]
    return Throats(
        pores=np.stack([found.first, np.where(between, found.second, -1)], axis=1),
        face=np.where(between, -1, -1 - found.second),
        shift=found.shift,
        centre=found.centre * scale,
        radius=throat * scale,
        area=area * scale**2,
        perimeter=rim * scale,
        shape_factor=shape,
        conduits=np.stack([narrow[0], middle, narrow[1]], axis=1) * scale,
        flow=scale**3 / flow,
        diffusion=scale / diffusion,
    )


@kernel
def _profile(distance, ways, sides, steps, start, radius):
    """Return, for every throat, the mean of (radius / r)^2 and of its square along the way from a
    voxel to its peak, r the distance to the wall there; 0 where there is no voxel.
    """
    wide, wider = np.zeros(len(start)), np.zeros(len(start))
    for t in range(len(start)):
        voxel = start[t]
        if voxel < 0:
            continue
        z = voxel // (sides[1] * sides[2])
        y = voxel // sides[2] % sides[1]
        x = voxel % sides[2]
        count = 0
        while True:
            voxel = (z * sides[1] + y) * sides[2] + x
            share = min(1.0, (radius[t] / (distance[voxel] - _TO_WALL)) ** 2)
            wide[t] += share
            wider[t] += share * share
            count += 1
            way = ways[voxel]
            if way == PEAK:
                break
            z = (z + steps[way, 0]) % sides[0]
            y = (y + steps[way, 1]) % sides[1]
            x = (x + steps[way, 2]) % sides[2]
        wide[t] /= count
        wider[t] /= count
    return wide, wider

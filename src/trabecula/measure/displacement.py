"""One fluid displaces another: the result, the faces where fluids come and go, capillary pressure.

Both fluids follow from balls: at a radius R the non-wetting fluid is where balls of R are, and its
capillary pressure is that of a meniscus of radius R. See `measure.drainage` and
`measure.imbibition`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.io.units import to_metres
from trabecula.measure.phases import as_axis, as_connectivity, as_periodic, indicator
from trabecula.measure.spheres import Spheres, inscribed_spheres, paint_largest

Face = tuple[int, int]
"""Axis and side: 0 the first layer along it, -1 the last."""


@dataclass(frozen=True)
class Displacement:
    """A non-wetting and a wetting fluid in a phase, radius by radius.

    Parameters
    ----------
    radii : float array, (n,)
        Every radius at which a fluid moves, in the image's unit and in the order of the process:
        falling in drainage, rising in imbibition, whose last is infinite (no pressure is left).
    saturation : float array, (n,)
        Share of the phase's voxels that hold the non-wetting fluid at each radius, 0..1.
    pressure : float array, (n,), or None
        Capillary pressure at each radius in Pa, where a surface tension was given.
    trapped : float
        Share of the phase's voxels whose fluid is trapped at the end: the wetting fluid in
        drainage, the non-wetting one in imbibition.
    radius_map : float32 array, the image's shape
        Largest radius at which a voxel holds the non-wetting fluid, in the image's unit; 0 where it
        never does, infinite where it stays for ever.
    trapped_map : bool array, the image's shape
        The voxels of `trapped`.
    entry_radius : float or None
        Drainage: radius of the largest ball that passes from inlet to outlet, at which the
        non-wetting fluid breaks through; 0.0 where none does, None without an outlet.
    """

    radii: np.ndarray
    saturation: np.ndarray
    pressure: np.ndarray | None
    trapped: float
    radius_map: np.ndarray
    trapped_map: np.ndarray
    entry_radius: float | None = None

    __repr__ = brief

    def nonwetting(self, radius: float) -> np.ndarray:
        """Return where the non-wetting fluid is at a radius (above 0), a bool array of the image's
        shape.
        """
        if not radius > 0:
            raise InputError(
                f"radius {quote(radius)} must be positive: give one in the image's unit"
            )
        return self.radius_map >= np.float32(radius)


class Neighbours(TypedDict):
    """Arguments of `flooding.widest_paths`."""

    connectivity: int
    wraps: tuple[bool, ...]


@dataclass(frozen=True)
class Pores:
    """The phase that holds the fluids, as (Z, Y, X), and how its voxels are neighbours."""

    image: Image
    inside: np.ndarray
    steps: np.ndarray
    """Edges of a voxel, (3,), in units of the smallest."""
    wraps: tuple[bool, ...]
    connectivity: int
    inlet: np.ndarray
    outlet: np.ndarray | None

    @property
    def neighbours(self) -> Neighbours:
        """Return the steps that paths take."""
        return {"connectivity": self.connectivity, "wraps": self.wraps}

    @property
    def scale(self) -> float:
        """Return the smallest edge of a voxel."""
        return min(self.image.spacing)

    def spheres(self, region: np.ndarray) -> Spheres:
        """Return the largest ball in `region`, (Z, Y, X) bool, about each of its voxels."""
        return inscribed_spheres(region, self.steps, self.wraps)

    def radii(self, spheres: Spheres) -> np.ndarray:
        """Return the radius of every rank in the image's unit, float32; 0 for rank 0."""
        return spheres.levels * np.float32(self.scale)

    def paint(self, radius: np.ndarray, spheres: Spheres) -> np.ndarray:
        """Return the rank of the largest ball that holds each voxel, of balls about voxels."""
        if not radius.any():
            return np.zeros(radius.shape, np.int32)
        return spheres.rank(paint_largest(radius, self.steps, self.wraps) / np.float32(2))


def find_pores(
    image: Image | ArrayLike,
    phase: str | int | None,
    inlet: Face | str,
    outlet: Face | str | None,
    connectivity: int | None,
    periodic: bool | Sequence[bool],
) -> Pores:
    """Check what a displacement is given, and return it for its kernels; see `drainage`."""
    image, inside = indicator(image, phase, default="void")
    neighbours = as_connectivity(connectivity, image.ndim)
    what = "void" if phase is None else f"phase {quote(phase)}"
    if not inside.any():
        raise InputError(f"the {what} is empty: no fluid fits in; choose another phase")
    if inside.all():
        raise InputError(
            f"the {what} fills the whole image: its balls have no bound; choose another phase"
        )
    enters = _as_face(inlet, image.ndim, name="inlet")
    leaves: Face | str | None
    if outlet is None:
        leaves = None if isinstance(enters, str) else (enters[0], -1 - enters[1])
    else:
        leaves = _as_face(outlet, image.ndim, name="outlet")
        if isinstance(enters, str):
            raise InputError(
                f"outlet {quote(outlet)} while all faces are the inlet: name one face as the inlet"
            )
        if leaves == enters:
            raise InputError(f"inlet and outlet are both {quote(inlet)}: give two faces")
    ends = {face[0] for face in (enters, leaves) if isinstance(face, tuple)}
    wraps = tuple(
        wrap and axis not in ends for axis, wrap in enumerate(as_periodic(periodic, image.ndim))
    )
    lift = 3 - image.ndim
    steps = [edge / min(image.spacing) for edge in image.spacing]
    entry = _layers(enters, image.shape, wraps)
    exits = None if leaves is None else _layers(leaves, image.shape, wraps)
    if exits is not None and isinstance(leaves, str):
        exits &= ~entry
    if not (inside & entry).any():
        raise InputError(
            f"the {what} does not reach the inlet {quote(inlet)}: give another face, or 'all'"
        )

    def lifted(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array.reshape((1,) * lift + image.shape))

    return Pores(
        image,
        lifted(inside),
        np.array([max(steps)] * lift + steps),
        (False,) * lift + wraps,
        neighbours,
        lifted(entry),
        None if exits is None else lifted(exits),
    )


def _as_face(face: Face | str, ndim: int, *, name: str) -> Face | str:
    """Return a face as axis and side, or "all"."""
    if isinstance(face, str) and face == "all":
        return face
    if not (isinstance(face, (tuple, list)) and len(face) == 2) or face[1] not in (0, -1):
        raise InputError(
            f"{name} {quote(face)} is no face: give (axis, 0) for the first layer along an axis, "
            "(axis, -1) for the last, or 'all'"
        )
    return as_axis(face[0], ndim), int(face[1])


def _layers(face: Face | str, shape: tuple[int, ...], wraps: tuple[bool, ...]) -> np.ndarray:
    """Return the voxels of a face; of all of them those that do not wrap."""
    found = np.zeros(shape, bool)
    faces = (
        [face]
        if isinstance(face, tuple)
        else [(axis, side) for axis, wrap in enumerate(wraps) if not wrap for side in (0, -1)]
    )
    if not faces:
        raise InputError("every axis is periodic: no face is left for 'all'; name one")
    for axis, side in faces:
        np.moveaxis(found, axis, 0)[side] = True
    return found


def capillary_pressure(
    radii: np.ndarray, image: Image, surface_tension: float | None, contact_angle: float
) -> np.ndarray | None:
    """Return the pressure over menisci by Young and Laplace, in Pa: 2 sigma |cos theta| / R, and
    sigma |cos theta| / R in 2-D, where an image is a section of slits; None without a tension.

    The angle may be in either fluid, since one is 180 degrees less the other.
    """
    angle = as_number(contact_angle, name="contact_angle", low=0, high=180)
    if surface_tension is None:
        return None
    tension = as_number(surface_tension, name="surface_tension", low=0, high=1e3)
    if tension == 0:
        raise InputError("surface_tension=0 has no meniscus: give N/m, .072 for water and air")
    if math.isclose(angle, 90):
        raise InputError("contact_angle=90 wets neither fluid: give another angle")
    factor = (image.ndim - 1) * tension * abs(math.cos(math.radians(angle)))
    return factor / (radii * to_metres(image.unit))


def curve(
    pores: Pores, rank: np.ndarray, stays: np.ndarray, radii: np.ndarray, *, rising: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the radii at which voxels change, and the saturation at each.

    Parameters
    ----------
    rank : int32 array, (Z, Y, X)
        The largest radius at which a voxel holds the non-wetting fluid, 0 for never.
    stays : bool array, (Z, Y, X)
        Voxels that hold it whatever the radius.
    radii : float32 array
        Of every rank.
    rising : bool
        The order, with an infinite radius at the end.
    """
    counts = np.bincount(rank[~stays], minlength=len(radii))
    counts[0] = 0
    kept = int(np.count_nonzero(stays))
    above = np.cumsum(counts[::-1])[::-1] + kept
    moves = np.flatnonzero(counts)
    total = int(np.count_nonzero(pores.inside))
    found, saturation = radii[moves].astype(np.float64), above[moves] / total
    if rising:
        return np.append(found, np.inf), np.append(saturation, kept / total)
    return found[::-1], saturation[::-1]

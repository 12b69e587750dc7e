"""Bodies of a phase - grains, particles, cells: sizes, shapes, directions and contacts.

Bodies that touch are cut apart at their necks, as pores are (`measure.partition`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import check_type
from trabecula.core.image import Image
from trabecula.io.networks import write_tables
from trabecula.io.units import has_length, to_metres
from trabecula.measure.partition import (
    REACH,
    SMOOTHING,
    cut_phase,
    find_interfaces,
    measure_shapes,
)
from trabecula.measure.phases import indicator


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of a phase and their contacts; N bodies, C contacts. Lengths are in the image's unit,
    axes are (z, y, x), and places are those of voxel centres times the spacing.
    """

    volume: np.ndarray
    """(N,)"""
    surface: np.ndarray
    """(N,) area of the whole boundary, contacts included (Crofton's formula, 13 directions)."""
    centroid: np.ndarray
    """(N, 3)"""
    axes: np.ndarray
    """(N, 3) of the ellipsoid with the same second moments, whole lengths, the longest first."""
    directions: np.ndarray
    """(N, 3, 3) unit vectors of these axes, one a row, first component positive."""
    inscribed_radius: np.ndarray
    """(N,) of the largest ball inside, less a quarter of an edge."""
    touches: np.ndarray
    """(N, 6) bool: the faces of the image that cut the body, 2 axis + side."""
    contacts: np.ndarray
    """(C, 2) int64: the bodies that touch, from 0."""
    contact_area: np.ndarray
    """(C,) of the flat section that has the contact's rim."""
    contact_direction: np.ndarray
    """(C, 3) unit vector across the contact, from the first body to the second."""
    regions: np.ndarray
    """(Z, Y, X) int32: the body of every voxel, from 1; 0 outside."""
    unit: str

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.volume)

    @property
    def equivalent_diameter(self) -> np.ndarray:
        """Return the diameter of a ball of every body's volume, (N,)."""
        return np.asarray(np.cbrt(6 * self.volume / np.pi))

    @property
    def sphericity(self) -> np.ndarray:
        """Return the surface of a ball of every body's volume over its own, (N,): 1 for a ball
        (Wadell 1935, doi:10.1086/624298). Bodies of few voxels may exceed it.
        """
        return np.asarray(np.pi ** (1 / 3) * (6 * self.volume) ** (2 / 3) / self.surface)

    @property
    def elongation(self) -> np.ndarray:
        """Return the middle axis over the longest, (N,)."""
        return np.asarray(self.axes[:, 1] / self.axes[:, 0])

    @property
    def flatness(self) -> np.ndarray:
        """Return the shortest axis over the middle one, (N,)."""
        return np.asarray(self.axes[:, 2] / self.axes[:, 1])

    @property
    def coordination(self) -> np.ndarray:
        """Return the number of bodies that every body touches, (N,) int64; one that touches another
        twice, across periods, counts twice.
        """
        return np.bincount(self.contacts.ravel(), minlength=len(self))

    @property
    def inside(self) -> np.ndarray:
        """Return the bodies that no face of the image cuts, (N,) bool: those to size."""
        return np.asarray(~self.touches.any(axis=1))

    @property
    def orientation(self) -> np.ndarray:
        """Return the orientation tensor of the longest axes, (3, 3): the mean of n n' over the
        bodies that no face cuts, weighted with their volumes; a third of the identity where they
        point anywhere (Advani and Tucker 1987, doi:10.1122/1.549945).
        """
        kept = self.inside if self.inside.any() else np.ones(len(self), bool)
        longest, weight = self.directions[kept, 0], self.volume[kept]
        return np.asarray(np.einsum("n,ni,nj->ij", weight, longest, longest) / weight.sum())

    def summary(self) -> dict[str, Any]:
        """Return the figures of the bodies as plain values: means over those that no face cuts (all
        where each is cut).
        """
        kept = self.inside if self.inside.any() else np.ones(len(self), bool)
        names = ("equivalent_diameter", "sphericity", "elongation", "flatness", "coordination")
        found: dict[str, Any] = {
            "bodies": len(self),
            "inside": int(self.inside.sum()),
            "contacts": len(self.contacts),
            **{name: float(getattr(self, name)[kept].mean()) for name in names},
        }
        diameters = self.equivalent_diameter[kept]
        found["diameter_quantiles"] = {
            f"{q:.0%}": float(np.quantile(diameters, q)) for q in (0.1, 0.5, 0.9)
        }
        mean_area = float(self.contact_area.mean()) if len(self.contacts) else None
        return found | {"contact_area": mean_area, "orientation": self.orientation.tolist()}

    def tables(self) -> dict[str, np.ndarray]:
        """Return the bodies as named columns in metres (voxels without a unit), places and
        directions as (x, y, z); contacts between a body and its own image are left out.
        """
        unit = to_metres(self.unit) if has_length(self.unit) else 1.0
        two = self.contacts[:, 0] != self.contacts[:, 1]
        found = {
            "body.coords": self.centroid[:, ::-1] * unit,
            "body.volume": self.volume * unit**3,
            "body.surface_area": self.surface * unit**2,
            "body.equivalent_diameter": self.equivalent_diameter * unit,
            "body.inscribed_diameter": 2 * self.inscribed_radius * unit,
            "body.sphericity": self.sphericity,
            "body.axes": self.axes * unit,
            "body.elongation": self.elongation,
            "body.flatness": self.flatness,
            "body.longest_axis": self.directions[:, 0, ::-1],
            "body.coordination": self.coordination,
            "body.region_label": np.arange(1, len(self) + 1),
            "body.cut": ~self.inside,
            "contact.conns": self.contacts[two],
            "contact.area": self.contact_area[two] * unit**2,
            "contact.direction": self.contact_direction[two][:, ::-1],
        }
        return found

    def write(self, path: str | PathLike[str]) -> list[Path]:
        """Write the bodies; the suffix chooses: .npz, .csv, .json, or .vtp for ParaView (bodies as
        points, contacts as lines).

        Returns
        -------
        paths : list of Path

        Raises
        ------
        UnknownNameError, InputError
            Another suffix; .dat, which is of pores.
        FileError
            The place cannot be written.
        """
        return write_tables(self.tables(), path)


def bodies(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    separate: bool = True,
    periodic: bool | Sequence[bool] = False,
    smoothing: float = SMOOTHING,
    reach: float = REACH,
) -> Bodies:
    """Measure the bodies of a phase: grains of a rock, particles of an electrode, cells of a foam.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    separate : bool
        Cut bodies that touch apart at their necks, as `network` does pores: a watershed of the
        distance map (Gostick 2017, doi:10.1103/PhysRevE.96.023307). Without, every connected
        component (of shared faces) is one body.
    periodic : bool or one per axis
        Bodies wrap around the faces.
    smoothing, reach : float
        As for `network`.

    Returns
    -------
    bodies : Bodies

    Raises
    ------
    InputError
        As `network`.

    Examples
    --------
    >>> z, y, x = np.ogrid[:21, :21, :40]
    >>> balls = ((z - 10) ** 2 + (y - 10) ** 2 + np.minimum(abs(x - 11), abs(x - 28)) ** 2) < 81
    >>> found = bodies(balls.astype(np.uint8))
    >>> len(found), found.contacts.tolist(), found.coordination.tolist()
    (2, [[0, 1]], [1, 1])
    """
    check_type(separate, bool, name="separate", advice="give True or False")
    image, inside = indicator(image, phase)
    cut = cut_phase(
        image,
        inside,
        periodic,
        smoothing=smoothing,
        reach=reach if separate else None,
        name="a table of bodies",
    )
    scale = min(image.spacing)
    found = find_interfaces(cut)
    shapes = measure_shapes(cut)
    values, vectors = np.linalg.eigh(shapes.covariance)
    directions = np.swapaxes(vectors, 1, 2)[:, ::-1]
    lead = np.take_along_axis(
        directions, np.argmax(np.abs(directions) > 1e-9, axis=2)[..., None], axis=2
    )
    touching = found.second >= 0
    touches = np.zeros((cut.count, 6), bool)
    touches[found.first[~touching], -1 - found.second[~touching]] = True
    return Bodies(
        volume=shapes.volume * scale**3,
        surface=shapes.surface * scale**2,
        centroid=shapes.centroid * scale,
        axes=2 * np.sqrt(5 * np.maximum(values[:, ::-1], 0.0)) * scale,
        directions=directions * np.where(lead < 0, -1.0, 1.0) + 0.0,
        inscribed_radius=(cut.distance[tuple(cut.peaks.T)] - 0.25) * scale,
        touches=touches,
        contacts=np.stack([found.first, found.second], axis=1)[touching],
        contact_area=found.area[touching] * scale**2,
        contact_direction=found.normal[touching],
        regions=cut.labels,
        unit=image.unit,
    )

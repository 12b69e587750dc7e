"""`PoreNetwork`: pores and throats as tables, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.brief import brief
from trabecula.io.networks import write_tables
from trabecula.measure.network.solve import effective
from trabecula.measure.network.tables import openpnm_tables
from trabecula.measure.phases import as_axis
from trabecula.measure.transport.result import Effective


@dataclass(frozen=True, eq=False)
class Throats:
    """Where pores meet each other, or are cut by a face of the image; T throats.

    Lengths are in the image's unit, axes are (z, y, x), and places are those of voxel centres times
    the spacing.
    """

    pores: np.ndarray
    """(T, 2) int64: the pores at either side, from 0; -1 beyond a face of the image."""
    face: np.ndarray
    """(T,) int64: the face of the image, 2 axis + side; -1 between pores."""
    shift: np.ndarray
    """(T, 3) int64: the periods by which the second pore is moved to meet the first."""
    centre: np.ndarray
    """(T, 3) mean of the throat's faces of voxels, beside the first pore."""
    radius: np.ndarray
    """(T,) of the largest sphere that is centred on the throat, less a quarter of an edge."""
    area: np.ndarray
    """(T,) of its section."""
    perimeter: np.ndarray
    """(T,) of its section."""
    shape_factor: np.ndarray
    """(T,) G = A / P^2: 1 / (4 pi) for a circle, the most there can be, .0625 for a square."""
    conduits: np.ndarray
    """(T, 3) lengths of the first pore's part, of the throat and of the second pore's part: Dong
    and Blunt 2009 (doi:10.1103/PhysRevE.80.036307) with alpha = .6."""
    flow: np.ndarray
    """(T,) conductance from centre to centre times the viscosity, length^3."""
    diffusion: np.ndarray
    """(T,) conductance from centre to centre over the diffusivity, length."""

    __repr__ = brief

    @property
    def length(self) -> np.ndarray:
        """Return the total lengths, from the first pore's centre over the throat's to the second
        pore's, (T,).
        """
        return np.asarray(self.conduits.sum(axis=1))

    def rows(self, which: np.ndarray) -> Throats:
        """Return the throats at some places, or where `which` is True."""
        return Throats(**{name: value[which] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.area)


@dataclass(frozen=True, eq=False)
class PoreNetwork:
    """Pores and throats of a phase; N pores. Lengths are in the image's unit, axes are (z, y, x),
    and places are those of voxel centres times the spacing.
    """

    centres: np.ndarray
    """(N, 3) of the largest sphere in each pore: a voxel's."""
    centroids: np.ndarray
    """(N, 3)"""
    radius: np.ndarray
    """(N,) of that sphere, less a quarter of an edge."""
    volume: np.ndarray
    """(N,) of all the pore's voxels: throats have no volume of their own."""
    surface: np.ndarray
    """(N,) area of the pore's boundary, throats included."""
    touches: np.ndarray
    """(N, 6) bool: the faces of the image that the pore touches, 2 axis + side."""
    throats: Throats
    """Between pores."""
    openings: Throats
    """At the faces of the image that do not repeat."""
    regions: np.ndarray
    """(Z, Y, X) int32: the pore of every voxel, from 1; 0 outside."""
    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    unit: str
    periodic: tuple[bool, ...]

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def coordination(self) -> np.ndarray:
        """Return the number of throats of every pore, (N,) int64; openings do not count."""
        return np.bincount(self.throats.pores.ravel(), minlength=len(self))

    @property
    def equivalent_diameter(self) -> np.ndarray:
        """Return the diameter of a ball of every pore's volume, (N,)."""
        return np.asarray(np.cbrt(6 * self.volume / np.pi))

    @property
    def inside(self) -> np.ndarray:
        """Return the pores that no face of the image cuts, (N,) bool: those to count and size."""
        return np.asarray(~self.touches.any(axis=1))

    def permeability(self, axis: int) -> Effective:
        """Return the permeability along an axis, in unit^2, by the network's conductances.

        Darcy's law for the flow from one end face to the other by a difference of pressure, or of a
        periodic axis by a mean gradient. Conductances: see `network`; `measure.permeability` solves
        the voxels themselves, and is what to trust.

        Parameters
        ----------
        axis : int
            0 is z; negative counts from the back.

        Returns
        -------
        effective : Effective
            0.0 where no path of pores leads through.

        Raises
        ------
        InputError
            No such axis.
        """
        return effective(self, as_axis(axis, 3), self.throats.flow, self.openings.flow)

    def diffusivity(self, axis: int) -> Effective:
        """Return the effective diffusivity along an axis relative to free diffusion, by the
        network's conductances.

        Parameters, returns and errors are those of `permeability`; `measure.diffusivity` solves the
        voxels themselves. It is never more than the fraction of the phase, the upper bound of
        Wiener 1912: where it is just that, as in open foams, pores hardly narrow, and the network
        says nothing.
        """
        found = effective(self, as_axis(axis, 3), self.throats.diffusion, self.openings.diffusion)
        return replace(found, value=min(found.value, found.fraction))

    def summary(self) -> dict[str, Any]:
        """Return the figures of the network as plain values.

        Sizes are of the pores that no face cuts (of all where each is cut), throats of all.
        """
        whole = self.inside if self.inside.any() else np.ones(len(self), bool)

        def mean(values: np.ndarray) -> float | None:
            return float(values.mean()) if len(values) else None

        return {
            "pores": len(self),
            "throats": len(self.throats),
            "openings": len(self.openings),
            "coordination": mean(self.coordination[whole]),
            "pore_radius": mean(self.radius[whole]),
            "pore_diameter": mean(self.equivalent_diameter[whole]),
            "throat_radius": mean(self.throats.radius),
            "throat_length": mean(self.throats.length),
            "throat_shape_factor": mean(self.throats.shape_factor),
        }

    def to_openpnm(self) -> dict[str, np.ndarray]:
        """Return the network by the names of OpenPNM and PoreSpy, in metres (voxels without a
        unit), for `openpnm.io.network_from_porespy`.

        Coordinates are (x, y, z). Where a face of the image cuts a pore, a pore without volume
        stands on the face: labels "pore.xmin" ... "pore.zmax", as of PoreSpy's `snow2`. Throats
        from a pore to its own image, of periodic axes, have no place in that format and are left
        out; other throats across a face are in "throat.periodic".
        """
        return openpnm_tables(self)

    def write(self, path: str | PathLike[str]) -> list[Path]:
        """Write the network for another program; the suffix chooses.

        Parameters
        ----------
        path : path
            .npz (OpenPNM's and PoreSpy's names: `network_from_porespy(dict(numpy.load(path)))`),
            .csv (`openpnm.io.network_from_csv`), .json (the same names, lists), .vtp (ParaView:
            pores as points, throats as lines), .dat (Statoil: `PREFIX_link1.dat`, `_link2`,
            `_node1`, `_node2` for `PREFIX.dat`). Lengths are metres where the image has a unit.

        Returns
        -------
        paths : list of Path
            What was written.

        Raises
        ------
        UnknownNameError
            Another suffix.
        FileError
            The place cannot be written.
        """
        tables: Mapping[str, np.ndarray] = self.to_openpnm()
        return write_tables(tables, path)

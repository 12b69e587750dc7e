"""A network as tables by the names of OpenPNM (https://openpnm.org) and PoreSpy, in metres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trabecula.io.units import has_length, to_metres

if TYPE_CHECKING:
    from trabecula.measure.network.pore_network import PoreNetwork

_FACES = ("zmin", "zmax", "ymin", "ymax", "xmin", "xmax")


def openpnm_tables(net: PoreNetwork) -> dict[str, np.ndarray]:
    """Return the tables of `PoreNetwork.to_openpnm`."""
    unit = to_metres(net.unit) if has_length(net.unit) else 1.0
    own, inner, cut = len(net), net.throats, net.openings
    inner = inner.rows(inner.pores[:, 0] != inner.pores[:, 1])
    conns = np.concatenate(
        [inner.pores, np.stack([cut.pores[:, 0], own + np.arange(len(cut))], axis=1)]
    ).reshape(-1, 2)

    def pores(values: np.ndarray, of_face: np.ndarray) -> np.ndarray:
        return np.concatenate([values, of_face])

    def throats(name: str) -> np.ndarray:
        return np.concatenate([getattr(inner, name), getattr(cut, name)])

    none, boundary = np.zeros(len(cut)), np.arange(own + len(cut)) >= own
    width = 2 * pores(net.radius, cut.radius)
    conduits = throats("conduits") * unit
    found = {
        "pore.coords": pores(net.centres, cut.centre)[:, ::-1] * unit,
        "throat.conns": conns,
        "pore.global_peak": pores(net.centres, cut.centre)[:, ::-1] * unit,
        "pore.geometric_centroid": pores(net.centroids, cut.centre)[:, ::-1] * unit,
        "pore.inscribed_diameter": width * unit,
        "pore.diameter": width * unit,
        "pore.equivalent_diameter": pores(net.equivalent_diameter, 2 * cut.radius) * unit,
        "pore.volume": pores(net.volume, none) * unit**3,
        "pore.region_volume": pores(net.volume, none) * unit**3,
        "pore.surface_area": pores(net.surface, none) * unit**2,
        "pore.shape_factor": pores(pore_shape_factors(net), cut.shape_factor),
        "pore.region_label": pores(np.arange(1, own + 1), np.zeros(len(cut), np.int64)),
        "pore.boundary": boundary,
        "pore.internal": ~boundary,
    }
    for face, name in enumerate(_FACES):
        found[f"pore.{name}"] = pores(np.zeros(own, bool), cut.face == face)
        found[f"pore.touches_{name}"] = pores(net.touches[:, face], np.zeros(len(cut), bool))
    found |= {
        "throat.global_peak": throats("centre")[:, ::-1] * unit,
        "throat.inscribed_diameter": 2 * throats("radius") * unit,
        "throat.diameter": 2 * throats("radius") * unit,
        "throat.cross_sectional_area": throats("area") * unit**2,
        "throat.equivalent_diameter": 2 * np.sqrt(throats("area") / np.pi) * unit,
        "throat.perimeter": throats("perimeter") * unit,
        "throat.shape_factor": throats("shape_factor"),
        "throat.total_length": throats("length") * unit,
        "throat.length": conduits[:, 1],
        "throat.conduit_lengths.pore1": conduits[:, 0],
        "throat.conduit_lengths.throat": conduits[:, 1],
        "throat.conduit_lengths.pore2": conduits[:, 2],
        "throat.hydraulic_size_factors": throats("flow") * unit**3,
        "throat.diffusive_size_factors": throats("diffusion") * unit,
        "throat.periodic": (throats("shift") != 0).any(axis=1),
        "throat.boundary": np.arange(len(conns)) >= len(inner),
    }
    return found


def pore_shape_factors(net: PoreNetwork) -> np.ndarray:
    """Return the mean shape factor of every pore's throats and openings, weighted with their areas;
    that of a circle where there is none.
    """
    sums = np.zeros((2, len(net)))
    for throats in (net.throats, net.openings):
        for side in (0, 1):
            own = throats.pores[:, side]
            kept = own >= 0
            np.add.at(sums[0], own[kept], (throats.area * throats.shape_factor)[kept])
            np.add.at(sums[1], own[kept], throats.area[kept])
    circle = 1 / (4 * np.pi)
    return np.where(sums[1] > 0, sums[0] / np.maximum(sums[1], 1e-300), circle)

"""The bodies of a scan's phase: their shapes, how often each occurs, and how many there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.labelling import labels_at_faces
from trabecula.measure.partition import REACH, SMOOTHING, Partition, cut_phase, measure_shapes
from trabecula.synth.packing.body_faces import BodyFaces
from trabecula.synth.packing.radial_shapes import ball_radii, degree_for, fit_radii

LEAST = 8
"""Bodies that no face of the scan cuts, at least."""

_ALIKE, _NEAR = 3, 0.1  # whole bodies that stand for one that a face cuts, and radii as near
_LONGER, _SURE = 0.1, 4.0  # bodies lie: so much longer along an axis, by so many standard errors


@dataclass(frozen=True, eq=False)
class ScanBodies:
    """Bodies that no face of the scan cuts; N bodies. Lengths are in the smallest voxel edge.

    Attributes
    ----------
    radii : (N, radial_shapes.SIZE) float32
        Around their centroids.
    weights : (N,) float64
        How often each occurs, 1 in all: bodies that a face cuts count as the whole ones of their
        size.
    density : float
        Bodies per volume, so that theirs, cut at their necks, are the phase.
    fraction : float
        Of the phase.
    misfit : float
        Root mean square distance of their surfaces from the radii, over the radius of a ball of
        their volume; mean by volume.
    lie : bool
        Whether they are longer along one axis.
    """

    radii: np.ndarray
    weights: np.ndarray
    density: float
    fraction: float
    misfit: float
    lie: bool


def find_bodies(image: Image, label: int, degree: int) -> ScanBodies | None:
    """Return the bodies of a phase; None where fewer than `LEAST` are whole.

    Touching bodies are cut apart at their necks (`measure.bodies`).
    """
    inside = image.values == label
    cut = cut_phase(image, inside, False, smoothing=SMOOTHING, reach=REACH, name="bodies")
    shapes = measure_shapes(cut)
    whole = ~labels_at_faces(cut.labels, cut.count)[1:]
    if whole.sum() < LEAST:
        return None
    numbers = np.flatnonzero(whole)
    faces = BodyFaces.of(cut)
    radii, misfits = [], []
    for number in numbers:
        own = faces.of_region(number)
        offsets, contact = faces.places[own] - shapes.centroid[number], faces.contact[own]
        volume = float(shapes.volume[number])
        terms = degree_for(int((~contact).sum()), degree)
        if terms:
            table, misfit = fit_radii(offsets, contact, terms)
        else:
            table, misfit = ball_radii(volume), 0.0
        radii.append(table)
        misfits.append(misfit / (3 * volume / (4 * np.pi)) ** (1 / 3))
    weights = _weights(cut, whole)
    volumes = shapes.volume[numbers]
    fraction = float(inside.mean())
    by_volume = weights * volumes
    return ScanBodies(
        radii=np.stack(radii),
        weights=weights,
        density=fraction / float(by_volume.sum()),
        fraction=fraction,
        misfit=float(np.average(misfits, weights=by_volume)),
        lie=_lie(shapes.covariance[numbers]),
    )


def _weights(cut: Partition, whole: np.ndarray) -> np.ndarray:
    """Return how often each whole body occurs, 1 in all.

    Bodies are counted whose highest point of the distance map lies inside: as often as their
    centres lie in any box, whatever their size.
    """
    radius = cut.distance[tuple(cut.peaks.T)]
    last = np.array(cut.labels.shape) - 1
    at_face = ((cut.peaks == 0) | (cut.peaks == last)).any(axis=1)
    counts = np.ones(int(whole.sum()))
    own = radius[whole]
    for one in radius[~whole & ~at_face]:
        off = np.abs(own - one)
        alike = np.argsort(off, kind="stable")[:_ALIKE]
        alike = alike[off[alike] <= max(_NEAR * one, off[alike[0]])]
        counts[alike] += 1 / len(alike)
    return np.asarray(counts / counts.sum())


def _lie(covariance: np.ndarray) -> bool:
    """Return whether bodies with these second moments (N, 3, 3) are longer along one axis."""
    square = np.diagonal(covariance, axis1=1, axis2=2)
    along = 0.5 * np.log(square / np.exp(np.log(square).mean(axis=1, keepdims=True)))
    mean = along.mean(axis=0)
    error = along.std(axis=0) / np.sqrt(len(along)) + 1e-12
    return bool(((np.abs(mean) > _LONGER) & (np.abs(mean) > _SURE * error)).any())

"""What is learnt of a scan's fibres: directions, thicknesses, and how clearly they are fibres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.core.seeds import generator
from trabecula.measure.orientation import structure_tensor
from trabecula.measure.thickness import local_thickness

_PLACES = 4096  # of the phase that are looked at
_CLEARER = 0.5  # share of them whose direction is too vague: where fibres meet
_RADII = 256  # quantiles of the thickness
_RIM = 3  # voxels at the faces that are not looked at
_STEADY = 100.0  # steps of a direction: the last bits of it differ between processors
_THINNEST = 0.5  # edges
_FINER = 0.2  # edges by which balls that are centred on voxels are smaller than a cylinder
_LEAST = 30  # places that are looked at along fibres


@dataclass(frozen=True, eq=False)
class Strands:
    """Fibres of a phase. Lengths are in the smallest voxel edge.

    Attributes
    ----------
    directions : (n, 3) float64
        Unit vectors (z, y, x) along fibres, at places anywhere in them.
    radii : (m,) float64
        Half of the local thickness, each with the same share of the volume.
    fraction : float
        Of the phase.
    clarity : float
        How much less the interface turns along fibres than across, 0 .. 1, in the median.
    """

    directions: np.ndarray
    radii: np.ndarray
    fraction: float
    clarity: float

    @property
    def weights(self) -> np.ndarray:
        """Return the share of the length that has each radius, (m,)."""
        share = self.radii**-2.0
        return np.asarray(share / share.sum())

    @property
    def mean_radius(self) -> float:
        """Return the mean radius along fibres."""
        return float(self.weights @ self.radii)

    @property
    def section(self) -> float:
        """Return the mean area of a section across a fibre, along fibres."""
        return float(np.pi * float(self.weights @ self.radii**2))


def find_strands(image: Image, label: int) -> Strands:
    """Return what is known of the fibres of a phase.

    The direction at a place is that in which the interface around it changes least: of the
    structure tensor, in a window as wide as a fibre. Of what the local thickness varies, only what
    it has in common with a place farther along the fibre is a difference between fibres.
    """
    edges = np.array(image.spacing)
    inside = image.values == label
    marks = Image(inside.astype(np.uint8), "labels", tuple(edges / edges.min()))
    diameter = local_thickness(marks, phase=1)
    mean = float(diameter[inside].mean()) / 2
    window = float(np.clip(mean * edges.min() / edges.max(), 0.5, 20))
    tensor = structure_tensor(marks, sigma=1.0, window=window)
    rooms = np.argwhere(_without_rim(inside))
    draw = generator(0, "fibres/places")
    places = rooms[draw.choice(len(rooms), min(_PLACES, len(rooms)), replace=False)]
    along, clear = _directions(tensor, places)
    share = _common(diameter, tensor, places, along, edges / edges.min(), 8 * mean)
    half = np.quantile(diameter[inside], (np.arange(_RADII) + 0.5) / _RADII) / 2
    radii = np.maximum(mean + np.sqrt(share) * (half - mean) + _FINER, _THINNEST)
    clearer = np.rint(along[clear >= np.quantile(clear, _CLEARER)] * _STEADY)
    return Strands(
        directions=clearer / np.linalg.norm(clearer, axis=1, keepdims=True),
        radii=np.rint(radii * _STEADY) / _STEADY,
        fraction=float(inside.mean()),
        clarity=float(np.median(clear)),
    )


def _directions(tensor: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vectors along fibres at places (n, 3) voxels, and how clear they are, 0 .. 1:
    how much less the interface turns along them than across.
    """
    values, vectors = np.linalg.eigh(np.moveaxis(tensor[:, :, *places.T], -1, 0))
    return vectors[:, :, 0], (values[:, 1] - values[:, 0]) / np.maximum(values[:, 2], 1e-9)


def _common(
    diameter: np.ndarray,
    tensor: np.ndarray,
    places: np.ndarray,
    ways: np.ndarray,
    steps: np.ndarray,
    far: float,
) -> float:
    """Return the correlation, 0 at least, of the local thickness at places (voxels) with that at
    others so many edges along their fibres; 0 of fewer than 30 that do not leave these or the scan.

    Voxels have edges `steps`.
    """
    at, own = places.astype(np.float64), diameter[tuple(places.T)]
    for _ in range(max(1, round(far))):
        at = at + ways / steps
        inner = ((at >= _RIM) & (at <= np.array(diameter.shape) - 1 - _RIM)).all(axis=1)
        at, ways, own = at[inner], ways[inner], own[inner]
        voxels = np.rint(at).astype(np.int64)
        within = diameter[tuple(voxels.T)] > 0
        at, ways, own, voxels = at[within], ways[within], own[within], voxels[within]
        if len(at) < _LEAST:
            return 0.0
        found, _ = _directions(tensor, voxels)
        ways = found * np.where((found * ways).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    other = diameter[tuple(voxels.T)]
    spread = float(own.std() * other.std())
    together = float(np.mean((own - own.mean()) * (other - other.mean())))
    return max(0.0, together / spread) if spread else 0.0


def _without_rim(inside: np.ndarray) -> np.ndarray:
    """Return the voxels of a phase that are not at a face; all where none else is left."""
    inner = np.zeros_like(inside)
    middle = tuple(
        slice(min(_RIM, side // 4), side - min(_RIM, side // 4)) for side in inside.shape
    )
    inner[middle] = inside[middle]
    return inner if inner.any() else inside

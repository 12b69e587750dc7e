"""Distance between bubbles and an exemplar: sizes of pores and walls, direction, porosity.

The measures are those of `measure`, and so of the certificate; distributions are compared as a
whole, not by their means.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, with_values
from trabecula.measure.fabric import fabric
from trabecula.measure.thickness import local_thickness
from trabecula.synth.api.exemplar_info import ExemplarInfo, without_exemplar
from trabecula.synth.api.method import Model
from trabecula.synth.bubbles.config import BubblesConfig

_PARTS = 200
_DIGITS = 6
"""Digits of a distance: machines may disagree about those beyond them."""

FARTHEST = 100.0
"""Distance of a volume that cannot be compared: one phase alone, or impossible settings."""


@dataclass(frozen=True)
class MaterialDescriptors:
    """Measures of a material of void and solid.

    Attributes
    ----------
    porosity : float
    pores, walls : (200,) float64
        Local diameters of void and of solid, by voxels: the middles of equal parts of all voxels,
        rising.
    tensor, directions : (ndim, ndim) float64
        Of mean intercept lengths (`measure.fabric`).
    """

    porosity: float
    pores: np.ndarray
    walls: np.ndarray
    tensor: np.ndarray
    directions: np.ndarray

    def along(self, directions: np.ndarray) -> np.ndarray:
        """Return the mean intercept lengths along unit vectors, the rows of an array."""
        inverse = np.einsum("ki,ij,kj->k", directions, self.tensor, directions)
        return np.asarray(1 / np.sqrt(np.maximum(inverse, 1e-30)))


def descriptors_of(image: Image) -> MaterialDescriptors | None:
    """Measure an image of void and solid; None where it holds one phase alone."""
    void = image.values == 0
    if void.all() or not void.any():
        return None
    pores, walls = (
        np.quantile(local_thickness(image, phase=phase)[inside], (np.arange(_PARTS) + 0.5) / _PARTS)
        for phase, inside in (("void", void), ("solid", ~void))
    )
    found = fabric(image)
    return MaterialDescriptors(float(void.mean()), pores, walls, found.tensor, found.directions)


def distances(made: MaterialDescriptors | None, wanted: MaterialDescriptors) -> Mapping[str, float]:
    """Return the distances of two materials by name; 0 where both are alike.

    `pore_size` and `thickness` are Wasserstein distances of the distributions (the mean difference
    of voxels in order of size) over the exemplar's mean; `anisotropy` is the mean logarithm, by
    size, of the ratio of intercept lengths along the principal directions of the exemplar;
    `porosity` the difference over the rarer phase's share.
    """
    if made is None:
        return dict.fromkeys(("pore_size", "thickness", "anisotropy", "porosity"), FARTHEST)
    rarer = min(wanted.porosity, 1 - wanted.porosity)
    found = {
        "pore_size": np.abs(made.pores - wanted.pores).mean() / wanted.pores.mean(),
        "thickness": np.abs(made.walls - wanted.walls).mean() / wanted.walls.mean(),
        "anisotropy": np.abs(
            np.log(made.along(wanted.directions) / wanted.along(wanted.directions))
        ).mean(),
        "porosity": abs(made.porosity - wanted.porosity) / rarer,
    }
    return {name: round(float(value), _DIGITS) for name, value in found.items()}


_SIDE = {3: 72, 2: 400}
"""Voxels along an axis of the middle of the exemplar that is compared."""

_FINE = 10  # voxels in the diameter of a mean pore: finer ones are not needed
# bytes a voxel of a trial and its measures, and bytes of directions for any size
_HELD, _LEAST_HELD = 30, 8_600_000
_LEAST = 32  # voxels along an axis that a coarser exemplar keeps
# weights of the distances in their sum: a direction shows long before its distance is large
_WEIGHTS = {"anisotropy": 3.0}

Maker = Callable[[BubblesConfig, list[ExemplarInfo]], Model]


@dataclass(frozen=True)
class Exemplar:
    """The compared part of an exemplar: void 0 and solid 1, in voxels no finer than needed."""

    image: Image
    measured: MaterialDescriptors
    ndim: int

    @property
    def spacing(self) -> float:
        """Return the edge of a voxel."""
        return self.image.spacing[0]


def reduce_exemplar(exemplar: Image) -> Exemplar:
    """Return the middle of an exemplar, coarsened where its pores are large.

    Raises
    ------
    InputError
        The middle holds one phase alone.
    """
    void = exemplar.phases.index("void") if "void" in exemplar.phases else 0
    whole = Image(
        (exemplar.values != void).astype(np.uint8), "labels", exemplar.spacing, exemplar.unit
    )
    image = _middle(whole)
    measured = _descriptors(image)
    factor = int(measured.pores.mean() / exemplar.spacing[0] / _FINE)
    if factor > 1 and min(exemplar.shape) // factor >= _LEAST:
        image = _middle(_coarser(whole, factor))
        measured = _descriptors(image)
    return Exemplar(image, measured, exemplar.ndim)


def _descriptors(image: Image) -> MaterialDescriptors:
    """Measure an exemplar; raise where it holds one phase alone."""
    measured = descriptors_of(image)
    if measured is None:
        raise InputError(
            f"the middle of the exemplar, {image.shape}, holds one phase alone: give a crop with "
            "bubbles all over"
        )
    return measured


def _middle(image: Image) -> Image:
    """Crop an image to its middle."""
    cuts = []
    for side in image.shape:
        keep = min(side, _SIDE[image.ndim])
        cuts.append(slice((side - keep) // 2, (side - keep) // 2 + keep))
    return with_values(image, np.ascontiguousarray(image.values[tuple(cuts)]))


def _coarser(image: Image, factor: int) -> Image:
    """Merge blocks of voxels into one each, solid where most of it is, at the same porosity."""
    shape = [side // factor for side in image.shape]
    inner = image.values[tuple(slice(0, side * factor) for side in shape)]
    split = inner.reshape([part for side in shape for part in (side, factor)])
    counts = split.sum(axis=tuple(range(1, 2 * image.ndim, 2)), dtype=np.int64)
    level = np.sort(counts, axis=None)[::-1][
        min(round(inner.mean() * counts.size), counts.size - 1)
    ]
    candidates = (counts >= level, counts > level)
    solid = min(candidates, key=lambda one: abs(one.mean() - inner.mean()))
    return with_values(
        image, solid.astype(np.uint8), spacing=tuple(edge * factor for edge in image.spacing)
    )


def trial(config: BubblesConfig, seen: Exemplar, make: Maker, seed: int) -> Mapping[str, float]:
    """Return the distances of a volume of these settings, as large as the reduced exemplar.

    Where walls leave no room for the porosity, growth continues to the end, and the missing
    porosity counts as a distance.
    """
    facts = without_exemplar(seen.spacing, seen.image.unit)
    for tried in (config, replace(config, porosity=None)):
        try:
            volume = make(tried, [facts]).generate(seen.image.shape, seed=seed)
            return distances(descriptors_of(volume), seen.measured)
        except RequestError:
            continue
    return distances(None, seen.measured)


def bytes_of_search(shape: Sequence[int]) -> int:
    """Return the memory of the trials for an exemplar of this shape, and of its middle."""
    seen = math.prod(min(side, _SIDE[len(shape)]) for side in shape)
    return math.prod(shape) + max(_HELD * seen, _LEAST_HELD)


def total_distance(parts: Mapping[str, float]) -> float:
    """Return the weighted sum of the distances."""
    return round(sum(_WEIGHTS.get(name, 1.0) * value for name, value in parts.items()), 6)

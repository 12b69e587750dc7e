"""Differences between realisations of one material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.copying.coherence import coherence


@dataclass(frozen=True)
class Diversity:
    """Differences between realisations of one material.

    Attributes
    ----------
    distance : (N, N) float64
        Share of voxels that differ, over what it would be for independent images of the same
        fractions: 0 for equal images, near 1 for independent ones.
    coherence : (N, N) float64
        `coherence` of the second image with the first as its exemplar, at k: near 0 for independent
        images, 1 for a shifted copy. NaN on the diagonal.
    """

    distance: np.ndarray
    coherence: np.ndarray


def diversity(
    images: Sequence[Image | ArrayLike],
    *,
    k: int = 8,
    size: int | None = None,
    samples: int = 300,
    seed: int = 0,
) -> Diversity:
    """Measure how much realisations differ, by pairs: voxel for voxel, and up to a shift.

    Parameters
    ----------
    images : sequence of Image or array of labels
        Two or more, of one shape.
    k, size, samples, seed
        As in `coherence`, which see; one k.

    Returns
    -------
    diversity : Diversity

    Raises
    ------
    InputError
        Fewer than two images, different shapes, or images too small for `coherence`.
    """
    parts = _as_images(images)
    distance = differences(parts)
    moved = np.full(distance.shape, np.nan)
    for first, second in permutations(range(len(parts)), 2):
        share = coherence(
            parts[first], parts[second], k=(k,), size=size, samples=samples, seed=seed
        )
        moved[first, second] = share[k]
    return Diversity(distance, moved)


def differences(images: Sequence[Image | ArrayLike]) -> np.ndarray:
    """Return `Diversity.distance` alone, which takes a moment.

    Parameters
    ----------
    images : sequence of Image or array of labels
        Two or more, of one shape.

    Returns
    -------
    distance : (N, N) float64

    Raises
    ------
    InputError
        Fewer than two images, or different shapes.
    """
    parts = _as_images(images)
    distance = np.zeros((len(parts), len(parts)))
    for a, b in combinations(range(len(parts)), 2):
        distance[a, b] = distance[b, a] = _difference(parts[a], parts[b])
    return distance


def _as_images(images: Sequence[Image | ArrayLike]) -> list[Image]:
    if not isinstance(images, Sequence):
        raise InputError(f"images is {quote(images)}: give two or more in a list")
    if len(images) < 2:
        raise InputError(f"diversity compares two or more images, got {len(images)}")
    return [as_image(image) for image in images]


def _difference(first: Image, second: Image) -> float:
    check_labels(first)
    check_labels(second)
    if first.shape != second.shape:
        raise InputError(
            f"realisations have one shape, got {first.shape} and {second.shape}: crop them alike"
        )
    count = max(len(first.phases), len(second.phases))
    shares = [
        np.bincount(part.values.ravel(), minlength=count) / part.values.size
        for part in (first, second)
    ]
    expected = 1 - float(shares[0] @ shares[1])
    return float(np.mean(first.values != second.values)) / expected if expected else 0.0

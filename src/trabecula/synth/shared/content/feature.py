"""A feature mask of grey or colour pictures, whose signed distance is one more channel of their
fields.

A mean of grey values or colours blurs rims and corners, as a mean of labels does; a mean of signed
distances moves the rim (Kopf et al. 2007, doi:10.1145/1276377.1276380, section 5: "feature maps").
The mask is found in the pictures: the class that stands out from the most frequent colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.segment import otsu
from trabecula.measure.distance import signed_distance
from trabecula.measure.smooth import gaussian

_BLUR = 0.7  # pixels: grain is no feature
_BINS = 12  # along each channel, to find the most frequent colour


@dataclass(frozen=True)
class Feature:
    """The rule that tells the voxels of a feature: how far their values are from one colour.

    Attributes
    ----------
    centre : (3,) or (1,) float32
        The most frequent colour; of grey values the lowest, so that the rule is a threshold.
    threshold : float
        Distance from it beyond which a voxel belongs to the feature.
    """

    centre: np.ndarray
    threshold: float

    @classmethod
    def of(cls, exemplars: Sequence[Image]) -> Feature | None:
        """Find the rule for pictures of grey values or colours; None where they hold one value."""
        values = np.concatenate([_smooth(image.values, image.kind).T for image in exemplars])
        centre = _mode(values) if values.shape[1] > 1 else values.min(axis=0)
        apart = _apart(values, centre)
        if not apart.max() > 0:
            return None
        return cls(centre.astype(np.float32), float(otsu(apart)[0]))

    def mask(self, values: np.ndarray, kind: str) -> np.ndarray:
        """Return the voxels of the feature, of the shape of an image of these values."""
        smooth = _smooth(values, kind)
        shape = values.shape[:-1] if kind == "colour" else values.shape
        return (_apart(smooth.T, self.centre) > self.threshold).reshape(shape)

    def distance(self, values: np.ndarray, kind: str) -> np.ndarray:
        """Return the signed distance to the feature's rim in voxels, positive inside, float32."""
        inside = self.mask(values, kind)
        if inside.all() or not inside.any():
            return np.full(inside.shape, 1e6 if inside.any() else -1e6, np.float32)
        return signed_distance(inside).astype(np.float32, copy=False)


def _smooth(values: np.ndarray, kind: str) -> np.ndarray:
    """Return the channels (C, n) float32 without the finest grain."""
    channels = np.moveaxis(values, -1, 0) if kind == "colour" else values[None]
    return np.stack([gaussian(c.astype(np.float32), _BLUR).ravel() for c in channels])


def _apart(values: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the distance of colours (n, C) from a centre."""
    return np.sqrt(np.square(values - centre).sum(axis=1))


def _mode(values: np.ndarray) -> np.ndarray:
    """Return the mean colour of the fullest cell of a grid over colours (n, 3)."""
    low, high = values.min(), values.max()
    cells = ((values - low) * (_BINS / max(high - low, 1e-6))).astype(np.int64).clip(0, _BINS - 1)
    number = (cells[:, 0] * _BINS + cells[:, 1]) * _BINS + cells[:, 2]
    fullest = np.bincount(number).argmax()
    return values[number == fullest].mean(axis=0)

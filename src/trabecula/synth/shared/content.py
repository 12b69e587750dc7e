"""What the exemplars hold, as fields and back: labels, grey values or colours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.measure.distance import distance_transform
from trabecula.measure.smooth import gaussian
from trabecula.synth.shared.fields import (
    FULL,
    labels_of,
    mean_edge,
    phase_fields,
    phases_present,
    plain_values,
    value_fields,
    values_of,
)
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.joints import mixed_share, surroundings

Bounds = tuple[np.ndarray, np.ndarray]
"""The least and the most, (C, Z, Y, X) float32, that the field may be."""

_ANY = 1e4  # farther than any distance
_BLUR = 1.0  # voxels
_BESIDE = 8  # voxels around what is made that say how dense it should be


def content_of(
    exemplars: Sequence[Image], *, field: str = "distance", histogram: bool = True, unit: float | None = None
) -> Content:
    """How to read and write the exemplars' kind.

    Parameters
    ----------
    exemplars : sequence of Image
        Volumes, or pictures: one for each view, so that what is seen in two counts twice.
    field : {"distance", "indicator"}
        What labels become.
    histogram : bool
        Whether results hold the exemplars' histogram, or volume fractions.
    unit : float, optional
        Length that counts as one voxel in distances: of pictures the mean edge of the volume's voxels. Default: the mean edge
        of each image's own.
    """
    if exemplars[0].kind != "labels":
        return Values(exemplars, histogram=histogram)
    return (Labels if field == "distance" else Indicators)(exemplars, histogram=histogram, unit=unit)


class Content(ABC):
    """Between images and fields."""

    distances: bool
    """Whether a field is a distance in voxels, which halves with the resolution."""

    @abstractmethod
    def fields(self, image: Image) -> np.ndarray:
        """(C, Z, Y, X) float32; of a picture (C, 1, Y, X)."""

    @abstractmethod
    def bounds(self, request: Request, *, thin: bool = False) -> Bounds | None:
        """What a request's known voxels say of the field; `thin` says that the field is one of planes, as known slices are."""

    def aims(self, histograms: Sequence[Histogram], request: Request) -> tuple[Histogram, ...]:
        """The histograms of a field's channels that a request asks for: the exemplar's, or such as meet its target."""
        return tuple(histograms)

    @abstractmethod
    def delivered(self, votes: np.ndarray, request: Request) -> np.ndarray:
        """The result's values from the last votes (C, Z, Y, X) int16."""


class Labels(Content):
    """Signed distances of the phases that occur."""

    distances = True

    def __init__(self, exemplars: Sequence[Image], *, histogram: bool, unit: float | None = None) -> None:
        self.histogram = histogram
        self.unit = unit
        self.present = phases_present(exemplars)
        self.names = exemplars[0].phases
        counts = np.sum([np.bincount(image.values.ravel(), minlength=len(self.names)) for image in exemplars], axis=0)
        self.fractions = counts[list(self.present)] / counts.sum()
        # Outside a form there is nothing: the void where it has a name, else the first phase.
        self.empty = self.names.index("void") if "void" in self.names else 0

    def fields(self, image: Image) -> np.ndarray:
        return _deep(phase_fields(image, self.present, unit=self.unit)[0])

    def bounds(self, request: Request, *, thin: bool = False) -> Bounds | None:
        """Known voxels lie as far from an interface as they lie from the unknown, at least, or from one that is known; in the
        plane of a slice that is where they lie."""
        if request.fixed is None or request.known is None:
            return None
        fixed, known = request.fixed, request.known
        unit = mean_edge(fixed.spacing) if self.unit is None else self.unit
        spacing = tuple(edge / unit for edge in fixed.spacing)
        unknown = distance_transform(known, spacing=spacing)
        low, high = [], []
        for label in self.present[1:] if len(self.present) == 2 else self.present:
            inside = fixed.values == label
            within, without = (_depth(side, known, spacing) for side in (inside, ~inside))
            own = np.where(inside, within, without)
            far = np.maximum(own - 0.5, 0.1)
            near = np.maximum(0.5 * far, 0.1) if thin else np.maximum(np.minimum(own, unknown) - 0.5, 0.1)
            low.append(np.where(known, np.where(inside, near, -far), -_ANY))
            high.append(np.where(known, np.where(inside, far, -near), _ANY))
        return np.stack(low).astype(np.float32), np.stack(high).astype(np.float32)

    def aims(self, histograms: Sequence[Histogram], request: Request) -> tuple[Histogram, ...]:
        """A target porosity makes values inside every phase as much more or less frequent."""
        asked = self._asked(request)
        if asked is None:
            return tuple(histograms)
        aims = []
        for phase, histogram in zip(range(len(self.present))[-len(histograms) :], histograms, strict=True):
            own, wanted = float(self.fractions[phase]), float(asked[phase])
            aims.append(Histogram.leaning(histogram, wanted / own, (1 - wanted) / (1 - own)))
        return tuple(aims)

    def delivered(self, votes: np.ndarray, request: Request) -> np.ndarray:
        free = free_of(request)
        wanted = self._wanted(request, free) if self.histogram or request.target else None
        values = labels_of(votes, self.present, wanted, free)
        return completed(values, request, empty=self.empty)

    def _wanted(self, request: Request, free: np.ndarray | None) -> np.ndarray:
        """The fractions of what is made: the exemplar's, or where something is known beside it, of both together; or what a
        target leaves to it."""
        asked = self._asked(request)
        if asked is not None:
            return self._left(asked, request, free)
        if free is None or request.fixed is None or request.known is None:
            return self.fractions
        near = surroundings(free, request.known, _BESIDE)
        held = request.fixed.values[near]
        own = np.array([np.mean(held == label) if held.size else 0.0 for label in self.present])
        return mixed_share(held.size, int(np.count_nonzero(free)), own, self.fractions)

    def _asked(self, request: Request) -> np.ndarray | None:
        """The fractions that a target porosity asks for: the other phases keep their proportions."""
        asked = porosity_of(request.target)
        if asked is None:
            return None
        porosity = np.asarray(asked)
        if porosity.ndim:
            raise RequestError("this method honours one number as target porosity, not a field: give a number")
        void = np.array([label == self.empty for label in self.present])
        rest = float(self.fractions[~void].sum())
        shares = np.where(void, float(porosity), self.fractions * ((1 - float(porosity)) / max(rest, 1e-30)))
        return np.asarray(shares / shares.sum())

    def _left(self, asked: np.ndarray, request: Request, free: np.ndarray | None) -> np.ndarray:
        """The fractions of what is made, so that with what is known they are those asked for, as far as they can be."""
        if free is None or request.fixed is None or request.known is None:
            return asked
        held = request.fixed.values[request.known if request.mask is None else request.known & request.mask]
        own = np.array([np.count_nonzero(held == label) for label in self.present])
        left = np.maximum(asked * (held.size + np.count_nonzero(free)) - own, 0)
        return np.asarray(left / max(left.sum(), 1e-30))


class Indicators(Labels):
    """The phases' 0 and 1, blurred by a voxel and stretched over the bytes: what a scan's grey levels would be."""

    distances = False

    def fields(self, image: Image) -> np.ndarray:
        channels = self.present[1:] if len(self.present) == 2 else self.present
        sharp = [np.where(image.values == label, np.float32(FULL), np.float32(-FULL)) for label in channels]
        return _deep(np.stack([gaussian(channel, _BLUR) for channel in sharp]))

    def bounds(self, request: Request, *, thin: bool = False) -> Bounds | None:
        if request.fixed is None or request.known is None:
            return None
        # How far the blur of a known voxel is known depends on its neighbours; its side of the middle does not.
        low, high = [], []
        for label in self.present[1:] if len(self.present) == 2 else self.present:
            inside = request.fixed.values == label
            low.append(np.where(request.known, np.where(inside, 1.0, -_ANY), -_ANY))
            high.append(np.where(request.known, np.where(inside, _ANY, -1.0), _ANY))
        return np.stack(low).astype(np.float32), np.stack(high).astype(np.float32)


class Values(Content):
    """Grey values or colours, stretched over the bytes."""

    distances = False

    def __init__(self, exemplars: Sequence[Image], *, histogram: bool) -> None:
        self.kind = exemplars[0].kind
        self.low = min(float(image.values.min()) for image in exemplars)
        self.high = max(float(image.values.max()) for image in exemplars)
        channels = 3 if self.kind == "colour" else 1
        pooled = [
            np.concatenate([image.values.reshape(-1, channels)[:, c] for image in exemplars]) for c in range(channels)
        ]
        self.histograms = [Histogram.of(channel) for channel in pooled] if histogram else None
        self.dtype = exemplars[0].values.dtype

    def fields(self, image: Image) -> np.ndarray:
        return _deep(value_fields(image, low=self.low, high=self.high))

    def bounds(self, request: Request, *, thin: bool = False) -> Bounds | None:
        if request.fixed is None or request.known is None:
            return None
        fields = self.fields(request.fixed)
        return np.where(request.known, fields, -_ANY), np.where(request.known, fields, _ANY)

    def delivered(self, votes: np.ndarray, request: Request) -> np.ndarray:
        if self.histograms is not None:
            return completed(values_of(votes, self.histograms, free_of(request)), request, empty=0)
        values = plain_values(votes, low=self.low, high=self.high, dtype=self.dtype)
        return completed(values, request, empty=0)


def _deep(fields: np.ndarray) -> np.ndarray:
    """Fields (C, Z, Y, X): those of a picture are one plane deep."""
    return fields if fields.ndim == 4 else fields[:, None]


def free_of(request: Request) -> np.ndarray | None:
    """The voxels that are to be made; None where all are."""
    if request.known is None:
        return request.mask
    return ~request.known if request.mask is None else request.mask & ~request.known


def completed(values: np.ndarray, request: Request, *, empty: int) -> np.ndarray:
    """Values, written into: `empty` outside the mask, and what is known as it is."""
    if request.mask is not None:
        values[~request.mask] = empty
    if request.fixed is not None and request.known is not None:
        values[request.known] = request.fixed.values[request.known]
    return values


def _depth(inside: np.ndarray, known: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    """Distance of every voxel of `inside` to the nearest known voxel outside."""
    may_be = inside | ~known
    return np.full(inside.shape, _ANY) if may_be.all() else distance_transform(may_be, spacing=spacing)

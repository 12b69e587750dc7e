"""The kinds of content, each converted to fields and back: labels, grey values or colours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.measure.smooth import gaussian
from trabecula.synth.shared.content.bounds import Bounds, distance_bounds, sign_bounds, value_bounds
from trabecula.synth.shared.content.feature import Feature
from trabecula.synth.shared.content.fields import (
    FULL,
    mean_edge,
    phase_fields,
    phases_present,
    plain_values,
    value_fields,
    values_of,
)
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.joints import pool_fractions, surroundings
from trabecula.synth.shared.content.phase_fractions import labels_of, labels_of_upper
from trabecula.synth.shared.slabs import (
    complement,
    count_true,
    for_plane_groups,
    intersection,
    tally_by_slabs,
)

_BLUR = 1.0  # voxels
_BESIDE = 8  # voxels around the free ones whose fractions count


def content_of(
    exemplars: Sequence[Image],
    *,
    field: str = "distance",
    histogram: bool = True,
    unit: float | None = None,
    rim: float | None = None,
) -> Content:
    """Choose the reader and writer of the exemplars' kind.

    Parameters
    ----------
    exemplars : sequence of Image
        Volumes, or pictures: one for each view, so that a picture of two views counts twice.
    field : {"distance", "indicator"}
        The field of labels.
    histogram : bool
        Whether results hold the exemplars' histogram, or volume fractions.
    unit : float, optional
        Length that counts as one voxel in distances: of pictures the mean edge of the volume's
        voxels. Default: the mean edge of each image's own.
    rim : float, optional
        Distance from the rim of a feature, voxels, at which its channel beside grey values or
        colours saturates. Default: no such channel.
    """
    if exemplars[0].kind != "labels":
        found = None if rim is None else Feature.of(exemplars)
        if found is None or rim is None:
            return Values(exemplars, histogram=histogram)
        return FeaturedValues(exemplars, found, histogram=histogram, rim=rim)
    return (Labels if field == "distance" else Indicators)(
        exemplars, histogram=histogram, unit=unit
    )


class Content(ABC):
    """Conversion between images and fields."""

    distances: bool
    """Whether a field is a distance in voxels, which halves with the resolution."""

    features = 0
    """Channels at the end of the fields that are distances beside others that are none."""

    @abstractmethod
    def fields(self, image: Image) -> np.ndarray:
        """Return the fields (C, Z, Y, X) float32 of an image; of a picture (C, 1, Y, X)."""

    @abstractmethod
    def bounds(self, request: Request, *, thin: bool = False, least: float = 0.0) -> Bounds | None:
        """Return the bounds that a request's known voxels set to the field; `thin` where the field
        is one of planes, as known slices are, `least` as of `bounds.distance_bounds`.
        """

    def target_histograms(
        self, histograms: Sequence[Histogram], request: Request
    ) -> tuple[Histogram, ...]:
        """Return the histograms of a field's channels that a request requires: the exemplar's, or
        such as meet its target.
        """
        return tuple(histograms)

    @abstractmethod
    def to_values(self, votes: np.ndarray, request: Request) -> np.ndarray:
        """Return the result's values from the last votes (C, Z, Y, X) int16."""


class Labels(Content):
    """Signed distances of the phases that occur."""

    distances = True

    def __init__(
        self, exemplars: Sequence[Image], *, histogram: bool, unit: float | None = None
    ) -> None:
        self.histogram = histogram
        self.unit = unit
        self.present = phases_present(exemplars)
        self.names = exemplars[0].phases
        counts = np.sum(
            [np.bincount(image.values.ravel(), minlength=len(self.names)) for image in exemplars],
            axis=0,
        )
        self.fractions = counts[list(self.present)] / counts.sum()
        # Outside a form: the void where it has a name, else the first phase.
        self.empty = self.names.index("void") if "void" in self.names else 0

    def fields(self, image: Image) -> np.ndarray:
        return _deep(phase_fields(image, self.present, unit=self.unit)[0])

    def bounds(self, request: Request, *, thin: bool = False, least: float = 0.0) -> Bounds | None:
        """Bound the distance of a known voxel to an interface: at least that to the nearest unknown
        voxel, or to a known interface; in the plane of a slice the measured one.
        """
        if request.fixed is None or request.known is None:
            return None
        unit = mean_edge(request.fixed.spacing) if self.unit is None else self.unit
        spacing = tuple(edge / unit for edge in request.fixed.spacing)
        return distance_bounds(
            request.fixed.values, request.known, self._channels(), spacing, thin=thin, least=least
        )

    def _channels(self) -> tuple[int, ...]:
        """List the labels that the field's channels stand for."""
        return self.present[1:] if len(self.present) == 2 else self.present

    def target_histograms(
        self, histograms: Sequence[Histogram], request: Request
    ) -> tuple[Histogram, ...]:
        """Make values inside every phase as much more or less frequent as a target porosity
        requires.
        """
        asked = self.fractions_of_target(request)
        if asked is None:
            return tuple(histograms)
        return self.reweight(histograms, self.fractions, asked)

    def reweight(
        self, histograms: Sequence[Histogram], own: np.ndarray, asked: np.ndarray
    ) -> tuple[Histogram, ...]:
        """Make values inside every phase as much more or less frequent as its fraction is to
        change.
        """
        phases = range(len(self.present))[-len(histograms) :]
        return tuple(
            Histogram.reweight(
                histogram,
                float(asked[phase]) / float(own[phase]),
                (1 - float(asked[phase])) / (1 - float(own[phase])),
            )
            for phase, histogram in zip(phases, histograms, strict=True)
        )

    def to_values(self, votes: np.ndarray, request: Request) -> np.ndarray:
        free = free_voxels(request)
        wanted = self.free_fractions(request, free) if self.histogram or request.target else None
        values = labels_of(votes, self.present, wanted, free)
        return complete(values, request, empty=self.empty)

    def from_upper(self, upper: np.ndarray, request: Request) -> np.ndarray:
        """Return the result's values where the second of two phases is marked, (Z, Y, X) bool."""
        values = labels_of_upper(upper, self.present)
        return complete(values, request, empty=self.empty)

    def free_fractions(self, request: Request, free: np.ndarray | None) -> np.ndarray:
        """Return the fractions of the free voxels: the exemplar's, or those of the exemplar and of
        known voxels near by together, or those that meet a target.
        """
        asked = self.fractions_of_target(request)
        if asked is not None:
            return self._remaining_fractions(asked, request, free)
        if free is None or request.fixed is None or request.known is None:
            return self.fractions
        counts = _counts(request.fixed.values, surroundings(free, request.known, _BESIDE))
        held = int(counts.sum())
        own = counts[list(self.present)] / max(1, held)
        return pool_fractions(held, count_true(free), own, self.fractions)

    def fractions_of_target(self, request: Request) -> np.ndarray | None:
        """Return the fractions of a target porosity; the other phases keep their proportions."""
        asked = porosity_of(request.target)
        if asked is None:
            return None
        porosity = np.asarray(asked)
        if porosity.ndim:
            raise RequestError(
                "this method honours one number as target porosity, not a field: give a number"
            )
        void = np.array([label == self.empty for label in self.present])
        rest = float(self.fractions[~void].sum())
        shares = np.where(
            void, float(porosity), self.fractions * ((1 - float(porosity)) / max(rest, 1e-30))
        )
        return np.asarray(shares / shares.sum())

    def _remaining_fractions(
        self, asked: np.ndarray, request: Request, free: np.ndarray | None
    ) -> np.ndarray:
        """Return the fractions of the free voxels that, with the known ones, meet the requested
        fractions as far as possible.
        """
        if free is None or request.fixed is None or request.known is None:
            return asked
        counts = _counts(request.fixed.values, request.known, request.mask)
        left = np.maximum(
            asked * (int(counts.sum()) + count_true(free)) - counts[list(self.present)], 0
        )
        return np.asarray(left / max(left.sum(), 1e-30))


class Indicators(Labels):
    """The phases' 0 and 1, blurred by a voxel and stretched over the bytes: what a scan's grey
    levels would be.
    """

    distances = False

    def fields(self, image: Image) -> np.ndarray:
        sharp = [
            np.where(image.values == label, np.float32(FULL), np.float32(-FULL))
            for label in self._channels()
        ]
        return _deep(np.stack([gaussian(channel, _BLUR) for channel in sharp]))

    def bounds(self, request: Request, *, thin: bool = False, least: float = 0.0) -> Bounds | None:
        if request.fixed is None or request.known is None:
            return None
        return sign_bounds(request.fixed.values, request.known, self._channels())


class Values(Content):
    """Grey values or colours, stretched over the bytes."""

    distances = False

    def __init__(self, exemplars: Sequence[Image], *, histogram: bool) -> None:
        self.kind = exemplars[0].kind
        self.low = min(float(image.values.min()) for image in exemplars)
        self.high = max(float(image.values.max()) for image in exemplars)
        channels = 3 if self.kind == "colour" else 1
        pooled = [
            np.concatenate([image.values.reshape(-1, channels)[:, c] for image in exemplars])
            for c in range(channels)
        ]
        self.histograms = [Histogram.of(channel) for channel in pooled] if histogram else None
        self.dtype = exemplars[0].values.dtype

    def fields(self, image: Image) -> np.ndarray:
        return _deep(self.fields_of(image.values))

    def bounds(self, request: Request, *, thin: bool = False, least: float = 0.0) -> Bounds | None:
        if request.fixed is None or request.known is None:
            return None
        return value_bounds(self.fields_of, request.fixed.values, request.known)

    def fields_of(self, values: np.ndarray) -> np.ndarray:
        """Return the fields (C, ...) float32 of grey values (...) or colours (..., 3)."""
        return value_fields(values, colour=self.kind == "colour", low=self.low, high=self.high)

    def to_values(self, votes: np.ndarray, request: Request) -> np.ndarray:
        if self.histograms is not None:
            return complete(
                values_of(votes, self.histograms, free_voxels(request)), request, empty=0
            )
        values = plain_values(votes, low=self.low, high=self.high, dtype=self.dtype)
        return complete(values, request, empty=0)


class FeaturedValues(Values):
    """Grey values or colours, and the signed distance to the rim of what stands out in them."""

    features = 1

    def __init__(
        self, exemplars: Sequence[Image], feature: Feature, *, histogram: bool, rim: float
    ) -> None:
        super().__init__(exemplars, histogram=histogram)
        self.feature, self.rim = feature, rim

    def fields(self, image: Image) -> np.ndarray:
        far = self.feature.distance(image.values, self.kind) * np.float32(FULL / self.rim)
        return np.concatenate([super().fields(image), _deep(far[None])])

    def bounds(self, request: Request, *, thin: bool = False, least: float = 0.0) -> Bounds | None:
        if request.fixed is None or request.known is None:
            return None
        return value_bounds(self.fields_of, request.fixed.values, request.known, features=1)

    def to_values(self, votes: np.ndarray, request: Request) -> np.ndarray:
        return super().to_values(votes[:-1], request)


def _deep(fields: np.ndarray) -> np.ndarray:
    """Return fields as (C, Z, Y, X): those of a picture are one plane deep."""
    return fields if fields.ndim == 4 else fields[:, None]


def free_voxels(request: Request) -> np.ndarray | None:
    """Mark the voxels that are to be made; None where all are."""
    return (
        request.mask
        if request.known is None
        else intersection(request.mask, complement(request.known))
    )


def complete(values: np.ndarray, request: Request, *, empty: int) -> np.ndarray:
    """Write `empty` outside the mask, and the known voxels, into values."""
    mask, fixed = request.mask, request.fixed
    known = request.known

    def work(start: int, stop: int) -> None:
        part = values[start:stop]
        if mask is not None:
            part[~mask[start:stop]] = empty
        if fixed is not None and known is not None:
            there = known[start:stop]
            part[there] = fixed.values[start:stop][there]

    if mask is not None or known is not None:
        for_plane_groups(work, values.shape[:3])
    return values


def _counts(labels: np.ndarray, inside: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Count the voxels `inside`, and inside a mask, of each label, (256,)."""

    def tally(start: int, stop: int) -> np.ndarray:
        at = inside[start:stop] if mask is None else inside[start:stop] & mask[start:stop]
        return np.bincount(labels[start:stop][at], minlength=256)

    return tally_by_slabs(tally, labels.shape)

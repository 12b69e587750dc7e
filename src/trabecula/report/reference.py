"""The exemplar and its parts, measured once; every image is judged against them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.copying import coherence
from trabecula.measure.evenness import Evenness
from trabecula.report.band import (
    LEAST_COUNT,
    Sizes,
    distance_limit,
    draw_limit,
    excess_limit,
    parts,
    value_band,
)
from trabecula.report.descriptors import Measured, Stick
from trabecula.report.evenness import WHATS, evenness_bands, evenness_numbers, scaling_exponent
from trabecula.report.verdict import Metric
from trabecula.report.metrics import (
    AT_LEAST,
    AT_MOST,
    AXES,
    COUNT,
    DISTANCE,
    SHOWN,
    TOLD,
    figure_of,
    in_order,
    stem_of,
)

LAG = 4
"""Coherence is told over this many voxels: beyond chance, and shorter than the pieces that patch
methods copy.
"""

SAMPLES = 500
"""Voxels whose sources are looked up: the share is known to 0.022 at worst, to 0.01 near the
independent 0.05.
"""


NORMALISED = (
    "two_point_covariance",
    "axis_preference",
    "anisotropy",
    "texture_preference",
    "autocorrelation_distance",
    "orientation_divergence",
)
"""Figures that take the density, or the mean value, out."""


class Reference:
    """What images are compared with.

    Parameters
    ----------
    exemplar : Image
    stick : Stick
        How it is measured.
    copying : bool
        Also search where every image was taken from.
    shape : sequence of int, optional
        Of parts, where they are to be smaller than halves.
    """

    def __init__(
        self, exemplar: Image, stick: Stick, *, copying: bool, shape: Sequence[int] | None = None
    ) -> None:
        self.exemplar, self.stick, self.copying = exemplar, stick, copying
        pieces = list(parts(exemplar, shape=shape))
        self.own = stick.measure(exemplar)
        self.exponent = min(map(scaling_exponent, self.own.evenness.values()), default=1.0)
        self.parts = [
            stick.measure(piece, part=True)
            for piece in progress.track(pieces, "measuring the exemplar's parts")
        ]
        distances = [stick.distances(part, self.own) for part in self.parts]
        first = distances[0] if distances else {}
        self.spread: dict[str, list[float | None]] = {
            name: [found[name] for found in distances] for name in first
        }
        if copying:
            self.spread["coherence"] = independent_coherence(
                list(parts(exemplar, shape=shape, share=2))
            )

    def measure(self, image: Image) -> Measured:
        """An image by the same stick."""
        return self.stick.measure(image)

    def judge(
        self, image: Image, measured: Measured, *, copying: bool | None = None
    ) -> dict[str, Metric]:
        """Every figure of an image with its band and verdict, in the order of the table; whether it
        is a copy only where that is asked for."""
        found = self.judged(measured)
        if self.copying if copying is None else copying:
            found["coherence"] = self.judged_coherence(coherence_of(self.exemplar, image))
        return {name: found[name] for name in in_order(found)}

    def judged_coherence(self, share: float | None) -> Metric:
        """Return the share of voxels that are copies, with its band and verdict."""
        known = [number for number in self.spread["coherence"] if number is not None]
        if not known:
            return Metric(share)
        noise = math.sqrt(max(0.02, float(np.mean(known))) / SAMPLES)
        band = (0.0, min(1.0, draw_limit(known, noise)))
        return Metric(share, band, None if share is None else share <= band[1])

    def judged(self, measured: Measured) -> dict[str, Metric]:
        """Return every figure that is measured, with its band and verdict."""
        found = {
            name: self._judged_distance(name, value, measured)
            for name, value in self.stick.distances(measured, self.own).items()
        }
        for name, own in self.own.numbers.items():
            found[name] = self._judged(name, measured.numbers.get(name), own, measured)
        return found | self.judged_evenness(measured)

    def judged_evenness(self, measured: Measured) -> dict[str, Metric]:
        """Return local figures and trends of every phase, with bands and verdicts."""
        found: dict[str, Metric] = {}
        first = next(iter(self.own.evenness), "")
        if not measured.evenness:  # a baseline smaller than the exemplar has none
            return found
        for suffix, own in self.own.evenness.items():
            found |= self._judged_local(own, measured.evenness[suffix], suffix, WHATS[:1])
        if first in self.own.evenness:
            found |= self._judged_local(
                self.own.evenness[first], measured.evenness[first], "", WHATS[1:]
            )
        return found

    def _judged_local(
        self, own: Evenness, image: Evenness, suffix: str, whats: Sequence[str]
    ) -> dict[str, Metric]:
        bands = (
            evenness_bands(own, image, suffix, whats=whats)
            if len(self.parts) >= LEAST_COUNT
            else {}
        )
        known = evenness_numbers(own, suffix, whats=whats)
        found = {}
        for name, value in evenness_numbers(image, suffix, whats=whats).items():
            band = bands.get(name)
            passed = None if band is None else _passes(value, band, figure_of(name).rule)
            found[name] = Metric(value, band, passed, known[name])
        return found

    def _sizes(self, measured: Measured, name: str) -> Sizes:
        # Long waves move the density and what goes with it; figures that take the density out do
        # not feel them.
        exponent = 1.0 if stem_of(name) in NORMALISED else self.exponent
        return Sizes(
            float(np.prod(self.parts[0].shape)),
            float(np.prod(self.exemplar.shape)),
            float(np.prod(measured.shape)) * measured.samples,
            self.exemplar.ndim,
            exponent,
        )

    def _judged_distance(self, name: str, value: float, measured: Measured) -> Metric:
        known = [number for number in self.spread.get(name, []) if number is not None]
        if len(known) < LEAST_COUNT:
            return Metric(value, None, None, 0.0)
        high = distance_limit(known, self._sizes(measured, name))
        return Metric(
            value, (0.0, high), None if figure_of(name).rule == SHOWN else value <= high, 0.0
        )

    def _judged(self, name: str, value: Any, own: Any, measured: Measured) -> Metric:
        figure = figure_of(name)
        rule = figure.rule
        if rule == AXES:
            holds = all(value[axis] for axis, through in own.items() if through)
            return Metric(value, None, holds if self.parts else None, own)
        # Counts grow with the volume: their density is judged, and told for the volume of the
        # image.
        volumes = (
            [np.prod(part.shape) for part in self.parts]
            if rule == COUNT
            else [1.0] * len(self.parts)
        )
        scale, whole = (
            (np.prod(measured.shape), np.prod(self.exemplar.shape)) if rule == COUNT else (1.0, 1.0)
        )
        numbers = [part.numbers.get(name) for part in self.parts]
        known = [n / volume for n, volume in zip(numbers, volumes, strict=True) if n is not None]
        shown = None if own is None else own * scale / whole
        if rule == TOLD or len(known) < LEAST_COUNT or own is None:
            return Metric(value, None, None, shown)
        sizes = self._sizes(measured, name)
        if rule == AT_MOST:
            low, high = 0.0, excess_limit(known, own, sizes)
        else:
            low, high = (float(edge * scale) for edge in value_band(known, own / whole, sizes))
        band = (min(low, 1.0), min(high, 1.0)) if figure.share else (low, high)
        if value is None:
            return Metric(value, band, None if rule == AT_MOST else False, shown)
        return Metric(value, band, _passes(value, band, rule), shown)


def _passes(value: float, band: tuple[float, float], rule: str) -> bool:
    enough = rule in (AT_MOST, COUNT, DISTANCE) or value >= band[0]
    return bool(enough and (rule == AT_LEAST or value <= band[1]))


def independent_coherence(pieces: Sequence[Image]) -> list[float | None]:
    """The coherence of real material that was not copied: parts of the exemplar searched in the
    part farthest away.
    """
    count = len(pieces)
    pairs = [(pieces[n], pieces[count - 1 - n]) for n in range(max(count // 2, min(count, 2)))]
    return [
        coherence_of(there, here)
        for here, there in progress.track(pairs, "searching the exemplar's parts")
    ]


def coherence_of(exemplar: Image, image: Image) -> float | None:
    """Coherence over `LAG` voxels, or None where the images are too small or too plain for it."""
    try:
        return coherence(exemplar, image, k=(LAG,), samples=SAMPLES)[LAG]
    except InputError:
        return None

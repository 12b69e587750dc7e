"""The exemplar and its parts, measured once; every image is judged against them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.copying import coherence
from trabecula.report.band import parts, prediction_band
from trabecula.report.figures import AT_LEAST, AT_MOST, AXES, COUNT, DISTANCE, SHOWN, TOLD, figure_of, in_order
from trabecula.report.metric import Metric
from trabecula.report.sticks import Measured, Stick

LAG = 4
"""Coherence is told over this many voxels: beyond chance, and shorter than the pieces that patch methods copy."""

SAMPLES = 500
"""Voxels whose sources are looked up: the share is known to 0.022 at worst, to 0.01 near the independent 0.05."""


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

    def __init__(self, exemplar: Image, stick: Stick, *, copying: bool, shape: Sequence[int] | None = None) -> None:
        self.exemplar, self.stick, self.copying = exemplar, stick, copying
        pieces = list(parts(exemplar, shape=shape))
        self.own = stick.measure(exemplar)
        self.parts = [
            stick.measure(piece, part=True) for piece in progress.track(pieces, "measuring the exemplar's parts")
        ]
        distances = [stick.distances(part, self.own) for part in self.parts]
        first = distances[0] if distances else {}
        self.spread: dict[str, list[float | None]] = {name: [found[name] for found in distances] for name in first}
        if copying:
            self.spread["coherence"] = independent_coherence(pieces)

    def measure(self, image: Image) -> Measured:
        """An image by the same stick."""
        return self.stick.measure(image)

    def judge(self, image: Image, measured: Measured, *, copying: bool | None = None) -> dict[str, Metric]:
        """Every figure of an image with its band and verdict, in the order of the table; whether it is a copy only where
        that is asked for."""
        found = self.judged(measured)
        if self.copying if copying is None else copying:
            found["coherence"] = self.judged_coherence(coherence_of(self.exemplar, image))
        return {name: found[name] for name in in_order(found)}

    def judged_coherence(self, share: float | None) -> Metric:
        """The share of voxels that are copies, with its band and verdict."""
        return self._judged("coherence", share, self.spread["coherence"], None)

    def judged(self, measured: Measured) -> dict[str, Metric]:
        """Every figure that is measured, with its band and verdict."""
        found = {
            name: self._judged(name, value, self.spread.get(name, []), 0.0)
            for name, value in self.stick.distances(measured, self.own).items()
        }
        for name, own in self.own.numbers.items():
            value = measured.numbers.get(name)
            spread = [part.numbers.get(name) for part in self.parts]
            if figure_of(name).rule == COUNT:
                size = np.prod(measured.shape)
                spread = [
                    None if n is None else n * size / np.prod(part.shape)
                    for n, part in zip(spread, self.parts, strict=True)
                ]
                own = None if own is None else own * size / self.exemplar.values.size
            found[name] = self._judged(name, value, spread, own)
        return found

    def _judged(self, name: str, value: Any, spread: Sequence[float | None], own: Any) -> Metric:
        figure = figure_of(name)
        rule = figure.rule
        if rule == AXES:
            holds = all(value[axis] for axis, through in own.items() if through)
            return Metric(value, None, holds if self.parts else None, own)
        known = [number for number in spread if number is not None]
        if rule == TOLD or len(known) < 2:
            return Metric(value, None, None, own)
        low, high = prediction_band(known, one_sided=rule in (DISTANCE, SHOWN))
        if own is not None:  # the parts may all lie on one side of the whole: what faces cut makes them smaller
            low, high = min(low, float(own)), max(high, float(own))
        band = (low, min(high, 1.0) if figure.share else high)
        if rule == SHOWN or (value is None and rule == AT_MOST):
            return Metric(value, band, None, own)
        return Metric(value, band, value is not None and _passes(value, band, rule), own)


def _passes(value: float, band: tuple[float, float], rule: str) -> bool:
    enough = rule in (AT_MOST, COUNT, DISTANCE) or value >= band[0]
    return bool(enough and (rule == AT_LEAST or value <= band[1]))


def independent_coherence(pieces: Sequence[Image]) -> list[float | None]:
    """The coherence of real material that was not copied: parts of the exemplar searched in the part farthest away."""
    count = len(pieces)
    pairs = [(pieces[n], pieces[count - 1 - n]) for n in range(max(count // 2, min(count, 2)))]
    return [coherence_of(there, here) for here, there in progress.track(pairs, "searching the exemplar's parts")]


def coherence_of(exemplar: Image, image: Image) -> float | None:
    """Coherence over `LAG` voxels, or None where the images are too small or too plain for it."""
    try:
        return coherence(exemplar, image, k=(LAG,), samples=SAMPLES)[LAG]
    except InputError:
        return None

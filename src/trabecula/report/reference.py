"""The exemplar and its parts, measured once; every image is judged against them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.parallel import map_items
from trabecula.measure.copying import TurnedCopies, coherence
from trabecula.measure.copying.coherence import sample_sources
from trabecula.measure.copying.pair import ExemplarTrees
from trabecula.measure.copying.turned import ENOUGH, find_turned
from trabecula.measure.evenness import Evenness
from trabecula.measure.registry import (
    AT_LEAST,
    AT_MOST,
    AXES,
    COUNT,
    DESCRIPTORS,
    DISTANCE,
    REPORTED,
    SHOWN,
)
from trabecula.report.band import (
    LEAST_COUNT,
    Sizes,
    distance_limit,
    draw_limit,
    excess_limit,
    parts,
    value_band,
)
from trabecula.report.descriptors import DescriptorSet, Measurements
from trabecula.report.evenness import (
    WHATS,
    evenness_bands,
    evenness_numbers,
    hellinger_distances,
    scaling_exponent,
)
from trabecula.report.metrics import Metric, find_descriptor, in_order, stem

LAG = 4
"""Voxels over which coherence is measured: beyond chance, and shorter than the patches that
methods copy.
"""

SAMPLES = 500
"""Voxels whose sources are looked up: the share is known to 0.022 at worst, to 0.01 near the
independent 0.05.
"""

CHANCE = 0.1
"""Share of copied voxels that is no fault: of real parts of ten scans the largest was 0.105, and of
turned copies 0.05, and the few parts of one exemplar do not know it. Copies have 0.5 to 1.
"""


class Reference:
    """The exemplar and its parts, which images are compared with.

    Parameters
    ----------
    exemplar : Image
    descriptors : DescriptorSet
        How it is measured.
    copying : bool
        Also search where every image was taken from.
    shape : sequence of int, optional
        Of parts, where they are to be smaller than halves.
    most : int, optional
        Images that are measured at once at most. Default: as many as threads.
    """

    def __init__(
        self,
        exemplar: Image,
        descriptors: DescriptorSet,
        *,
        copying: bool,
        shape: Sequence[int] | None = None,
        most: int | None = None,
    ) -> None:
        self.exemplar, self.descriptors, self.copying = exemplar, descriptors, copying
        boxes = list(parts(exemplar, shape=shape))
        self.own, *self.parts = map_items(
            lambda one: descriptors.measure(one, part=one is not exemplar),
            [exemplar, *boxes],
            "measuring the exemplar and its parts",
            most=most,
        )
        self.exponent = min(map(scaling_exponent, self.own.evenness.values()), default=1.0)
        distances = [descriptors.distances(part, self.own) for part in self.parts]
        first = distances[0] if distances else {}
        self.spread: dict[str, list[float | None]] = {
            name: [found[name] for found in distances] for name in first
        }
        if copying:
            known = search_parts(list(parts(exemplar, shape=shape, share=2)))
            self.spread["coherence"] = [share for share, _ in known]
            self.spread["turned_copies"] = [turned.share for _, turned in known if turned]

    def measure(self, image: Image) -> Measurements:
        """Measure an image by the same descriptors."""
        return self.descriptors.measure(image)

    def judge(
        self, measured: Measurements, copies: tuple[float | None, TurnedCopies | None] | None
    ) -> dict[str, Metric]:
        """Judge every figure of an image, in the order of the registry; `copies` are what
        `search_copies` found in it, None where nobody looked.
        """
        found = self.judge_measurements(measured)
        if copies is not None:
            found |= self.judge_copies(*copies)
        return {name: found[name] for name in in_order(found)}

    def judge_copies(self, share: float | None, turned: TurnedCopies | None) -> dict[str, Metric]:
        """Return the shares of voxels that are copies as they are, and mirrored or turned."""
        known = [number for number in self.spread["turned_copies"] if number is not None]
        found = Metric(None)
        if turned is not None:
            limit = copies_limit(known, ENOUGH) if known else None
            found = Metric(
                turned.share,
                None if limit is None else (0.0, limit),
                None if limit is None else turned.share <= limit,
                symmetry=turned.text if turned.share > CHANCE else None,
            )
        return {"coherence": self.judge_coherence(share), "turned_copies": found}

    def judge_coherence(self, share: float | None) -> Metric:
        """Return the share of voxels that are copies, with its band and verdict."""
        known = [number for number in self.spread["coherence"] if number is not None]
        if not known:
            return Metric(share)
        band = (0.0, copies_limit(known, SAMPLES))
        return Metric(share, band, None if share is None else share <= band[1])

    def judge_measurements(self, measured: Measurements) -> dict[str, Metric]:
        """Return every figure that is measured, with its band and verdict."""
        found = {
            name: self._judge_distance(name, value, measured)
            for name, value in self.descriptors.distances(measured, self.own).items()
        }
        for name, own in self.own.numbers.items():
            found[name] = self._judge_number(name, measured.numbers.get(name), own, measured)
        return found | self.judge_evenness(measured)

    def judge_evenness(self, measured: Measurements) -> dict[str, Metric]:
        """Return local figures and trends of every phase, with bands and verdicts."""
        found: dict[str, Metric] = {}
        first = next(iter(self.own.evenness), "")
        if not measured.evenness:  # a baseline smaller than the exemplar has none
            return found
        for suffix, own in self.own.evenness.items():
            image = measured.evenness[suffix]
            found |= self._judge_local(own, image, suffix, WHATS[:1])
            apart = hellinger_distances(own, image, suffix)
            found |= {name: Metric(value, None, None, 0.0) for name, value in apart.items()}
        if first in self.own.evenness:
            found |= self._judge_local(
                self.own.evenness[first], measured.evenness[first], "", WHATS[1:]
            )
        return found

    def _judge_local(
        self, own: Evenness, image: Evenness, suffix: str, whats: Sequence[str]
    ) -> dict[str, Metric]:
        enough = len(self.parts) >= LEAST_COUNT
        bands = evenness_bands(own, image, suffix, whats=whats) if enough else {}
        known = evenness_numbers(own, suffix, whats=whats)
        found = {}
        for name, value in evenness_numbers(image, suffix, whats=whats).items():
            band = bands.get(name)
            passed = None if band is None else _passes(value, band, find_descriptor(name).rule)
            found[name] = Metric(value, band, passed, known[name])
        return found

    def sizes_of(self, measured: Measurements, name: str) -> Sizes:
        """Return the sizes of the samples that the band of a figure is about."""
        # Long waves move the density and what goes with it; figures that take the density out do
        # not feel them.
        exponent = 1.0 if DESCRIPTORS[stem(name)].normalised else self.exponent
        return Sizes(
            float(np.prod(self.parts[0].shape)),
            float(np.prod(self.exemplar.shape)),
            float(np.prod(measured.shape)) * measured.samples,
            self.exemplar.ndim,
            exponent,
        )

    def _judge_distance(self, name: str, value: float, measured: Measurements) -> Metric:
        known = [number for number in self.spread.get(name, []) if number is not None]
        if len(known) < LEAST_COUNT:
            return Metric(value, None, None, 0.0)
        high = distance_limit(known, self.sizes_of(measured, name))
        return Metric(
            value, (0.0, high), None if find_descriptor(name).rule == SHOWN else value <= high, 0.0
        )

    def _judge_number(self, name: str, value: Any, own: Any, measured: Measurements) -> Metric:
        figure = find_descriptor(name)
        rule = figure.rule
        if rule == AXES:
            return Metric(value, None, self._spans(name, value, own, measured), own)
        # Counts grow with the volume: their density is judged, and shown for the volume of the
        # image.
        counted = rule == COUNT
        volumes = [np.prod(part.shape) if counted else 1.0 for part in self.parts]
        scale = np.prod(measured.shape) if counted else 1.0
        whole = np.prod(self.exemplar.shape) if counted else 1.0
        numbers = [part.numbers.get(name) for part in self.parts]
        known = [n / volume for n, volume in zip(numbers, volumes, strict=True) if n is not None]
        shown = None if own is None else own * scale / whole
        if rule == REPORTED or len(known) < LEAST_COUNT or own is None:
            return Metric(value, None, None, shown)
        sizes = self.sizes_of(measured, name)
        if rule == AT_MOST:
            low, high = 0.0, excess_limit(known, own, sizes)
        else:
            low, high = (float(edge * scale) for edge in value_band(known, own / whole, sizes))
        band = (min(low, 1.0), min(high, 1.0)) if figure.share else (low, high)
        if value is None:
            return Metric(value, band, None if rule == AT_MOST else False, shown)
        return Metric(value, band, _passes(value, band, rule), shown)

    def _spans(self, name: str, value: Any, own: Any, measured: Measurements) -> bool | None:
        """Return whether the image percolates along the axes where any sample of its size would:
        an image smaller than the exemplar along those where all of its parts do as well.
        """
        if not self.parts:
            return None
        smaller = math.prod(measured.shape) < math.prod(self.exemplar.shape)
        known = [part.numbers[name] for part in self.parts] if smaller else []
        return all(
            value[axis]
            for axis, through in own.items()
            if through and all(part[axis] for part in known)
        )


def _passes(value: float, band: tuple[float, float], rule: str) -> bool:
    enough = rule in (AT_MOST, COUNT, DISTANCE) or value >= band[0]
    return bool(enough and (rule == AT_LEAST or value <= band[1]))


def copies_limit(known: Sequence[float], voxels: int) -> float:
    """Return the largest share of copied voxels by chance, from those of real parts, of each of
    which so many voxels were looked at.
    """
    noise = math.sqrt(max(0.02, float(np.mean(known))) / voxels)
    return min(1.0, max(CHANCE, draw_limit(known, noise)))


def search_parts(boxes: Sequence[Image]) -> list[tuple[float | None, TurnedCopies | None]]:
    """Search parts of the exemplar for copies of the part farthest away: there are none."""
    count = len(boxes)
    pairs = [(boxes[n], boxes[count - 1 - n]) for n in range(max(count // 2, min(count, 2)))]
    return map_items(
        lambda pair: search_copies(pair[1], pair[0]), pairs, "searching the exemplar's parts"
    )


def search_copies(
    exemplar: Image, image: Image, *, trees: ExemplarTrees | None = None
) -> tuple[float | None, TurnedCopies | None]:
    """Return the coherence over `LAG` voxels, and copies that were mirrored or turned; None where
    images are too small or plain for it. `trees` as of `sample_sources`.
    """
    try:
        found = sample_sources(exemplar, image, steps=[LAG], samples=SAMPLES, seed=0, trees=trees)
    except InputError:
        return None, None
    return found.shares[LAG], find_turned(found)


def try_coherence(exemplar: Image, image: Image) -> float | None:
    """Return the coherence over `LAG` voxels; None where images are too small or plain for it."""
    try:
        return coherence(exemplar, image, k=(LAG,), samples=SAMPLES)[LAG]
    except InputError:
        return None

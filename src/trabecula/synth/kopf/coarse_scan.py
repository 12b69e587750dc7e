"""A low-resolution scan as a constraint: the bounds of its blocks, the field to start from, and
the material at the picture's resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.measure.distance import signed_distance
from trabecula.synth.kopf.back_projection import add_shifts
from trabecula.synth.kopf.change_of_support import Material, refine, variance_share
from trabecula.synth.shared.block_bounds import BlockBounds

_FAR, _MANY = 0.25, 3.0  # a difference of fractions: absolute, and in deviations of slices
_WITHIN, _PURE = 2.0, 3.0  # errors: of a fraction's bounds; of one that may be 0 or 1
_STEEP = 30000  # votes of a start, before its distances are measured
_BINS, _AROUND, _FIT = 256, 21, 6  # of a histogram; of them in a running mean, in a parabola
_LEAST = 1e-3  # of a fraction that grey values tell
_SHARP = 0.5  # times the deviation of all grey values, the most that a pure phase scatters
_BLIND = 0.05  # error of fractions where no voxel tells the noise


@dataclass(frozen=True)
class CoarseScan:
    """A scan of two phases.

    Attributes
    ----------
    fractions : (z, y, x) float32
        Of the second phase in each voxel, as far as it is known: 0 or 1 of labels.
    error : float, optional
        Of the fractions; None where only the majority is known (labels).
    sides : three ints
        Voxels of the result in one of the scan.
    material : Material
        At the resolution of the result.
    """

    fractions: np.ndarray
    error: float | None
    sides: tuple[int, int, int]
    material: Material

    @classmethod
    def of(cls, request: Request, pictures: Sequence[Image], present: Sequence[int]) -> CoarseScan:
        """Read the coarse scan of a request.

        Raises
        ------
        RequestError
            More or fewer than two phases; fractions that are not those of the pictures.
        """
        image = request.coarse
        assert image is not None  # checked by the request
        z, y, x = request.blocks
        seen = [np.asarray(picture.values == present[1]) for picture in pictures]
        if image.kind == "labels":
            fractions, error = label_fractions(image, present), None
        else:
            fractions, error = grey_fractions(
                image.values,
                variance_share(seen, (z, y, x)),
                float(np.mean([one.mean() for one in seen])),
            )
        # before it is cut to 0 .. 1, where noise would be counted on one side alone
        mean = float(fractions.mean(dtype=np.float64))
        known = None if error is None else min(max(mean, _LEAST), 1 - _LEAST)
        fractions = fractions.clip(0, 1)
        material = refine(fractions > 0.5, seen, (z, y, x), known)
        return cls(fractions, error, (z, y, x), material)

    def divides(self, level: int) -> bool:
        """Return whether the blocks of the scan are whole voxels of a level."""
        return not any(side % 2**level for side in self.sides)

    def bounds(self, level: int, within: float = _WITHIN) -> BlockBounds:
        """Return how many voxels of each block of a level may be of the second phase: `within` so
        many errors of its fraction.
        """
        z, y, x = (side // 2**level for side in self.sides)
        blocks = (z, y, x)
        size = int(np.prod(blocks))
        most = self.fractions > 0.5
        if self.error is None or size == 1:
            # more than half, so that a block is never undecided
            least = np.where(most, size // 2 + 1, 0)
            upper = np.where(most, size, (size - 1) // 2)
        else:
            # what may be one phase alone with noise is let be: else noise becomes crumbs
            off, pure = within * self.error, _PURE * self.error
            least = np.where(self.fractions < pure, 0, np.floor((self.fractions - off) * size))
            upper = np.where(
                1 - self.fractions < pure, size, np.ceil((self.fractions + off) * size)
            )
            least, upper = least.clip(0, size), upper.clip(0, size)
        return BlockBounds(least.astype(np.int32), upper.astype(np.int32), blocks)

    def start(self, shape: Sequence[int], level: int) -> np.ndarray:
        """Return the signed distance (1, Z, Y, X) float32 to the interface of the scan, linear
        between its voxels' centres, in voxels of a level.
        """
        votes = memmap.zeros(shape, np.int16)
        sides = [side / 2**level for side in self.sides]
        add_shifts(votes, ((self.fractions - 0.5) * _STEEP).astype(np.float32), sides)
        inside = votes > 0
        if inside.all() or not inside.any():
            return np.where(inside, np.float32(1), np.float32(-1))[None] * np.float32(max(shape))
        return signed_distance(inside)[None].astype(np.float32, copy=False)


def check_scan(request: Request, pictures: Sequence[Image], present: Sequence[int]) -> str:
    """Return a line where the scan has less or more of a phase than slices of it differ by; empty
    where it agrees with the pictures.

    Raises
    ------
    RequestError
        More or fewer than two phases; fractions that have nothing in common with the pictures'.
    """
    assert request.coarse is not None
    if len(present) != 2:
        raise RequestError(
            f"the exemplar holds {len(present)} phases, a coarse scan is refined for two: merge or "
            "segment the others"
        )
    scan = CoarseScan.of(request, pictures, present)
    own = np.mean([float((picture.values == present[1]).mean()) for picture in pictures])
    spread = max(float(scan.fractions.mean(axis=axes).std()) for axes in ((1, 2), (0, 2), (0, 1)))
    off = abs(own - scan.material.fraction)
    if off <= max(_MANY * spread, 0.02):
        return ""
    name = pictures[0].phases[present[1]]
    line = (
        f"the coarse scan's volume fraction of {name} is {scan.material.fraction:.3f} at the "
        f"resolution of the result, the picture's {own:.3f}; slices of the scan differ by "
        f"{spread:.3f}"
    )
    if off > _FAR:
        raise RequestError(
            f"{line}: give a picture of the same material, with phases in the same order"
        )
    return f"{line}: is it the same material?"


def label_fractions(image: Image, present: Sequence[int]) -> np.ndarray:
    """Return 1 where a voxel is of the second phase, else 0, (z, y, x) float32."""
    strange = np.setdiff1d(np.unique(image.values), present)
    if len(strange):
        names = ", ".join(image.phases[label] for label in strange)
        raise RequestError(
            f"the coarse scan holds the phase {names}, which the picture lacks: give a picture "
            "with it"
        )
    return np.asarray(image.values == present[1], np.float32)


def grey_fractions(values: np.ndarray, share: float, phi: float) -> tuple[np.ndarray, float]:
    """Return the fraction (z, y, x) float32 of the second phase in each voxel, beyond 0 and 1 by
    noise alone, and its error.

    Grey values are partial volumes: fractions are linear between the grey values of the two phases,
    the darker one first. The commoner phase has a peak at its value, and the noise is the scatter
    beyond that. A rarer one may fill no voxel alone: its value is that with which the fractions f =
    (g - a) / k have the variance `share` * phi (1 - phi) that the blocks of the picture have, k = m
    + v / (m share), of the mean m and the variance v of g - a without noise. (Where it has a peak,
    this is within 4 % of it in Berea and NMC.) Where neither fills a voxel, mean and variance are
    those of the picture, of fraction `phi`.
    """
    grey = values.astype(np.float64)
    pure, noise = _peak(grey, 0.0)
    pure, noise = _peak(grey, noise)
    sign = 1 if grey.mean() > pure else -1
    away = sign * (grey - pure)
    if noise > _SHARP * grey.std():
        length = float(np.sqrt(grey.var() / (share * phi * (1 - phi))))
        return ((grey - grey.mean()) / length + phi).astype(np.float32), _BLIND
    mean = float(away.mean())
    fractions = away / (mean + (float(grey.var()) - noise**2) / (mean * share))
    error = noise * float(fractions.max() / away.max())
    return (fractions if sign > 0 else 1 - fractions).astype(np.float32), error


def _peak(grey: np.ndarray, noise: float) -> tuple[float, float]:
    """Return the most frequent grey value, and the noise: the scatter beyond it, on the side away
    from the mean.

    The histogram is smoothed as wide as the `noise` is at least. Where that is known, the peak is
    the top of a parabola through the logarithms of the counts around it and beyond: a Gaussian's,
    on which partial volumes hardly weigh.
    """
    low, high = float(grey.min()), float(grey.max())
    step = max(1.0, np.ceil((high - low) / _BINS)) if _is_whole(grey) else (high - low) / _BINS
    edges = np.arange(low - step / 2, high + step, step)
    counts, middle = np.histogram(grey, bins=edges)[0], (edges[:-1] + edges[1:]) / 2
    wide = max(_AROUND, 2 * round(2 * noise / step) + 1)
    pure = float(
        middle[np.argmax(np.convolve(counts, np.bartlett(wide), mode="same")[: len(counts)])]
    )
    outward = 1 if grey.mean() < pure else -1
    place = (middle - pure) * outward
    near = (place > -0.5 * noise) & (place < 2 * noise) & (counts > 0)
    if near.sum() >= _FIT:
        square, slope, _ = np.polyfit(place[near], np.log(counts[near]), 2, w=np.sqrt(counts[near]))
        if square < 0 and abs(slope / square) < noise:
            pure -= outward * float(slope / (2 * square))
    away = (grey - pure) * outward
    return pure, float(np.sqrt((away[away > 0] ** 2).mean())) if (away > 0).any() else 0.0


def _is_whole(grey: np.ndarray) -> bool:
    return bool((grey == np.rint(grey)).all())

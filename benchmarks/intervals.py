"""`intervals`: how often intervals from one box hold the material's own value, and how wide they
are beside classical subdivision.

Each material is made periodic and many times as large as a box, several times over; the mean of all
of it is the truth (of porosity the closed form, where there is one). Boxes do not overlap. Real
scans are cut into boxes as well; the mean of the scan stands for the truth there. It is a sample
itself, and holds the box: the squared distance of the two is the box's variance less the scan's, so
that the distance is widened by the root of what that takes away before it is judged.

The classical way takes the eight octants (four quarters of a picture) of a box as independent.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

import trabecula as tb
from common import table
from descriptors import scans
from trabecula.measure.confidence import interval_of_mean
from trabecula.measure.local_fields import LocalField
from trabecula.measure.registry import DESCRIPTORS
from trabecula.numerics.quantiles import student

NAMES = tuple(one.name for one in DESCRIPTORS.values() if one.field and one.name != "fraction")
HEADS = ("boxes", "no interval", "covered", "half-width", "octants cover", "octants' width")


def _stamped(shape: tuple[int, ...], centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """The union of balls at lattice places, periodic."""
    inside = np.zeros(shape, bool)
    for radius in np.unique(radii):
        side = 2 * int(radius) + 1
        ball = np.argwhere(
            ((np.indices((side,) * len(shape)) - int(radius)) ** 2).sum(axis=0) <= radius**2
        )
        for centre in centres[radii == radius]:
            inside[tuple(((centre + ball) % np.array(shape)).T)] = True
    return inside


def boolean(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Overlapping balls of radius 4 to 7 at Poisson points, half of the volume."""
    rng = np.random.default_rng(seed)
    alone = [
        _stamped((15,) * len(shape), np.full((1, len(shape)), 7), np.array([radius])).sum()
        for radius in range(4, 8)
    ]
    count = rng.poisson(math.log(2) * math.prod(shape) / np.mean(alone))
    return _stamped(shape, rng.integers(0, shape, (count, len(shape))), rng.integers(4, 8, count))


def gaussian(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """A Gaussian field of covariance exp(-r^2 / 18), cut at 0.7 deviations."""
    return _cut(shape, seed, lambda square: np.exp(-square * 9 / 4), level=0.7)


def rough(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """A Gaussian field of covariance exp(-r / 4), cut at 0 after smoothing over 1 voxel: long tails
    and a rough interface.
    """
    power = -(len(shape) + 1) / 4
    return _cut(shape, seed, lambda square: (1 + square * 16) ** power * np.exp(-square / 2))


def _cut(
    shape: tuple[int, ...],
    seed: int,
    amplitude: Callable[[np.ndarray], np.ndarray],
    *,
    level: float = 0.0,
) -> np.ndarray:
    """Where a periodic Gaussian field is above a level; its amplitudes are of the squared wave."""
    waves = [np.fft.fftfreq(side) * 2 * np.pi for side in shape]
    waves[-1] = np.fft.rfftfreq(shape[-1]) * 2 * np.pi
    axes = tuple(range(len(shape)))
    noise = np.fft.rfftn(np.random.default_rng(seed).standard_normal(shape), axes=axes)
    noise *= amplitude(np.asarray(sum(wave**2 for wave in np.ix_(*waves))))
    field = np.fft.irfftn(noise, shape, axes)
    return np.asarray(field > level * field.std())


def bubbles(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Bubbles of radius 4 to 7 that do not overlap (random sequential addition), a quarter of the
    volume; the matrix around them is the solid.
    """
    rng = np.random.default_rng(seed)
    cell, size = 15, np.array(shape)
    counts = size // cell
    places: dict[tuple[int, ...], list[tuple[np.ndarray, int]]] = {}
    kept, volume, wanted = [], 0.0, 0.25 * math.prod(shape)
    near = list(product((-1, 0, 1), repeat=len(shape)))
    while volume < wanted:
        centre, radius = rng.integers(0, size), int(rng.integers(4, 8))
        home = tuple(np.minimum(centre // cell, counts - 1))
        clear = all(
            (((centre - other + size // 2) % size - size // 2) ** 2).sum() > (radius + far + 1) ** 2
            for step in near
            for other, far in places.get(tuple((np.array(home) + step) % counts), ())
        )
        if clear:
            places.setdefault(home, []).append((centre, radius))
            kept.append((centre, radius))
            volume += 4 / 3 * math.pi * radius**3 if len(shape) == 3 else math.pi * radius**2
    centres, radii = (np.array(column) for column in zip(*kept, strict=True))
    return ~_stamped(shape, centres, radii)


MATERIALS: dict[str, Callable[[tuple[int, ...], int], np.ndarray]] = {
    "Boolean balls": boolean,
    "Gaussian field": gaussian,
    "exponential field": rough,
    "bubbles": bubbles,
}
BLOCKS = (
    *((name, (64,) * 3, (192,) * 3, 8) for name in MATERIALS),
    *((name, (192, 192), (1536, 1536), 4) for name in MATERIALS),
)
"""Material, box, realisation and their number."""
REAL = (("NMC", 60), ("Berea", 64), ("bone a", 64), ("bone b", 64))


def boxes(values: np.ndarray, box: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Boxes side by side."""
    counts = [side // edge for side, edge in zip(values.shape, box, strict=True)]
    for place in np.ndindex(*counts):
        yield tuple(slice(i * e, (i + 1) * e) for i, e in zip(place, box, strict=True))


def octants(local: LocalField) -> float:
    """Half-width of the classical subdivision: 95 % by Student's t of the octants."""
    halves = [(slice(0, side // 2), slice(side - side // 2, side)) for side in local.field.shape]
    means = np.array([local.field[part].mean(dtype=np.float64) for part in product(*halves)])
    return float(student(len(means) - 1, 0.975) * means.std(ddof=1) / math.sqrt(len(means)))


class Tally:
    """Counts of one descriptor of one material."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float | None, float]] = []

    def add(self, image: tb.Image, name: str) -> None:
        """Take a box."""
        one = DESCRIPTORS[name]
        local = one.field(image)  # type: ignore[misc]
        half = interval_of_mean(image, one, local).half_width
        self.rows.append((local.value, half, octants(local)))

    def cells(self, truth: float, *, inside: float = 0.0) -> tuple[object, ...]:
        """Cells of the table; `inside` is the share of the truth's volume that a box has."""
        values, half, classic = (np.array(column, float) for column in zip(*self.rows, strict=True))
        known = np.isfinite(half)
        error = np.abs(values - truth) / math.sqrt(1 - inside)
        missing = int((~known).sum())
        if missing == len(values):
            return (missing, missing, *("-",) * 4)
        reaches = (half[known], classic[known])
        shown = [
            (f"{np.mean(error[known] <= reach):.3f}", f"{reach.mean() / abs(truth):.4f}")
            for reach in reaches
        ]
        return (len(values), missing, *(cell for pair in shown for cell in pair))


def intervals() -> None:
    """Coverage of the nominal 95 % and relative half-widths of materials of known truth, then of
    parts of scans.
    """
    for name, box, whole, count in BLOCKS:
        synthetic(name, box, whole, count)
    for scan, side in REAL:
        real(scan, side)


def synthetic(name: str, box: tuple[int, ...], whole: tuple[int, ...], count: int) -> None:
    """One material and one size of box."""
    tallies = {one: Tally() for one in NAMES}
    truths: dict[str, list[float]] = {one: [] for one in NAMES}
    for seed in range(count):
        solid = MATERIALS[name](whole, seed)
        large = tb.Image(solid, "labels")
        for one in NAMES:
            truths[one].append(DESCRIPTORS[one].field(large).value)  # type: ignore[misc]
        for place in boxes(solid, box):
            part = tb.Image(np.ascontiguousarray(solid[place]), "labels")
            for one in NAMES:
                tallies[one].add(part, one)
    row = table(f"{name}, {' x '.join(map(str, box))}", *HEADS)
    for one in NAMES:
        row(one, *tallies[one].cells(float(np.mean(truths[one]))))
    print(flush=True)


def real(name: str, side: int) -> None:
    """Boxes of a scan, against the mean of the scan."""
    image = scans()[name]
    box = (side,) * image.ndim
    tallies = {one: Tally() for one in NAMES}
    places = list(boxes(image.values, box))
    for place in places:
        values = np.ascontiguousarray(image.values[place])
        part = tb.Image(values, "labels", phases=image.phases)
        for one in NAMES:
            tallies[one].add(part, one)
    row = table(f"{name}, {side}", *HEADS)
    inside = math.prod(box) / image.values.size
    for one in NAMES:
        local = DESCRIPTORS[one].field(tb.Image(image.values, "labels", phases=image.phases))  # type: ignore[misc]
        row(one, *tallies[one].cells(local.value, inside=inside))
    print(flush=True)


if __name__ == "__main__":
    chosen = [int(word) for word in sys.argv[1:]]
    with tb.threads(1):
        for n in chosen:
            synthetic(*BLOCKS[n])

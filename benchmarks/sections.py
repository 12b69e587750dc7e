"""What two parallel sections say of a volume's Euler number."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from common import asked, table
from descriptors import scans
from trabecula.exemplar.sections import gap_contradiction
from trabecula.measure.disector import disector_along
from trabecula.report.metrics import Metric
from trabecula.report.sections import FIGURE, SectionJudge

GAPS = (1, 2, 3, 4)
PLACES = 12
"""Pairs of sections along z."""
SIDE = 96
METHODS = ("kopf", "chen", "sliced", "mrf")
COUNTS, GAP = (2, 6), 3
"""Sections that judge, and voxels from one to the next."""
JUDGED = ("soil, Otsu", "NMC", "Berea", "cement, Otsu")
"""Scans that are alike from all sides."""


def sections() -> None:
    """Euler number of the solid per 1e6 voxels: of a scan, and by pairs of its sections along z at
    several gaps, mean and standard deviation; how many boxes of 96^3 of the scan, its middle and
    its last, lie in the band of a pair of gap 2 or 3, and of how many of these pairs the
    correlations contradict the gap.
    """
    heads = ("scan's", *(f"gap {gap}" for gap in GAPS), "in band", "contradicted")
    row = table("scan", *heads, wide=22)
    total = np.zeros(2, int)
    for name, scan in _labels():
        cells = [f"{1e6 * tb.measure.euler_density(scan):.0f}"]
        for gap in GAPS:
            found = [
                1e6 * tb.measure.disector_euler_density(pair, gap=gap) for pair in _pairs(scan, gap)
            ]
            cells.append(f"{np.mean(found):.0f} +- {np.std(found):.0f}")
        pairs = [(pair, gap) for gap in (2, 3) for pair in _pairs(scan, gap)]
        judges = [SectionJudge(pair, gap) for pair, gap in pairs]
        boxes = _boxes(scan)
        passed = [judge.judge(box)[FIGURE].passed for judge in judges for box in boxes]
        doubted = sum(gap_contradiction(pair, gap) is not None for pair, gap in pairs)
        total += sum(passed), len(passed)
        row(name, *cells, f"{sum(passed)} of {len(passed)}", f"{doubted} of {len(pairs)}")
    print("in band: {} of {}".format(*total))


def section_verdicts() -> None:
    """Volumes of 96^3 that methods make from the middle slice of a scan, judged by that slice and
    one 3 voxels above, and by six sections: the Euler number as sections see it, per 1e6 voxels,
    and the band. What is out of it is marked.
    """
    row = table("scan, method", "the volume's", *(f"by {n}" for n in COUNTS), wide=24)
    for name, scan in _labels():
        if name not in (asked("ONLY") or JUDGED):
            continue
        middle = len(scan.values) // 2
        stack = [section(scan, middle + GAP * n) for n in range(max(COUNTS))]
        made = {"scan": tb.crop(scan, [min(SIDE, side) for side in scan.shape])}
        for method in asked("METHODS") or METHODS:
            made[method] = tb.method(method).fit(stack[0]).generate(SIDE, seed=1)
        judges = [SectionJudge(stack[:count], GAP) for count in COUNTS]
        for word, volume in made.items():
            found = [judge.judge(volume)[FIGURE] for judge in judges]
            row(f"{name}: {word}", f"{1e6 * found[0].value:.0f}", *map(_shown, found))


def section_volumes() -> None:
    """Volumes of 96^3 by `kopf` from one slice of a scan, from that and the one 2 voxels above, and
    from five of them, starting at a quarter, a half and three quarters of the scan along z; seeds
    0 .. 2.

    Ratios to the scan's box of 96^3 at its corner: the Euler number, that of slices 2 voxels apart
    (wider joins), surface and thickness; and the largest void and solid as they are.
    """
    heads = ("Euler", "2 apart", "surface", "thickness", "void", "solid")
    row = table("scan, from, slices", *heads, wide=34)
    for name, scan in _labels():
        if name not in (asked("ONLY") or (*JUDGED, "bone a")):
            continue
        truth = _joined(tb.crop(scan, [min(SIDE, side) for side in scan.shape], corner=(0, 0, 0)))
        row(f"{name}: the scan", *("1" for _ in heads[:4]), *(f"{one:.2f}" for one in truth[4:]))
        for seed, place in enumerate((0.25, 0.5, 0.75)):
            first = min(int(place * len(scan.values)), len(scan.values) - 1 - 2 * 4)
            stack = [section(scan, first + 2 * n) for n in range(5)]
            for count in (1, 2, 5):
                method = tb.method("kopf", gap=0 if count == 1 else 2)
                found = _joined(method.fit(stack[:count]).generate(SIDE, seed=seed))
                ratios = [
                    one / own if own else np.nan for one, own in zip(found, truth, strict=True)
                ]
                cells = [f"{one:.2f}" for one in (*ratios[:4], *found[4:])]
                row(f"{name}, {place}: {count}", *cells)


def _joined(volume: tb.Image) -> tuple[float, ...]:
    """What `section_volumes` compares."""
    apart = [disector_along(volume, gap=2, axis=axis) for axis in range(3)]
    return (
        tb.measure.euler_density(volume),
        float(np.mean(apart)),
        tb.measure.specific_surface(volume),
        tb.measure.thickness(volume),
        tb.measure.largest_fraction(volume, phase="void"),
        tb.measure.largest_fraction(volume),
    )


def _shown(metric: Metric) -> str:
    low, high = metric.real_band
    return f"{1e6 * low:.0f} .. {1e6 * high:.0f}{'' if metric.passed else ' out'}"


def _labels() -> Iterator[tuple[str, tb.Image]]:
    """Yield the scans of two phases, without blank margins and a spacing."""
    for name, scan in scans().items():
        if len(scan.phases) == 2:
            yield name, tb.crop_margins(tb.Image(scan.values, "labels", phases=scan.phases))


def _pairs(scan: tb.Image, gap: int) -> list[list[tb.Image]]:
    last = len(scan.values) - gap - 1
    places = np.linspace(0, last, PLACES).astype(int)
    return [[section(scan, place), section(scan, place + gap)] for place in places]


def section(scan: tb.Image, place: int) -> tb.Image:
    """A slice across z."""
    return tb.Image(np.ascontiguousarray(scan.values[place]), "labels", phases=scan.phases)


def _boxes(scan: tb.Image) -> list[tb.Image]:
    sides = [min(SIDE, side) for side in scan.shape]
    last = [have - side for have, side in zip(scan.shape, sides, strict=True)]
    return [tb.crop(scan, sides), tb.crop(scan, sides, corner=last)]

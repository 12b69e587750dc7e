"""The certificate against fakes: verdicts of real held-out parts and of samples that are uneven in
space.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from common import table
from descriptors import scans
from trabecula.measure import signed_distance
from trabecula.measure.evenness import depth_of

SIDE = 96
AMOUNT = 1.5
"""How far the interface of a fake is moved between its densest and its sparsest place, in thirds of
the local thickness.
"""


def certificate_fakes() -> None:
    """Verdicts at level "quick" of real parts beside the exemplar's, and of hollow, graded and
    halved fakes of them.
    """
    heads = ("verdict", "evenness", "Hellinger", "failed", "of", "first that fails")
    row = table("exemplar", "image", *heads)
    for name, scan in scans().items():
        for what, exemplar, image in cases(scan):
            found = tb.verify(exemplar, image, level="quick")
            judged = sum(metric.passed is not None for metric in found.metrics.values())
            even = {True: "pass", False: "FAIL", None: "-"}[found.groups.get("evenness")]
            apart = [
                metric.value
                for figure, metric in found.metrics.items()
                if figure.startswith("fraction_hellinger_medium")
            ]
            row(
                name,
                what,
                found.verdict,
                even,
                f"{max(apart, default=np.nan):.3f}",
                str(len(found.failed)),
                str(judged),
                next(iter(found.failed), ""),
            )
        print(*(f"  not decided: {reason}\n" for reason in found.undecided), sep="", end="")


def cases(scan: tb.Image) -> Iterator[tuple[str, tb.Image, tb.Image]]:
    """Yield what an image is, its exemplar (the first corner of the scan) and the image (the
    opposite corner, or a fake).
    """
    side = min(SIDE, *scan.shape)
    exemplar = cut(scan, [slice(0, side)] * 3)
    other = cut(scan, [slice(length - side, length) for length in scan.shape])
    if max(scan.shape) >= 2 * side:
        yield "the opposite corner", exemplar, other
    for name, profile in profiles(exemplar.shape).items():
        yield name, exemplar, shifted(exemplar, profile)


def cut(scan: tb.Image, box: list[slice]) -> tb.Image:
    """Return a box of a scan."""
    values = np.ascontiguousarray(scan.values[tuple(box)])
    return tb.Image(values, "labels", spacing=scan.spacing, unit=scan.unit, phases=scan.phases)


def profiles(shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return what fakes differ by in space, from 0 to 1."""
    place = np.indices(shape)[0] / shape[0]
    return {
        "hollow": 1 - np.minimum(2 * depth_of(shape), 1),
        "graded": place,
        "two halves": (place > 0.5) * 1.0,
    }


def shifted(image: tb.Image, profile: np.ndarray) -> tb.Image:
    """Thicken what is not void where the profile is high; its fraction stays, but for ties of the
    distance.
    """
    solid = image.values != image.phases.index("void")
    step = AMOUNT * tb.measure.thickness(solid.astype(np.uint8)) / 3
    field = signed_distance(solid) + step * profile
    level = np.quantile(field, 1 - solid.mean())
    grown = np.where(solid, image.values, 1)
    values = np.where(field > level, grown, 0).astype(np.uint8)
    return tb.Image(values, "labels", spacing=image.spacing, unit=image.unit, phases=image.phases)

"""Error rates of the certificate, as measured: how often it fails real material, and fakes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from trabecula.core.image import Image


class Rates(NamedTuple):
    """Verdicts on samples of known origin."""

    level: str
    command: str
    """That measured them."""
    scans: int
    exemplar: tuple[int, int]
    """Least and largest side of the exemplars, voxels."""
    image: tuple[int, int]
    """The same of the images."""
    real: int
    """Parts of the scans that share no voxel with the exemplar."""
    real_failed: int
    real_undecided: int
    fakes: int
    kinds: int
    fakes_failed: int


MEASURED = Rates(
    "default", "trabecula bench zoo", 10, (48, 128), (48, 64), 61, 17, 21, 251, 17, 207
)
"""See docs/guide/figures.md for the table by material and kind."""


def rates_note(exemplar: Image, image: Any, level: str) -> Iterator[str]:
    """Yield the error rates in one sentence where they were measured: at this level, of volumes of
    labels of these sizes.
    """
    found = MEASURED
    if level != found.level or exemplar.kind != "labels" or exemplar.ndim != 3:
        return
    measured = zip((exemplar, image), (found.exemplar, found.image), strict=True)
    if not all(low <= side <= high for one, (low, high) in measured for side in one.shape):
        return
    passed = found.real - found.real_failed - found.real_undecided
    yield (
        f"Error rates ({found.command}: {found.scans} materials, level {found.level}, exemplars of "
        f"{found.exemplar[0]} to {found.exemplar[1]} and images of {found.image[0]} to "
        f"{found.image[1]} voxels a side): of {found.real} real parts that the exemplar does not "
        f"hold {passed / found.real:.0%} passed, {found.real_failed / found.real:.0%} failed and "
        f"{found.real_undecided / found.real:.0%} were not decided; of {found.fakes} fakes of "
        f"{found.kinds} kinds {found.fakes_failed / found.fakes:.0%} failed."
    )

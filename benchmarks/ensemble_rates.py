"""How often the certificate of an ensemble fails ensembles of the very same material, and those
that are wrong in one way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from statistics import NormalDist

import numpy as np

import trabecula as tb
from common import table

WIDTH, MARGIN = 1.5, 8
"""Standard deviation of the kernel that noise is smoothed by, and voxels cut from every face, so
that a box is one of an endless field."""
SHARE = 0.3
TRIALS, MEMBERS = 60, 16
SIZES = ((72, 24), (48, 48))
"""Sides of the exemplar and of the members."""


def ensemble_rates() -> None:
    """Verdicts at level "quick" of 60 ensembles of 16 thresholded Gaussian fields each, against
    another sample of the field.
    """
    row = table("members", "exemplar", "side", "pass", "fail", "cannot tell", wide=34)
    for exemplar, side in SIZES:
        for name, make in CASES.items():
            found: Counter[str] = Counter()
            for trial in range(TRIALS):
                rng = np.random.default_rng(trial)
                scan = binary(field(rng, exemplar))
                found[tb.verify_ensemble(scan, make(rng, side), level="quick").verdict] += 1
            row(name, exemplar, side, found["pass"], found["fail"], found["cannot tell"])


def field(rng: np.random.Generator, side: int, width: float = WIDTH) -> np.ndarray:
    """Return a Gaussian field of unit variance."""
    whole = side + 2 * MARGIN
    noise = np.fft.rfftn(rng.normal(size=(whole,) * 3))
    for axis, waves in enumerate((np.fft.fftfreq, np.fft.fftfreq, np.fft.rfftfreq)):
        kernel = np.exp(-2 * (np.pi * width * waves(whole)) ** 2)
        noise *= kernel.reshape([-1 if a == axis else 1 for a in range(3)])
    smooth = np.fft.irfftn(noise, s=(whole,) * 3, axes=(0, 1, 2))
    inner = slice(MARGIN, whole - MARGIN)
    return smooth[inner, inner, inner] * (2 * np.sqrt(np.pi) * width) ** 1.5


def binary(values: np.ndarray, level: float | None = None) -> tb.Image:
    """Cut a field at a level, by default at that of `SHARE`."""
    level = NormalDist().inv_cdf(1 - SHARE) if level is None else level
    return tb.Image((values > level).astype(np.uint8), "labels")


def real(rng: np.random.Generator, side: int) -> list[tb.Image]:
    """Make members of the very same material."""
    return [binary(field(rng, side)) for _ in range(MEMBERS)]


def repeated(rng: np.random.Generator, side: int) -> list[tb.Image]:
    """Make one member, again and again."""
    return [binary(field(rng, side))] * MEMBERS


def even(rng: np.random.Generator, side: int) -> list[tb.Image]:
    """Make members of the same porosity."""
    fields = [field(rng, side) for _ in range(MEMBERS)]
    return [binary(each, float(np.quantile(each, 1 - SHARE))) for each in fields]


def denser(rng: np.random.Generator, side: int) -> list[tb.Image]:
    """Make members denser by 1.5 standard deviations of a member's porosity."""
    fields = [field(rng, side) for _ in range(MEMBERS)]
    level = NormalDist().inv_cdf(1 - SHARE)
    more = SHARE + 1.5 * float(np.std([np.mean(each > level) for each in fields]))
    return [binary(each, NormalDist().inv_cdf(1 - more)) for each in fields]


def coarser(rng: np.random.Generator, side: int) -> list[tb.Image]:
    """Make members whose lengths are 15 % longer."""
    return [binary(field(rng, side, 1.15 * WIDTH)) for _ in range(MEMBERS)]


CASES: dict[str, Callable[[np.random.Generator, int], list[tb.Image]]] = {
    "the same material": real,
    "one member repeated": repeated,
    "all of one porosity": even,
    "denser by 1.5 standard deviations": denser,
    "lengths 15 % longer": coarser,
}

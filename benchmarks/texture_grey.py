"""Grey scans by `texture`: as labels and as they are, by the same figures at the exemplar's own
iso-value.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from by_example import figures
from common import SCANS, asked, busy, pictures, table
from descriptors import GREY
from texture import fitted
from trabecula.report.descriptors import TextureDescriptors
from trabecula.report.evenness import choose_windows
from trabecula.report.reference import Reference
from trabecula.view.slices import montage

SIDE, RESULT = 80, 96
LAGS, BANDS = 16, 8
WAYS = ("labels", "grey")
"""Whether `texture` learns from the segmented exemplar or from the scan."""


def texture_grey() -> None:
    """96^3 from 80^3 of every grey scan, one seed: made as labels of the segmented exemplar, and
    made as grey values and then segmented at the exemplar's threshold.

    D2, thickness and Euler density are those of `by_example`; `spectrum` the least and the greatest
    ratio of the power to the exemplar's, from the autocorrelation in 8 bands without the
    lowest; `histogram` the Kullback-Leibler divergence; `out` how many figures of `verify` of
    the grey values lie outside their bands. `TRABECULA_BENCH_ONLY` names exemplars.
    """
    heads = ("phases", "D2", "thickness", "Euler", "N_cc", "coherence(4)")
    row = table("exemplar, made as", *heads, "spectrum", "histogram", "out", "of", "CPU s", wide=28)
    for name, exemplar in _exemplars():
        solid = tb.segment(exemplar)
        threshold = solid.recipe.steps[-1]["threshold"]
        reference, shown = _reference_of(exemplar), {name: exemplar}
        for way in WAYS:
            model = fitted(solid if way == "labels" else exemplar, {})
            seconds, made = busy(lambda m=model: m.generate(RESULT, seed=1))
            cut = made if way == "labels" else tb.segment(made, threshold)
            found = figures(solid, cut)
            report = made.recipe.steps[-1].get("report", {})
            told = (
                report.get("phases", "-"),
                f"{found.distance:.2f}",
                f"{found.thickness:.2f}",
                f"{found.euler:.2f}",
                found.components,
                f"{found.coherence:.2f}",
            )
            levels = ("", "", "", "") if way == "labels" else _levels(reference, exemplar, made)
            row(f"{name}, {way}", *told, *levels, f"{seconds:.0f}")
            if way != "labels":
                shown[way] = made
        if folder := pictures():
            montage(list(shown.values()), list(shown), folder / f"texture-grey-{name}.png")


def _exemplars() -> Iterator[tuple[str, tb.Image]]:
    """Yield the centres of the grey scans that are here, by name."""
    for name, (file, edge, unit) in GREY.items():
        if (SCANS / file).is_file() and name in (asked("ONLY") or GREY):
            scan = tb.read(SCANS / file, spacing=edge, unit=unit, kind="grey")
            yield name, tb.crop(scan, SIDE)


def _reference_of(exemplar: tb.Image) -> Reference:
    """Measure what `verify` holds a grey image against, once for all of a table."""
    windows = choose_windows(exemplar, [exemplar])
    descriptors = TextureDescriptors(exemplar, lags=LAGS, windows=windows)
    return Reference(exemplar, descriptors, copying=False)


def _levels(reference: Reference, exemplar: tb.Image, made: tb.Image) -> tuple[object, ...]:
    """Return the cells that describe grey values."""
    metrics = reference.judge(reference.measure(made), None)
    decided = [metric.passed for metric in metrics.values() if metric.passed is not None]
    ratio = (_spectrum(made) / _spectrum(exemplar))[1:]
    return (
        f"{ratio.min():.2f}-{ratio.max():.2f}",
        f"{metrics['histogram_divergence'].value:.4f}",
        decided.count(False),
        len(decided),
    )


def _spectrum(image: tb.Image) -> np.ndarray:
    """Return the power in bands of frequency up to the highest along an axis."""
    rho = tb.measure.autocorrelation(image, lags=LAGS) * np.var(image.values, dtype=np.float64)
    window = np.hanning(2 * LAGS + 3)[1:-1]
    rho *= window[:, None, None] * window[:, None] * window
    power = np.abs(np.fft.fftn(rho))
    squares = [np.fft.fftfreq(2 * LAGS + 1) ** 2] * 3
    band = (2 * BANDS * np.sqrt(sum(np.ix_(*squares)))).astype(int)
    return np.bincount(band.ravel(), power.ravel())[:BANDS]

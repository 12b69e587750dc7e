"""A scan that is down-sampled, and a slice of another part of it: what comes back of the volume."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

import trabecula as tb
from common import asked, table, timed
from descriptors import scans
from image import draw, side_of
from trabecula.core.checks import check_name
from trabecula.core.errors import TrabeculaError
from trabecula.measure.correlation import two_point

SCANS = ("Berea", "NMC", "bone a", "cathode, coarse")
TIMES = 4
"""Voxels of the scan in one of the coarse scan, along every axis."""

NOISE = 6.0
"""Standard deviation of the grey values of a coarse scan, between whose phases there are 120."""

REACH = 32


def fusion() -> None:
    """96^3 of a scan from its 24^3 and one slice of another part, beside the scan.

    Labels of the coarse scan are the majority of 4^3 voxels, grey values their mean with noise.
    `linear` cuts the labels (of grey: the values) at their middle, linear between voxels' centres.
    `voxels` is the share of coarse voxels that come out when the result is down-sampled, of grey
    ones within three deviations of the noise; S2 the relative l2 of the two-point function over r =
    0 .. 32; all but these and the seconds are ratios to the scan's. D is the diffusivity, k the
    permeability, both the mean of three axes; - where the scan's phase does not percolate.
    """
    heads = ("voxels", "S2", "porosity", "surface", "Euler", "thickness", "D void", "D solid", "k")
    row = table("scan, coarse, by", *heads, "s", wide=34)
    for name, scan in _chosen().items():
        truth, picture = _parts(scan)
        share = block_means(truth.values > 0)
        labels = tb.Image((share >= 0.5).astype(np.uint8), "labels", phases=truth.phases)
        noise = np.random.default_rng(0).normal(0, NOISE, share.shape)
        grey = tb.Image(np.rint(60 + 120 * share + noise).clip(0, 255).astype(np.uint8), "grey")
        real, shown = figures(truth), {"the scan": truth}
        _row(row, f"{name}: the scan", truth, real, labels, truth, "-")
        model = tb.method("kopf").fit(picture)
        for words, coarse, middle in (("labels", labels, 0.5), ("grey", grey, 120.0)):
            jobs: dict[str, Callable[[], tb.Image]] = {
                "linear": partial(interpolate, coarse, middle, truth.phases),
                "kopf": partial(model.generate, truth.shape, coarse=coarse, seed=0),
            }
            for by, job in jobs.items():
                seconds, made = timed(job)
                shown[f"{words}, {by}"] = made
                _row(row, f"{name}: {words}, {by}", made, real, coarse, truth, f"{seconds:.1f}")
        draw(f"fusion {name}", [picture], shown)


def fusion_slices() -> None:
    """The same from labels and other slices: ratios of surface, Euler and diffusivity to the scan.

    Slices are of the part beyond the 96^3 along x: its middle across z and across y, and a quarter
    and three quarters of it across x; seeds 0 .. 3.
    """
    names = ("porosity", "surface", "Euler", "D void", "D solid")
    row = table("scan, slice", "its porosity", *names, wide=34)
    for name, scan in _chosen().items():
        truth, _ = _parts(scan)
        labels = (block_means(truth.values > 0) >= 0.5).astype(np.uint8)
        coarse = tb.Image(labels, "labels", phases=truth.phases)
        real = figures(truth, flow=False)
        beyond = scan.values[:, :, truth.shape[2] :]
        cuts = [(0, 0.5), (1, 0.5), (2, 0.25), (2, 0.75)]
        for seed, (axis, place) in enumerate(cuts):
            values = beyond.take(int(place * beyond.shape[axis]), axis)
            picture = tb.Image(np.ascontiguousarray(values), "labels", phases=scan.phases)
            made = tb.method("kopf").fit(picture).generate(truth.shape, coarse=coarse, seed=seed)
            found = figures(made, flow=False)
            ratios = [f"{found[one] / real[one]:.2f}" if real[one] else "-" for one in names]
            own = f"{tb.measure.porosity(picture):.3f}"
            row(f"{name}: across {'zyx'[axis]}, {place}", own, *ratios)


def block_means(values: np.ndarray) -> np.ndarray:
    """The mean of every block of TIMES^3."""
    z, y, x = (side // TIMES for side in values.shape)
    return values.reshape(z, TIMES, y, TIMES, x, TIMES).mean(axis=(1, 3, 5))


def interpolate(coarse: tb.Image, middle: float, phases: tuple[str, ...]) -> tb.Image:
    """Linear between the centres of voxels, cut at the middle."""
    field = coarse.values.astype(np.float32)
    for axis, side in enumerate(field.shape):
        at = (np.arange(side * TIMES) + 0.5) / TIMES - 0.5
        first = np.clip(np.floor(at), 0, side - 2).astype(int)
        weight = np.clip(at - first, 0, 1).astype(np.float32)
        weight = weight.reshape([-1 if n == axis else 1 for n in range(field.ndim)])
        field = field.take(first, axis) * (1 - weight) + field.take(first + 1, axis) * weight
    return tb.Image((field > middle).astype(np.uint8), "labels", phases=phases)


def figures(image: tb.Image, *, flow: bool = True) -> Mapping[str, float]:
    """What the rows compare; permeability takes longest."""
    found = {
        "porosity": tb.measure.porosity(image),
        "surface": tb.measure.specific_surface(image),
        "Euler": tb.measure.euler_density(image),
        "thickness": tb.measure.thickness(image),
        "D void": _mean(lambda axis: tb.measure.diffusivity(image, axis=axis, phase="void")),
        "D solid": _mean(lambda axis: tb.measure.diffusivity(image, axis=axis, phase="solid")),
    }
    if flow:
        found["k"] = _mean(lambda axis: tb.measure.permeability(image, axis=axis))
    return found


def _mean(measure: Callable[[int], tb.measure.TransportResult]) -> float:
    try:
        return float(np.mean([measure(axis).value for axis in range(3)]))
    except TrabeculaError:
        return 0.0


def _parts(scan: tb.Image) -> tuple[tb.Image, tb.Image]:
    """The first 96^3, and a slice beyond it: across z, or across x where there is none."""
    side = min(side_of(96), *scan.shape) // TIMES * TIMES
    plain = tb.Image(scan.values, "labels", phases=scan.phases)
    truth = tb.crop(plain, side, corner=(0, 0, 0))
    depth, _, across = scan.shape
    beyond = (depth + side) // 2
    if beyond - side >= side // 4:
        picture = plain.values[beyond]
    else:
        picture = plain.values[:, :, (across + side) // 2]
    return truth, tb.Image(np.ascontiguousarray(picture), "labels", phases=scan.phases)


def reproduced(made: tb.Image, coarse: tb.Image) -> float:
    """The share of coarse voxels that come out."""
    share = block_means(made.values > 0)
    if coarse.kind == "labels":
        return float(np.mean((share >= 0.5) == (coarse.values > 0)))
    return float(np.mean(np.abs(60 + 120 * share - coarse.values) <= 3 * NOISE + 0.5))


def _row(row, words, made, real, coarse, truth, seconds) -> None:
    curves = [two_point(one, r_max=REACH) for one in (made, truth)]
    off = np.linalg.norm(curves[0] - curves[1]) / np.linalg.norm(curves[1])
    found = figures(made)
    ratios = [f"{found[name] / real[name]:.2f}" if real[name] else "-" for name in real]
    row(words, f"{100 * reproduced(made, coarse):.2f} %", f"{off:.4f}", *ratios, seconds)


def _chosen() -> dict[str, tb.Image]:
    found = scans()
    for name in asked("ONLY"):
        check_name(name, found, name="scan")
    wanted = asked("ONLY") or SCANS
    return {name: found[name] for name in wanted if name in found} or dict(list(found.items())[:1])

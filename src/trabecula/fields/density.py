"""A random field of local density: that of material larger than the scan it is learned from.

A scan knows how the fraction of windows differs from place to place, and over which distances. A
Gaussian random field with the covariance of the windows' normal scores, mapped to their histogram,
continues that to any shape (a translation process: Grigoriu 1984,
doi:10.1061/(ASCE)0733-9399(1984)110:4(610)).

The field stands on a lattice of `STEPS` points a window, and cubic B-splines carry it to voxels.
White noise and filter are whole numbers, so their convolution by Fourier transform is exact: the
value of a voxel depends on the seed and on its place alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_seed
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.seeds import key
from trabecula.engine.gaussian_random import ONE, normal_line, quantiles
from trabecula.engine.parallel import for_slabs
from trabecula.fields.grid import AXES, as_sides, of_image
from trabecula.fields.local import windowed
from trabecula.measure.correlation import correlation_length
from trabecula.numerics.transforms import fast_side, sums_by_offset

WIDE, SHARE = 2.0, 0.25
"""Edge of a window where none is given: correlation lengths, at least, and share of the shortest
side. Methods take as a target what windows of a quarter of the exemplar's sides hold; narrower ones
are denser and sparser than they can make.
"""
STEPS = 4
"""Points of the lattice a window: fewer leave its waves between the points."""
FEWEST = 3
"""Windows along an axis, below which the covariance between them is not known."""
_LEAST_WINDOW = 8
_WHITE, _FILTER = 256, 1 << 14  # the whole numbers that stand for 1
_FLOOR = 0.05  # of the spectrum of B-splines, where it is divided by
_KNOTS = 1025


def density_like(
    exemplar: Image | ArrayLike,
    shape: int | Sequence[int],
    *,
    window: int | None = None,
    phase: str | int | None = None,
    seed: int = 0,
) -> Image:
    """Draw a field of local volume fraction that varies as that of an exemplar, of any shape.

    Parameters
    ----------
    exemplar : Image or array of labels, (Z, Y, X) or (Y, X)
    shape : int or one per axis
        Voxels of the field, which may be larger than the exemplar; one number means a cube.
    window : int, optional
        Side of the windows in voxels, brought to a multiple of 4. Density that varies over shorter
        distances is left to the method. Default: a quarter of the shortest side, as large as
        methods take targets from, and two correlation lengths at least.
    phase : str or int, optional
        Default: "solid", which is every phase but "void". "void" gives a field of porosity.
    seed : int

    Returns
    -------
    field : Image
        Grey, float32, with the exemplar's spacing. A larger shape begins with the same values.

    Raises
    ------
    InputError
        Fewer than three windows along an axis of the exemplar, or a shape of another dimension.

    Notes
    -----
    Windows lie closer to the mean of their own scan than to that of the material. Covariance and
    histogram are widened by the variance of this mean, which follows from the covariance itself.

    Examples
    --------
    >>> from trabecula.exemplar.samples import sample
    >>> field = density_like(sample("bone"), (40, 60, 60), window=16, seed=1)
    >>> field.shape, bool(abs(field.values.mean() - 0.18) < 0.05)
    ((40, 60, 60), True)
    """
    image = as_image(exemplar)
    sides = as_sides([shape] * 2 if image.ndim == 2 and isinstance(shape, int) else shape)
    if len(sides) != image.ndim:
        raise InputError(
            f"a field of shape {sides} is not of the exemplar's dimension: give {image.ndim} "
            "numbers"
        )
    width = _window(image, window, phase)
    settings = {"shape": sides, "window": width, "phase": phase, "seed": as_seed(seed)}
    windows = windowed(image, size=width, phase=phase)["volume_fraction"]
    step = width // STEPS
    points = windows[(slice(None, None, step),) * image.ndim]
    if points.min() == points.max():
        return of_image(np.full(sides, points.flat[0]), "density_like", settings, image)
    scores = _normal_scores(points)
    weights, spread = _filter(scores)
    level = _histogram(points, scores, spread)
    field = _draw(sides, step, weights, level, as_seed(seed))
    return of_image(field, "density_like", settings, image)


def _window(image: Image, window: int | None, phase: str | int | None) -> int:
    """Return the side of the windows, a multiple of `STEPS`, of which `FEWEST` fit."""
    if window is None:
        length = correlation_length(image, phase=phase) / min(image.spacing)
        length = length if np.isfinite(length) else max(image.shape)
        wide = max(_LEAST_WINDOW, WIDE * length, STEPS * int(SHARE * min(image.shape) / STEPS))
    else:
        wide = as_number(window, name="window", low=STEPS, high=1 << 20, whole=True)
    width = STEPS * max(1, round(wide / STEPS))
    short = [
        f"{side / width:.1f} along {name}"
        for name, side in zip(AXES[image.ndim], image.shape, strict=True)
        if side < FEWEST * width
    ]
    if short:
        room = STEPS * (min(image.shape) // (FEWEST * STEPS))
        other = f", or a window of {room} voxels" if room >= STEPS else ""
        raise InputError(
            f"the exemplar holds {', '.join(short)} windows of {width} voxels: how density varies "
            f"between windows is known from {FEWEST} of them on; give a larger scan{other}"
        )
    return int(width)


def _normal_scores(values: np.ndarray) -> np.ndarray:
    """Return the normal deviation of every value's rank."""
    order = np.argsort(values, axis=None, kind="stable")
    table = quantiles()
    places = ((np.arange(values.size) + 0.5) / values.size * len(table)).astype(np.int64)
    scores = np.empty(values.size)
    scores[order] = table[places] / ONE
    return scores.reshape(values.shape)


def _filter(scores: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the weights of white noise on the lattice, whole numbers, and the standard deviation
    that they lead to at the voxels: that of scores around the mean of the material.
    """
    reach = tuple(side // 2 for side in scores.shape)
    lags = np.meshgrid(*(np.arange(-far, far + 1) for far in reach), indexing="ij")
    pairs = np.ones(lags[0].shape)
    distance = np.zeros(lags[0].shape)
    for lag, far, side in zip(lags, reach, scores.shape, strict=True):
        pairs *= side - np.abs(lag)
        distance += (lag / (far + 1)) ** 2
    # Covariance over half of the longest lag and more is known by chance: it is let go smoothly.
    taper = (1 + np.cos(np.pi * np.clip(2 * np.sqrt(distance) - 1, 0, 1))) / 2
    found = sums_by_offset(scores - scores.mean(), reach) / pairs
    # The variance of the scan's own mean is missing at every lag alike.
    share = taper * pairs / scores.size**2
    missing = max(0.0, float((share * found).sum())) / max(1e-3, 1 - float(share.sum()))
    covariance = taper * (found + missing)
    variance = float(covariance[reach])
    torus = [fast_side(4 * far + 2) for far in reach]
    spectrum = np.fft.fftn(_centred(covariance, torus)).real
    spline = _spline_spectrum(torus)
    power = np.sqrt(np.maximum(spectrum, 0) / np.maximum(spline**2, _FLOOR))
    around = np.fft.ifftn(power).real
    weights = np.roll(around, reach, range(len(reach)))[tuple(slice(2 * far + 1) for far in reach)]
    shown = np.fft.ifftn(np.fft.fftn(_centred(weights, torus)) * spline).real
    weights = weights * np.sqrt(variance / (shown**2).sum())
    return np.rint(weights * _FILTER), float(np.sqrt(variance))


def _centred(values: np.ndarray, torus: Sequence[int]) -> np.ndarray:
    """Return values around 0 on a torus, their middle at its first point."""
    whole = np.zeros(torus)
    whole[tuple(slice(side) for side in values.shape)] = values
    return np.roll(whole, [-(side // 2) for side in values.shape], range(values.ndim))


def _spline_spectrum(torus: Sequence[int]) -> np.ndarray:
    """Return the transform of the cubic B-spline at the points of the lattice: 1/6, 2/3, 1/6."""
    lines = [2 / 3 + np.cos(2 * np.pi * np.arange(side) / side) / 3 for side in torus]
    return np.prod(np.meshgrid(*lines, indexing="ij", sparse=False), axis=0)


def _histogram(
    points: np.ndarray, scores: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return knots of the map from scores to fractions, both widened around their middle."""
    places = np.linspace(0, points.size - 1, min(points.size, _KNOTS)).astype(np.int64)
    ranked, mean = np.sort(points, axis=None), float(points.mean())
    fractions = mean + spread * (ranked[places] - mean)
    return np.sort(scores, axis=None)[places] * spread, np.clip(fractions, 0, 1)


def _draw(
    sides: tuple[int, ...],
    step: int,
    weights: np.ndarray,
    level: tuple[np.ndarray, np.ndarray],
    seed: int,
) -> np.ndarray:
    """Return the field (Z, Y, X) or (Y, X) float32 of a seed."""
    lattice = _lattice([(side - 1) // step + 4 for side in sides], weights, seed)
    field = np.empty(sides, np.float32)
    planes = field if field.ndim == 3 else field[None]

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            plane = lattice
            if lattice.ndim == 3:
                at, taps = _taps(np.array([z]), step)
                plane = np.tensordot(taps[:, 0], lattice[at[0] : at[0] + 4], 1)
            for axis in (0, 1):
                at, taps = _taps(np.arange(planes.shape[axis + 1]), step)
                shares = taps[:, :, None] if axis == 0 else taps[:, None]
                rows = [shares[n] * plane.take(at + n, axis) for n in range(4)]
                plane = rows[0] + rows[1] + rows[2] + rows[3]
            planes[z] = np.interp(plane, *level)

    for_slabs(work, len(planes))
    return field


def _taps(places: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of four points of the lattice for every voxel, and their B-spline weights
    (4, n).
    """
    at, rest = np.divmod(places, step)
    t = (rest + 0.5) / step
    return at, np.stack(
        [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    ) / 6


def _lattice(counts: Sequence[int], weights: np.ndarray, seed: int) -> np.ndarray:
    """Return filtered white noise at the first points of the lattice, exact to the last bit."""
    around = [count + side - 1 for count, side in zip(counts, weights.shape, strict=True)]
    noise = np.empty([1] * (3 - len(around)) + around)
    stage, table = key(seed, "density"), quantiles(_WHITE)
    for z in range(noise.shape[0]):
        for y in range(noise.shape[1]):
            normal_line(noise[z, y], stage, z, y, 0, 0, table)
    sides, axes = [fast_side(side) for side in around], tuple(range(len(around)))
    spectrum = np.fft.rfftn(noise.reshape(around), sides, axes)
    spectrum *= np.fft.rfftn(weights, sides, axes)
    sums = np.fft.irfftn(spectrum, sides, axes)
    inner = tuple(
        slice(side - 1, side - 1 + count) for side, count in zip(weights.shape, counts, strict=True)
    )
    return np.rint(sums[inner]) / (_WHITE * _FILTER)

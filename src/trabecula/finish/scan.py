"""`scan`: labels as a scanner would show them, and `fit_scan`: how a real scan shows them.

1. Partial volume: every phase covers a share of a voxel, by the distance of the voxel's middle from
   the interface. That is the surface where the smoothed indicator is 1/2, so the staircase of the
   labels does not show; a voxel's own phase covers at least half of it. Whoever labels a scan may
   draw the bright phase wider or thinner than it is at half its level: that is `inset`.
2. The shares times the phases' grey levels, blurred by the point-spread function, a Gaussian.
3. Beam hardening: values fall towards the axis (cupping), as 1 - c (1 - r^2 / R^2), R half the
   shorter side across the axis.
4. Noise, normal, of a standard deviation and a spectrum for every phase: white noise convolved
   along each axis with the symmetric square root of its autocovariance. The noise of the quietest
   phase is the scanner's, and is everywhere; what others have beyond it is their own structure,
   and fades towards their interface.
5. Rings about the axis: a number for every slice and radius.
6. Rounded and cut off at the ends of the type.

Random numbers are functions of seed and coordinate, and everything else looks at most some voxels
far, so any slab of a volume comes out as in the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine.gaussian_random import normal_cells, quantiles
from trabecula.engine.memory import Plan, check_budget
from trabecula.exemplar.segment import segment
from trabecula.measure.distance import distance_transform
from trabecula.measure.smooth import gaussian, reach_of

TYPES = ("uint8", "uint16", "float32")
"""Types of the grey values."""

_EDGE = 0.7
"""Sigma, voxels, that takes the staircase off the interface."""

_TAPS = 8
"""Voxels to either side over which noise is correlated."""

_DEPTH = 32
"""Slices that are made at once."""

_INSIDE = (2.5, 3.5)
"""Distances from the interface, voxels, beyond which a voxel is its phase alone: bright, dark."""

_SIGMAS = tuple(round(0.1 * k, 1) for k in range(31))
_INSETS = tuple(round(0.1 * k, 1) for k in range(-10, 11))
"""Blurs and insets that are tried in a fit."""

_FITTED = 64
"""Side of the middle that they are fitted in, voxels."""

_RING_SHARE = (0.75 - 0.125) ** 2 + 0.125**2
"""Half the mean square of the step between means of neighbouring rings, for rings of variance 1."""

Taps = tuple[tuple[float, ...], ...]
"""Along z, y, x: weights of offsets 0, 1, 2, ... to both sides."""


@dataclass(frozen=True)
class ScanModel:
    """How a scanner shows a material.

    Parameters
    ----------
    levels : tuple of float
        Grey level of every phase.
    blur : float
        Sigma of the point-spread function in voxels, 0..20.
    noise : tuple of float
        Standard deviation of the noise in every phase, in grey levels.
    grain : tuple of taps, one a phase
        Along z, y, x the weights of white noise at offsets 0, 1, 2, ...; their squares over both
        sides sum to 1.
    cupping : float
        Share by which values fall on the axis z through the middle, 0..0.9.
    rings : float
        Standard deviation of the rings about that axis, in grey levels.
    inset : float
        Voxels by which the brightest phase lies inside its labels, -1..1.
    dtype : str
        "uint8", "uint16" or "float32".
    """

    levels: tuple[float, ...]
    blur: float = 0.8
    noise: tuple[float, ...] = ()
    grain: tuple[Taps, ...] = ()
    cupping: float = 0.0
    rings: float = 0.0
    inset: float = 0.0
    dtype: str = "uint8"

    __repr__ = brief

    def __post_init__(self) -> None:
        count = len(self.levels)
        levels = tuple(_number(level, "level", -1e6, 1e6) for level in self.levels)
        spread = max(levels) - min(levels) if levels else 0.0
        noise = tuple(_number(one, "noise", 0, 1e6) for one in self.noise)
        object.__setattr__(self, "levels", levels)
        object.__setattr__(self, "noise", noise or (0.1 * spread,) * count)
        object.__setattr__(self, "grain", self.grain or (gaussian_grain(0.6),) * count)
        object.__setattr__(self, "blur", _number(self.blur, "blur", 0, 20))
        object.__setattr__(self, "cupping", _number(self.cupping, "cupping", 0, 0.9))
        object.__setattr__(self, "rings", _number(self.rings, "rings", 0, 1e6))
        object.__setattr__(self, "inset", _number(self.inset, "inset", -1, 1))
        check_name(self.dtype, TYPES, name="type of a scan")
        if len(self.noise) != count or len(self.grain) != count or count < 2:
            raise InputError(
                f"a scan of {count} levels has {len(self.noise)} noises and {len(self.grain)} "
                "grains: give one of each for every phase, of two phases or more"
            )

    @property
    def halo(self) -> int:
        """Return how many voxels far a voxel depends on the labels."""
        return reach_of(_EDGE) + 1 + reach_of(self.blur)


def _number(value: Any, name: str, low: float, high: float) -> float:
    return float(as_number(value, name=name, low=low, high=high))


def gaussian_grain(sigma: float) -> Taps:
    """Return the taps of noise that is white noise smoothed by a Gaussian of `sigma` voxels."""
    at = np.arange(_TAPS + 1)
    weights = np.exp(-0.5 * (at / max(sigma, 1e-6)) ** 2)
    return (_normalise(weights),) * 3


def _normalise(weights: np.ndarray) -> tuple[float, ...]:
    """Return weights whose squares over both sides sum to 1, few enough to matter."""
    total = weights[0] ** 2 + 2 * np.sum(weights[1:] ** 2)
    scaled = weights / np.sqrt(total)
    last = int(np.flatnonzero(np.abs(scaled) > 1e-3).max(initial=0))
    return tuple(round(float(weight), 6) for weight in scaled[: last + 1])


def scan(
    image: Image | ArrayLike,
    *,
    like: Image | None = None,
    model: ScanModel | None = None,
    seed: int = 0,
    **settings: Any,
) -> Image:
    """Make the grey scan of labels that a scanner would give: what a segmenter is trained on.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Voxels are the scanner's.
    like : Image, grey, optional
        A real scan, from which levels, blur, noise and its spectrum, cupping and rings are learned
        (`fit_scan`). For labels of two phases.
    model : ScanModel, optional
        Instead of a scan.
    seed : int
        0 .. 2**63 - 1.
    **settings
        Fields of `ScanModel` that replace those learned: levels, blur, noise, grain, cupping,
        rings, inset, dtype. Without a scan or model the levels are even from 60 to 180, the noise
        a tenth of their distance.

    Returns
    -------
    image : Image
        Grey, of the same shape and spacing. The recipe's step holds the model, so that it is made
        again without the real scan.

    Raises
    ------
    InputError
        No labels; a scan that is not grey; settings out of range, or for another number of phases.
    UnknownNameError
        A setting that does not exist.
    MemoryBudgetError
        It does not fit into memory.

    Examples
    --------
    >>> cube = np.zeros((8, 8, 8), int); cube[2:6, 2:6, 2:6] = 1
    >>> grey = scan(cube, levels=(20, 200), blur=0, noise=(0, 0))
    >>> grey.values[4, 4].tolist()
    [20, 20, 110, 200, 200, 110, 20, 20]
    """
    image = as_image(image)
    check_labels(image)
    check_budget(
        Plan({"labels and grey": 6 * image.values.size, "slab": _slab_bytes(image)}),
        advice="scan a crop",
    )
    chosen = _choose_model(image, like, model, settings)
    lifted = image.values.reshape((1,) * (3 - image.ndim) + image.shape)
    out = np.empty(lifted.shape, chosen.dtype)
    starts = range(0, len(lifted), _DEPTH)
    for start in track(starts, "scanning", total=len(starts)):
        stop = min(start + _DEPTH, len(lifted))
        out[start:stop] = _round(scan_slab(lifted, chosen, seed, start, stop), chosen.dtype)
    values = out.reshape(image.shape)
    step = {
        "levels": list(chosen.levels),
        "blur": chosen.blur,
        "noise": list(chosen.noise),
        "grain": [[list(taps) for taps in axes] for axes in chosen.grain],
        "cupping": chosen.cupping,
        "rings": chosen.rings,
        "inset": chosen.inset,
        "dtype": chosen.dtype,
        "seed": seed,
    }
    before = image.recipe if image.recipe else image.recipe.then("array", image.values)
    shown = {name: step[name] for name in ("levels", "blur", "inset", "noise", "cupping", "rings")}
    recipe = before.then("finish", values, operation="scan", settings=step, report=shown)
    return Image(values, "grey", image.spacing, image.unit, recipe=recipe)


def _slab_bytes(image: Image) -> int:
    plane = int(np.prod(image.shape[-2:]))
    return 4 * (6 + 2 * len(image.phases)) * plane * (_DEPTH + 80)


def _choose_model(
    image: Image, like: Image | None, model: ScanModel | None, settings: dict[str, Any]
) -> ScanModel:
    """Return the model that is given, learned or the default, with the settings in it."""
    names = [name for name in ScanModel.__dataclass_fields__]
    for name in settings:
        check_name(name, names, name="setting of a scan")
    if like is not None and model is not None:
        raise InputError("a scan and a model were given: give one of them")
    count = len(image.phases)
    if like is not None:
        if count != 2:
            raise InputError(
                f"the labels have {count} phases, and a scan alone tells two apart: fit a model "
                "with labels of it (tb.finish.fit_scan(scan, labels))"
            )
        model = fit_scan(like)
        if "void" in image.phases and image.phases.index("void") == 1:
            model = _changed(model, {"levels": model.levels[::-1], "noise": model.noise[::-1]})
    if model is None:
        known = {"levels": tuple(np.linspace(60, 180, count).tolist())}
        return ScanModel(**{**known, **_tuples(settings)})
    found = _changed(model, settings)
    if len(found.levels) != count:
        raise InputError(
            f"the model has {len(found.levels)} levels, the image {count} phases: fit one with "
            "labels of as many (tb.finish.fit_scan)"
        )
    return found


def _changed(model: ScanModel, settings: dict[str, Any]) -> ScanModel:
    old = {name: getattr(model, name) for name in ScanModel.__dataclass_fields__}
    return ScanModel(**{**old, **_tuples(settings)})


def _tuples(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings with tuples in place of lists, as JSON has them."""

    def convert(value: Any) -> Any:
        several = isinstance(value, (list, tuple, np.ndarray))
        return tuple(convert(one) for one in value) if several else value

    found = {name: convert(value) for name, value in settings.items()}
    for name in ("levels", "noise", "grain"):
        if name in found and not isinstance(found[name], tuple):
            raise InputError(f"{name} {quote(found[name])}: give one for every phase, in a list")
    return found


def scan_slab(labels: np.ndarray, model: ScanModel, seed: int, start: int, stop: int) -> np.ndarray:
    """Return the slices start..stop of the scan of labels, (stop - start, Y, X) float32."""
    halo = model.halo
    planes = np.arange(start - halo, stop + halo).clip(0, len(labels) - 1)
    shares = coverage(labels[planes], _insets(model.levels, model.inset))
    clean = np.zeros(shares[0].shape, np.float32)
    for share, level in zip(shares, model.levels, strict=True):
        clean += share * np.float32(level)
    grey = gaussian(clean, model.blur)[halo : halo + stop - start]
    radius = _radius(labels.shape)
    if model.cupping:
        side = (
            min(side for side in labels.shape[1:] if side > 1) if max(labels.shape[1:]) > 1 else 1
        )
        far = np.minimum(radius / (side / 2), 1).astype(np.float32)
        grey *= 1 - np.float32(model.cupping) * (1 - far * far)
    inner = slice(halo, halo + stop - start)
    quiet = int(np.argmin(model.noise))
    least = model.noise[quiet]
    if least:
        white = _white(labels.shape, seed, "noise", start, stop)
        grey += np.float32(least) * _filter(white, model.grain[quiet])
    for phase, share in enumerate(shares):
        more = np.sqrt(max(model.noise[phase] ** 2 - least**2, 0.0))
        if more:
            white = _white(labels.shape, seed, f"structure/{phase}", start, stop)
            depth = (2 * share[inner] - 1).clip(0, 1)
            grey += depth * np.float32(more) * _filter(white, model.grain[phase])
    if model.rings:
        grey += _rings(labels.shape, radius, seed, start, stop) * np.float32(model.rings)
    return grey


def _insets(levels: Sequence[float], inset: float) -> tuple[float, ...]:
    """Return by how much each phase lies inside its labels: the others grow as the brightest
    shrinks.
    """
    return tuple(inset if level == max(levels) else -inset for level in levels)


def coverage(labels: np.ndarray, insets: Sequence[float]) -> list[np.ndarray]:
    """Return the share of every voxel that each phase covers, float32 arrays that sum to 1; a phase
    for each inset (see `ScanModel`).
    """
    return _shares(labels, [_distance(labels == phase) for phase in range(len(insets))], insets)


def _shares(
    labels: np.ndarray, distances: Sequence[np.ndarray], insets: Sequence[float]
) -> list[np.ndarray]:
    """Return the shares of phases by their distances from an interface (see `coverage`)."""
    found = []
    for phase, (distance, inset) in enumerate(zip(distances, insets, strict=True)):
        share = (0.5 + distance - np.float32(inset)).clip(0, 1)
        least = np.float32(min(max(0.5 - inset, 0), 1))
        inside = labels == phase
        found.append(np.where(inside, np.maximum(share, least), np.minimum(share, least)))
    total = np.maximum(np.sum(found, axis=0), np.float32(1e-6))
    return [(share / total).astype(np.float32) for share in found]


def _distance(inside: np.ndarray) -> np.ndarray:
    """Return the distance of the middles of voxels from an interface, to first order, voxels; it is
    above 0 inside.
    """
    level = gaussian(inside, _EDGE)
    slope = np.zeros_like(level)
    for axis in range(3):
        if level.shape[axis] > 1:
            slope += np.square(np.gradient(level, axis=axis))
    flat = np.sqrt(np.maximum(slope, np.float32(1e-12)))
    return np.asarray((level - np.float32(0.5)) / flat)


def _radius(shape: Sequence[int]) -> np.ndarray:
    """Return the distance of every voxel of a slice from the axis, (Y, X) float32."""
    y, x = (np.arange(side) - (side - 1) / 2 for side in shape[1:])
    return np.hypot(y[:, None], x).astype(np.float32)


def _white(shape: Sequence[int], seed: int, what: str, start: int, stop: int) -> np.ndarray:
    """Return white noise of slices start..stop with `_TAPS` voxels more on every side."""
    sides = (stop - start + 2 * _TAPS, shape[1] + 2 * _TAPS, shape[2] + 2 * _TAPS)
    cells = np.empty((1, *sides), np.float32)
    corner = np.array([start - _TAPS, -_TAPS, -_TAPS], np.int64)
    normal_cells(cells, key(seed, f"scan/{what}"), corner, np.zeros(3, np.int64), quantiles())
    return cells[0]


def _filter(white: np.ndarray, taps: Taps) -> np.ndarray:
    """Convolve noise along each axis, and cut its margins of `_TAPS` voxels off."""
    for axis, weights in enumerate(taps):
        lines = np.moveaxis(white, axis, 0)
        side = len(lines) - 2 * _TAPS
        found = np.float32(weights[0]) * lines[_TAPS : _TAPS + side]
        for at, weight in enumerate(weights[1:], 1):
            pair = lines[_TAPS - at : _TAPS - at + side] + lines[_TAPS + at : _TAPS + at + side]
            found += np.float32(weight) * pair
        white = np.moveaxis(found, 0, axis)
    return white


def _rings(
    shape: Sequence[int], radius: np.ndarray, seed: int, start: int, stop: int
) -> np.ndarray:
    """Return a number for every slice and radius, interpolated between whole radii."""
    count = int(radius.max()) + 2
    cells = np.empty((1, stop - start, 1, count), np.float32)
    corner = np.array([start, 0, 0], np.int64)
    normal_cells(cells, key(seed, "scan/rings"), corner, np.zeros(3, np.int64), quantiles())
    lines = cells[0, :, 0]
    low = radius.astype(np.int64)
    share = radius - low
    return np.asarray(lines[:, low] * (1 - share) + lines[:, low + 1] * share)


def _round(grey: np.ndarray, dtype: str) -> np.ndarray:
    if dtype == "float32":
        return grey
    info = np.iinfo(dtype)
    return np.rint(grey).clip(info.min, info.max).astype(dtype)


def fit_scan(scan: Image, labels: Image | None = None) -> ScanModel:
    """Learn how a scanner shows a material from one scan of it.

    Parameters
    ----------
    scan : Image, grey, (Z, Y, X) or (Y, X)
        Its middle is taken for the axis of the scanner: cupping and rings of a crop from elsewhere
        are not seen.
    labels : Image, optional
        Of the same voxels. Default: two phases by Otsu's threshold, the dark one first.

    Returns
    -------
    ScanModel
        levels, blur, inset: least squares of the labels' coverage, blurred, against the scan.
        noise, grain: standard deviation and autocorrelation along the axes of voxels some way
        inside each phase; the structure within a phase counts as noise. cupping: of the bright
        phase. rings: what means along circles about the axis scatter more than about other points.

    Raises
    ------
    InputError
        Not grey; labels of another shape; a phase without an inside.
    """
    if scan.kind != "grey":
        raise InputError(f"a scan is grey, got {scan.kind}: give the scan before it was segmented")
    if labels is None:
        labels = segment(scan, "otsu")
    if labels.kind != "labels" or labels.shape != scan.shape:
        raise InputError(
            f"the labels are {labels.kind} of shape {labels.shape}, the scan has {scan.shape}: "
            "give labels of the same voxels"
        )
    lift = (1,) * (3 - scan.ndim)
    grey = scan.values.astype(np.float64).reshape(lift + scan.shape)
    known = labels.values.reshape(grey.shape)
    count = len(labels.phases)
    blur, inset, levels = _fit_edges(*_middle(grey, known), count)
    shares = coverage(known, _insets(levels, inset))
    insides = [_inside(known == phase, levels[phase] == max(levels)) for phase in range(count)]
    for phase, inside in enumerate(insides):
        if np.count_nonzero(inside) < 100:
            raise InputError(
                f"phase {labels.phases[phase]!r} has no inside: its noise is not seen; give a "
                "larger scan, or a model by hand (tb.finish.ScanModel)"
            )
    blurred = [gaussian(share, blur) for share in shares]
    # thin struts are darker all through: the levels whose blurred mixture has the means inside
    mixed = [[float(share[inside].mean()) for share in blurred] for inside in insides]
    levels = np.linalg.solve(mixed, [grey[inside].mean() for inside in insides]).tolist()
    left = grey - sum(share * level for share, level in zip(blurred, levels, strict=True))
    found = [_fit_noise(left, inside) for inside in insides]
    noise, grain = zip(*found, strict=True)
    bright = int(np.argmax(levels))
    cupping, rim = _fit_cupping(left + levels[bright], insides[bright])
    if cupping:
        levels[bright] = rim
    rings = _fit_rings(left, insides[int(np.argmin(levels))]) if min(grey.shape[1:]) > 32 else 0.0
    return ScanModel(
        tuple(round(level, 4) for level in levels),
        blur,
        noise,
        grain,
        cupping,
        rings,
        inset,
        scan.values.dtype.name if scan.values.dtype.name in TYPES else "float32",
    )


def _inside(inside: np.ndarray, bright: bool) -> np.ndarray:
    """Return voxels some way from the interface, nearer where the phase is thin."""
    distance = distance_transform(inside)
    far = _INSIDE[0] if bright else _INSIDE[1]
    while far > 1 and np.count_nonzero(distance > far) < max(100, 0.1 * np.count_nonzero(inside)):
        far -= 0.5
    return np.asarray(distance > far)


def _middle(grey: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle of a scan and its labels, which says enough of edges."""
    box = tuple(
        slice(max((side - _FITTED) // 2, 0), max((side - _FITTED) // 2, 0) + _FITTED)
        for side in grey.shape
    )
    return grey[box], labels[box]


def _fit_edges(
    grey: np.ndarray, labels: np.ndarray, count: int
) -> tuple[float, float, list[float]]:
    """Return the blur, the inset and the levels that leave the least squares: blur and inset in
    turn, with the levels that belong to each pair.
    """
    target = grey.ravel()
    bright = [float(grey[labels == phase].mean()) for phase in range(count)]
    distances = [_distance(labels == phase) for phase in range(count)]
    tried: dict[tuple[float, float], tuple[float, list[float]]] = {}

    def error(blur: float, inset: float) -> float:
        if (blur, inset) not in tried:
            shares = _shares(labels, distances, _insets(bright, inset))
            columns = [gaussian(share, blur).ravel() for share in shares]
            matrix = np.stack(columns, axis=1).astype(np.float64)
            levels = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ target, rcond=None)[0]
            left = float(np.mean((target - matrix @ levels) ** 2))
            tried[blur, inset] = (left, levels.tolist())
        return tried[blur, inset][0]

    blur = inset = 0.0
    for _ in range(3):
        blur = _least(_SIGMAS, partial(error, inset=inset))
        inset = _least(_INSETS, partial(error, blur))
    return blur, inset, tried[blur, inset][1]


def _least(values: Sequence[float], error: Callable[[float], float]) -> float:
    """Return the value of least error: of every third one, then of those beside the best."""
    at = min(range(0, len(values), 3), key=lambda k: error(values[k]))
    return min(values[max(at - 2, 0) : at + 3], key=error)


def _fit_noise(grey: np.ndarray, inside: np.ndarray) -> tuple[float, Taps]:
    """Return the standard deviation of a phase's voxels and the taps of their autocorrelation."""
    values = np.where(inside, grey - grey[inside].mean(), 0.0)
    variance = float(np.mean(values[inside] ** 2))
    taps = []
    for axis in range(3):
        lines, known = np.moveaxis(values, axis, 0), np.moveaxis(inside, axis, 0)
        row = [1.0]
        for lag in range(1, min(_TAPS, len(lines) - 1) + 1):
            pairs = np.count_nonzero(known[lag:] & known[:-lag])
            total = float(np.sum(lines[lag:] * lines[:-lag]))
            row.append(total / pairs / variance if pairs > 50 and variance else 0.0)
        taps.append(_square_root(np.array(row)))
    return round(float(np.sqrt(variance)), 4), tuple(taps)


def _square_root(correlation: np.ndarray) -> tuple[float, ...]:
    """Return taps of a symmetric filter that gives white noise this autocorrelation: the square
    root of its spectrum, which a taper keeps from being cut off, and which is 0 where it would be
    negative.
    """
    full = np.zeros(_TAPS + 1)
    full[: len(correlation)] = correlation
    full *= 0.5 * (1 + np.cos(np.pi * np.arange(_TAPS + 1) / (_TAPS + 1)))
    around = np.zeros(64)
    around[: _TAPS + 1] = full
    around[-_TAPS:] = full[1:][::-1]
    spectrum = np.fft.fft(around).real.clip(0)
    return _normalise(np.fft.ifft(np.sqrt(spectrum)).real[: _TAPS + 1])


def _fit_cupping(grey: np.ndarray, inside: np.ndarray) -> tuple[float, float]:
    """Return the share by which a phase is darker on the axis, and its level at the rim."""
    side = min(grey.shape[1:])
    far = np.minimum(_radius(grey.shape) / (side / 2), 1) ** 2
    at = np.broadcast_to(far, grey.shape)[inside]
    values = grey[inside]
    slope, level = np.polyfit(at, values, 1)
    rim = level + slope
    # a trend that explains so little may be that of the structure
    if slope <= 0 or np.corrcoef(at, values)[0, 1] < 0.1:
        return 0.0, float(rim)
    return round(float(min(slope / rim, 0.9)), 4), float(rim)


def _fit_rings(grey: np.ndarray, inside: np.ndarray) -> float:
    """Return the scatter of means along circles about the axis, beyond that about other points."""
    height, width = grey.shape[1:]
    values = np.where(inside, grey - grey[inside].mean(), 0.0)
    y, x = (np.arange(side) - (side - 1) / 2 for side in (height, width))

    def scatter(dy: float, dx: float) -> float:
        ring = np.rint(np.hypot(y[:, None] - dy, x - dx)).astype(np.int64).ravel()
        most = min(height, width) // 2 - 8
        total = weight = 0.0
        for plane, mask in zip(values, inside, strict=True):
            counts = np.bincount(ring, mask.ravel().astype(float))[4:most]
            sums = np.bincount(ring, plane.ravel())[4:most]
            enough = counts > 10
            if np.count_nonzero(enough) > 3:
                means = sums[enough] / counts[enough]
                # from one radius to the next: wide structure does not count
                total += float(np.sum(np.diff(means) ** 2)) / 2
                weight += len(means) - 1
        return total / weight if weight else 0.0

    step = 7.0  # whole: the voxels of a ring lie as they do about the axis
    others = [scatter(*at) for at in ((step, 0), (-step, 0), (0, step), (0, -step))]
    excess = scatter(0, 0) - float(np.mean(others))
    chance = max(3 * float(np.std(others)), 0.5 * float(np.mean(others)), 1e-9)
    # numbers at whole radii, interpolated between and averaged over a ring, keep this share
    return round(float(np.sqrt(excess / _RING_SHARE)), 4) if excess > chance else 0.0

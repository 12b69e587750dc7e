"""Structure of a scan from its covariance and components: correlation lengths, noise, order, bodies
of one shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.centre_crop import centre_box
from trabecula.measure.closed_cells import ALONE
from trabecula.measure.grey import grey_values, near_one
from trabecula.measure.labelling import label_components, labels_at_faces
from trabecula.measure.partition import REACH, SMOOTHING
from trabecula.measure.partition.partition import partition
from trabecula.numerics.transforms import fast_side, sums_by_offset

BOX = {2: 512, 3: 128}
"""Edge of the centre box, voxels, that the covariance of every offset is measured in: about a
second of work.
"""
LINES = 2048
"""Lines along every axis that `lengths_along_axes` looks at."""
ORDER_FROM, ORDER = 5.0, 0.25
"""A material is called regular where places farther apart than 5 correlation lengths are correlated
by .25. Disordered materials are not: `sample:foam` reaches .08, scans of bone, rock and electrodes
.04 to .14; a picture of bricks .28."""
ORDER_SURE = 2.5
"""Standard errors by which such a peak has to exceed what the highest of as many independent
offsets is expected to reach, sqrt(2 ln n): 6.8 in all of 10^4, 4.6 of layers, whose covariance is
known at ten offsets alone. 4 of 1,380 Gaussian fields (volumes from 64^3, pictures from 160^2) were
called regular, all of them sparse pictures."""
ORDER_PAIRS = 0.4
"""Of all voxels: the fewest that have to have another at such an offset."""
ORDER_DEEP = 0.2
"""By how much the covariance has to fall between a place and its peak: a slow gradient has no peak.
"""
BODIES, BODY = 20, 60
"""Components, of so many voxels each, that show whether they are of one shape."""
COMPACT, ROUND = 0.75, 0.93
"""Volume over that of a ball with the same radius of gyration, in the median, of bodies that are
separate, and that are cut apart. A ball has 1, a cube .89, a rod three times as long as wide .38.
Cut apart, beads and cemented grains have .98 and .99, particles of an NMC electrode .90, the cells
of a foam .89, grains of a soil .75."""


@dataclass(frozen=True)
class Structure:
    """Figures of the covariance, on the centre box.

    Attributes
    ----------
    lengths : tuple of float
        Along every axis, in voxels: from where the covariance stays below 1/e of its value without
        noise; infinite where it does not within half of the box.
    noise : float
        Share of the variance that neighbours do not have in common, 0..1; 0 of labels.
    order : float
        The highest covariance, over that at distance 0, of places more than `ORDER_FROM`
        correlation lengths apart.
    period : tuple of int or None
        The offset of that place, voxels, where it makes the material regular.
    """

    lengths: tuple[float, ...]
    noise: float
    order: float
    period: tuple[int, ...] | None


def solid_field(image: Image, side: int | None = None) -> np.ndarray:
    """Return the field that figures are measured on: 1 in the solid (all but void, or but the first
    phase), or the grey.

    With a side only of the centre box of at most so many voxels an axis.
    """
    values = image.values if side is None else centre_box(image.values, side)
    if image.kind != "labels":
        return near_one(grey_values(Image(values, image.kind)))
    void = image.phases.index("void") if "void" in image.phases else 0
    return np.asarray(values != void)


def measure_structure(image: Image) -> Structure:
    """Measure the covariance of every offset about a linear trend: lengths, noise and order."""
    field = _detrend(solid_field(image, BOX[image.ndim]))
    reach = tuple(side // 2 for side in field.shape)
    covariance = sums_by_offset(field, reach).astype(np.float64)
    overlap = np.ones(covariance.shape)
    for axis, (far, side) in enumerate(zip(reach, field.shape, strict=True)):
        pairs = side - np.abs(np.arange(-far, far + 1))
        overlap = overlap * pairs.reshape([-1 if a == axis else 1 for a in range(field.ndim)])
    covariance /= overlap
    lines = [_line(covariance, reach, axis) for axis in range(field.ndim)]
    variance = lines[0][0]
    if variance <= 0:
        return Structure((0.0,) * field.ndim, 0.0, 0.0, None)
    noise = _noise(lines, image.kind)
    scale = variance * (1 - noise)
    lengths = _lengths(lines, scale)
    order, period = _order(
        covariance / scale, overlap, reach, [_first_below(line / scale) for line in lines]
    )
    return Structure(lengths, noise, order, period)


def lengths_along_axes(image: Image) -> tuple[float, ...]:
    """Measure the correlation lengths of `measure_structure` alone, on some thousand lines of the
    centre box: a tenth of the work.
    """
    field = _detrend(solid_field(image, BOX[image.ndim]))
    lines = []
    for axis, side in enumerate(field.shape):
        along = np.moveaxis(field, axis, 0)
        every = max(1, int((along[0].size / LINES) ** (1 / max(1, field.ndim - 1))))
        some = along[(slice(None), *[slice(every // 2, None, every)] * (field.ndim - 1))]
        reach = side // 2
        spectrum = np.fft.rfft(some.reshape(side, -1), fast_side(side + reach), axis=0)
        power = (spectrum.real**2 + spectrum.imag**2).sum(axis=1, dtype=np.float64)
        sums = np.fft.irfft(power, fast_side(side + reach))[: reach + 1]
        lines.append(sums / (side - np.arange(reach + 1)) / some[0].size)
    if min(line[0] for line in lines) <= 0:
        return (0.0,) * field.ndim
    rest = 1 - _noise(lines, image.kind)
    return tuple(_lengths([line], line[0] * rest)[0] for line in lines)


def _noise(lines: list[np.ndarray], kind: str) -> float:
    """Return the share of the variance that neighbours do not have in common; 0 of labels."""
    if kind == "labels":
        return 0.0
    # A covariance that falls linearly near 0, as that of sharp interfaces does, meets 2 c(1) - c(2)
    # there.
    variance = lines[0][0]
    shared = np.mean([2 * line[1] - line[2] for line in lines if len(line) > 2] or [variance])
    return float(np.clip(1 - shared / variance, 0.0, 1 - 1e-3))


def _lengths(lines: list[np.ndarray], scale: float) -> tuple[float, ...]:
    return tuple(_last_below(np.abs(np.r_[1.0, line[1:] / scale])) for line in lines)


def _detrend(field: np.ndarray) -> np.ndarray:
    """Return the field less its mean and its linear trend along every axis."""
    found = field.astype(np.float32)
    found -= np.float32(found.mean(dtype=np.float64))
    for axis, side in enumerate(found.shape):
        if side < 3:
            continue
        along = np.linspace(-1, 1, side)
        profile = found.mean(
            axis=tuple(other for other in range(found.ndim) if other != axis), dtype=np.float64
        )
        slope = float(along @ profile / (along @ along))
        found -= (
            (slope * along)
            .astype(np.float32)
            .reshape([-1 if a == axis else 1 for a in range(found.ndim)])
        )
    return found


def _line(covariance: np.ndarray, reach: tuple[int, ...], axis: int) -> np.ndarray:
    """Return the covariance along an axis, offset 0 first."""
    index: list[int | slice] = list(reach)
    index[axis] = slice(reach[axis], None)
    return covariance[tuple(index)]


def _first_below(curve: np.ndarray) -> float:
    below = np.flatnonzero(curve < np.exp(-1))
    return float(below[0]) if len(below) else float(len(curve))


def _last_below(curve: np.ndarray) -> float:
    """Return where a curve falls below 1/e for good, between its samples."""
    r = int(np.flatnonzero(curve >= np.exp(-1))[-1])
    if r == len(curve) - 1:
        return float("inf")
    return float(r + (curve[r] - np.exp(-1)) / (curve[r] - curve[r + 1]))


def _order(
    rho: np.ndarray, overlap: np.ndarray, reach: tuple[int, ...], lengths: list[float]
) -> tuple[float, tuple[int, ...] | None]:
    """Return the highest far covariance, and the offset of its place where it is a peak that no
    chance explains.
    """
    axes = np.ogrid[tuple(slice(-far, far + 1) for far in reach)]
    distance = np.sqrt(
        sum(
            ((r / length) ** 2 for r, length in zip(axes, lengths, strict=True)),
            np.zeros(rho.shape),
        )
    )
    far = (distance >= ORDER_FROM) & (overlap >= ORDER_PAIRS * overlap.max())
    if not far.any():
        return 0.0, None
    near = distance < ORDER_FROM / 2
    error = np.sqrt(np.square(rho[near]).sum() / np.maximum(overlap, 1))
    independent = max(2.0, np.count_nonzero(far) / np.count_nonzero(near))
    unlikely = (ORDER_SURE + np.sqrt(2 * np.log(independent))) * error
    highest = float(rho[far].max())
    sure = np.where(far & (rho > np.maximum(ORDER, unlikely)), rho, -np.inf)
    at = np.unravel_index(int(np.argmax(sure)), rho.shape)
    offset = np.array([int(place) - middle for place, middle in zip(at, reach, strict=True)])
    if not np.isfinite(sure[at]):
        return highest, None
    steps = int(np.abs(offset).max())
    way = np.rint(np.linspace(0, 1, steps + 1)[:, None] * offset).astype(int) + np.array(reach)
    if rho[tuple(way.T)].min() > sure[at] - ORDER_DEEP:
        return highest, None
    return highest, tuple(int(abs(step)) for step in offset)


def has_bodies(image: Image) -> str | None:
    """Return the name of a phase that consists of separate, round bodies; None where none does.

    Labels of volumes only: a slice of almost anything sparse shows round bodies.
    """
    if image.ndim == 2:
        return None
    box = centre_box(image.values, BOX[image.ndim])
    for label, name in enumerate(image.phases):
        inside = box == label
        if inside.any() and _are_bodies(inside):
            return name
    return None


def has_round_grains(image: Image) -> bool:
    """Return whether the solid of a volume of two phases consists of round bodies that touch or
    overlap: cut apart at their necks.
    """
    if image.ndim == 2 or image.kind != "labels":
        return False
    inside = np.ascontiguousarray(solid_field(image, BOX[image.ndim]))
    if inside.all() or not inside.any():
        return False
    wraps, steps = (False,) * 3, np.array(image.spacing) / min(image.spacing)
    cut = partition(inside, steps, wraps, smoothing=SMOOTHING, reach=REACH)
    sizes = np.bincount(cut.labels.ravel(), minlength=cut.count + 1)[1:]
    compact = _compactness(cut.labels, sizes)
    return compact is not None and compact >= ROUND


def _are_bodies(inside: np.ndarray) -> bool:
    labels, sizes = label_components(inside)
    if not len(sizes) or sizes.max() > ALONE * sizes.sum():
        return False
    compact = _compactness(labels, sizes)
    return compact is not None and compact >= COMPACT


def _compactness(labels: np.ndarray, sizes: np.ndarray) -> float | None:
    """Return the volume of bodies over that of balls with the same radii of gyration, in the
    median; None of fewer than `BODIES` whole ones of `BODY` voxels.
    """
    # what the faces cut has another shape
    whole = (sizes >= BODY) & ~labels_at_faces(labels, len(sizes))[1:]
    if whole.sum() < BODIES:
        return None
    places = np.nonzero(labels)
    numbers = labels[places] - 1
    spread = np.full(len(sizes), 3 / 12)  # of a voxel about its own centre
    for place in places:
        mean = np.bincount(numbers, weights=place, minlength=len(sizes)) / sizes
        spread += (
            np.bincount(numbers, weights=(place - mean[numbers]) ** 2, minlength=len(sizes)) / sizes
        )
    ball = 4 / 3 * np.pi * (5 / 3 * spread) ** 1.5
    return float(np.median((sizes / ball)[whole]))

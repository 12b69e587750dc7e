"""Confidence intervals of a material's descriptors from one image of it.

Descriptors that are means of a local field have the variance of that mean (`measure.mean_variance`:
Matheron's integral range). Those that a solver gives are measured in parts of the image as well
(`measure.subdivision`). Student's t takes in how little one image knows of its own variance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.local_fields import LocalField
from trabecula.measure.mean_variance import ENOUGH, SpatialCovariance, window_means
from trabecula.measure.registry import DESCRIPTORS, LEVELS, PHASES, Descriptor
from trabecula.measure.subdivision import (
    LEAST_SIDE,
    SOLVED,
    crop_box,
    solve_parts,
    variance_share,
)
from trabecula.numerics.quantiles import student


@dataclass(frozen=True)
class Interval:
    """The interval in which the material's own value lies, and the image size for another width.

    `low`, `high` and `half_width` are None where the image holds too little of its material; `note`
    says then what would do.
    """

    value: float | None
    """Of the image; None where it has none, as the thickness of a phase that fills it."""
    variance: float | None
    """Of the value, over independent images of this size."""
    freedom: float
    """Degrees of freedom of the variance."""
    coverage: float
    effective_samples: float
    """How many independent voxels, or parts, would know the value as well."""
    by: str
    """"integral range" or "subdivision"."""
    volume: float
    """Of the image (2-D: area), in the unit of length to the power `ndim`."""
    ndim: int = 3
    bounds: tuple[float, float] = (-math.inf, math.inf)
    """That no value of the descriptor exceeds."""
    note: str = ""

    @property
    def half_width(self) -> float | None:
        """Return half of the interval's width, before `bounds` cut it."""
        if self.variance is None:
            return None
        return self._reach(self.freedom) * math.sqrt(self.variance)

    @property
    def low(self) -> float | None:
        """Return the lower end."""
        half, value = self.half_width, self.value
        return None if half is None or value is None else max(value - half, self.bounds[0])

    @property
    def high(self) -> float | None:
        """Return the upper end."""
        half, value = self.half_width, self.value
        return None if half is None or value is None else min(value + half, self.bounds[1])

    @property
    def relative(self) -> float | None:
        """Return the half-width over the size of the value; None where either is missing."""
        half = self.half_width
        return None if half is None or not self.value else half / abs(self.value)

    def side_for(self, relative_width: float) -> float | None:
        """Return the side of the cube (square) whose scan would give this relative half-width.

        The variance of a mean falls with the volume, and a larger scan knows it better.

        Parameters
        ----------
        relative_width : float
            Half-width over the value, above 0: 0.05 for plus or minus 5 %.

        Returns
        -------
        side : float
            In the image's unit; None where there is no interval.

        Raises
        ------
        InputError
            A width that is not above 0.
        """
        wanted = as_number(relative_width, name="relative_width", low=0, high=math.inf)
        if wanted == 0:
            raise InputError("relative_width is 0, which no scan reaches: give 0.05 for 5 %")
        if self.variance is None or not self.value:
            return None
        width = (wanted * self.value) ** 2
        times = 1.0
        for _ in range(4):  # the degrees of freedom grow with the volume, up to a limit of use
            freedom = max(self.freedom, min((self.freedom + 1) * times - 1, ENOUGH))
            times = self._reach(max(freedom, 1.0)) ** 2 * self.variance / width
        return float((times * self.volume) ** (1 / self.ndim))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        samples = self.effective_samples
        return {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "half_width": self.half_width,
            "relative": self.relative,
            "coverage": self.coverage,
            "effective_samples": samples if math.isfinite(samples) else None,
            "by": self.by,
            "side_for": {f"{share:g}": self.side_for(share) for share in (0.1, 0.05, 0.01)},
            "note": self.note,
        }

    def _reach(self, freedom: float) -> float:
        """Return the quantile of Student's t."""
        return student(round(min(freedom, 1e6)), (1 + self.coverage) / 2)


def confidence(
    image: Image | ArrayLike,
    *,
    level: str = "default",
    coverage: float = 0.95,
    names: Sequence[str] | None = None,
    box: int | None = None,
) -> dict[str, Interval]:
    """Find intervals of the material's own descriptors from one image of it.

    The image is a sample: another one of the same material has other values. The interval holds the
    mean of all of them, which is the material's, `coverage` of the time. The material has to be
    stationary, alike all over the image.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    level : {"quick", "default", "full"}
        As of `describe`: "default" adds thickness and pore size, "full" what the solvers give, by
        the eight octants of a volume.
    coverage : float
        0 .. 1, both exclusive.
    names : sequence of str, optional
        Only these. Default: all of the level.
    box : int, optional
        Edge of the centre box, voxels, that the solvers take. Default: the whole image.

    Returns
    -------
    intervals : dict
        By name: `porosity`, `specific_surface`, `mean_curvature`, `chord_length`, `thickness`,
        `pore_size`, `euler_density`; `fraction_NAME` of every phase, where there are more than two
        or none is the void; at "full" `diffusivity`, `conductivity`, `permeability` and
        `stiffness`, each the mean of the axes and with `_z`, `_y`, `_x`.

    Raises
    ------
    InputError
        Not labels, a side of one voxel, an unknown level or name, a coverage out of range.

    Examples
    --------
    >>> coins = np.random.default_rng(0).integers(0, 2, (200, 200))
    >>> porosity = confidence(coins, names=["porosity"])["porosity"]
    >>> round(porosity.half_width, 3), round(porosity.side_for(0.05))
    (0.005, 78)
    """
    image = as_image(image)
    check_labels(image)
    check_name(level, LEVELS, name="level")
    share = as_number(coverage, name="coverage", low=0, high=1)
    if share in (0, 1):
        raise InputError(f"coverage is {coverage}: give a share between, such as 0.95")
    means = dict(_mean_names(image, level))
    solved = SOLVED if level == "full" and image.ndim == 3 and "void" in image.phases else ()
    asked: Sequence[str] = () if names is None else names
    check_type(asked, Sequence, name="names", advice="give a list of them")
    for name in asked:
        check_name(name, (*means, *solved), name="name")
    found = {
        name: interval_of_mean(image, one, _local_field(image, one, phase), coverage=share)
        for name, (one, phase) in means.items()
        if names is None or name in names
    }
    wanted = [name for name in solved if names is None or name in names]
    return found | _by_subdivision(image, wanted, share, box)


def local_fields(image: Image, *, level: str) -> Iterator[tuple[str, LocalField | None]]:
    """Yield name and local field of the descriptors of a level; None where the image has none."""
    for name, (one, phase) in _mean_names(image, level):
        yield name, _local_field(image, one, phase)


def _mean_names(image: Image, level: str) -> Iterator[tuple[str, tuple[Descriptor, str | None]]]:
    """Yield the names of what is the mean of a local field, with descriptor and phase."""
    void = "void" in image.phases
    for one in DESCRIPTORS.values():
        if one.field is None or not one.is_measured(level):
            continue
        if one.source != PHASES:
            if void:
                yield one.name, (one, None)
        elif not void or len(image.phases) > 2:
            for phase in image.phases:
                yield f"{one.name}_{phase}", (one, phase)


@dataclass(frozen=True)
class WindowSpread:
    """Standard deviations of a descriptor over windows of a material, by their side: the curve from
    which a representative volume is read (Kanit et al. 2003, doi:10.1016/S0020-7683(03)00143-4).
    """

    step: float
    """Sides are step, 2 step, ..., in the image's unit."""
    measured: np.ndarray
    """Between the windows that lie side by side in the image, up to half of its shortest side."""
    expected: np.ndarray
    """By the integral range, up to three times the shortest side."""


def window_spread(image: Image, local: LocalField) -> WindowSpread:
    """Compare the spread of windows of an image with that by its integral range.

    Windows scatter around the mean of their image and not of the material, which makes their
    variance smaller by that of the image's mean: it is added.

    Parameters
    ----------
    image : Image of labels
    local : LocalField
    """
    known = SpatialCovariance.of([local.field], spacing=image.spacing)
    extents = [side * edge for side, edge in zip(image.shape, image.spacing, strict=True)]
    step = max(min(extents) / 24, *(2 * edge for edge in image.spacing))

    def window(count: int) -> list[int]:
        return [max(1, round(count * step / edge)) for edge in image.spacing]

    own = float(known.of_means(image.shape)[0, 0])
    measured = []
    for count in range(1, int(min(extents) / (2 * step)) + 1):
        means = window_means(local.field, window(count))
        if means.size >= 2**image.ndim:
            measured.append(math.sqrt(float(means.var()) + own))
    expected = [
        math.sqrt(float(known.of_means(window(count))[0, 0]))
        for count in range(1, int(3 * min(extents) / step) + 1)
    ]
    return WindowSpread(step, np.array(measured), np.array(expected))


def interval_of_mean(
    image: Image, one: Descriptor, local: LocalField | None, *, coverage: float = 0.95
) -> Interval:
    """Find the interval of one descriptor from its local field.

    Parameters
    ----------
    image : Image of labels
    one : Descriptor
    local : LocalField or None
        None where the image has none: no interval.
    coverage : float
    """
    fixed = _fixed(image, one, coverage, "integral range")
    if local is None or local.field.min() == local.field.max():
        note = (
            f"the {one.title.lower()} is the same all over the image, which says nothing about "
            "others: scan a part with more than one phase"
        )
        return _without_width(None if local is None else local.value, note, fixed)
    known = SpatialCovariance.of([local.field], spacing=image.spacing)
    if not known.decayed[0]:
        return _without_width(local.value, _too_short(image, known), fixed)
    return Interval(
        local.value,
        variance=float(known.of_means(image.shape)[0, 0]),
        freedom=float(known.freedom[0]),
        effective_samples=min(float(known.samples()[0]), float(math.prod(image.shape))),
        **fixed,
    )


def _fixed(image: Image, one: Descriptor, coverage: float, by: str) -> dict[str, Any]:
    signed = one.name in ("mean_curvature", "euler_density")
    return {
        "coverage": coverage,
        "by": by,
        "volume": math.prod(image.shape) * math.prod(image.spacing),
        "ndim": image.ndim,
        "bounds": (-math.inf if signed else 0.0, 1.0 if one.share else math.inf),
    }


def _local_field(image: Image, one: Descriptor, phase: str | None) -> LocalField | None:
    """Return the local field; None where the image is of one phase alone, and sizes have no
    bound.
    """
    assert one.field is not None
    if image.values.min() == image.values.max() and one.power == 1:
        return None
    return one.field(image, phase=phase)


def _without_width(value: float | None, note: str, fixed: Mapping[str, Any]) -> Interval:
    return Interval(value, variance=None, freedom=0.0, effective_samples=0.0, note=note, **fixed)


def _too_short(image: Image, known: SpatialCovariance) -> str:
    extents = (side * step for side, step in zip(image.shape, image.spacing, strict=True))
    unit = "voxels" if image.unit == "voxel" else image.unit
    return (
        f"the image is too short for an interval: {' x '.join(f'{one:.4g}' for one in extents)} "
        f"{unit}, and places {known.reach[0]:.3g} apart are still alike; scan a side of at least "
        f"{known.least_side[0]:.2g} {unit}"
    )


def _by_subdivision(
    image: Image, names: Sequence[str], coverage: float, box: int | None
) -> dict[str, Interval]:
    """Find intervals of what the solvers give, by octants."""
    if not names:
        return {}
    image = crop_box(image, box)
    if min(image.shape) < LEAST_SIDE:
        raise InputError(
            f"intervals of {names[0]} need octants of {LEAST_SIDE // 2} voxels a side, and the "
            f"box is {' x '.join(map(str, image.shape))}: give an image of at least {LEAST_SIDE} "
            "voxels a side, or leave out level full"
        )
    known = SpatialCovariance.of(
        [image.values == image.phases.index("void")], spacing=image.spacing
    )
    found = {}
    for name, (value, parts) in solve_parts(image, names).items():
        one = DESCRIPTORS[name.partition("_")[0]]
        fixed = _fixed(image, one, coverage, "subdivision")
        if not known.decayed[0]:
            found[name] = _without_width(value, _too_short(image, known), fixed)
            continue
        share = variance_share(known)
        found[name] = Interval(
            value,
            variance=float(parts.var(ddof=1)) * share,
            freedom=len(parts) - 1,
            effective_samples=1 / share,
            **fixed,
        )
    return found

"""Views: the planes of a volume that are to look like a picture, and their names.

A plane is named by the volume's axes along the picture's rows and columns: "yx" is seen across z,
"zx" across y, "zy" across x. With the letters the other way round, as in "xy", the picture is
transposed first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.exemplar.magnification import to_one_magnification
from trabecula.measure.correlation import covariance_form, two_point
from trabecula.measure.describe import autocorrelation_lines
from trabecula.measure.disector import check_sections
from trabecula.measure.grey import autocorrelation, grey_values

PLANES = ("yx", "zx", "zy")
SLICES = 8
"""Slices of a plane that stand for a volume, at most."""

_NAMES = (*PLANES, "xy", "xz", "yz")
_AXES = "zyx"

# by which pictures of one material may differ in a fraction, or in mean grey over its range
_FRACTION = 0.2
# by which their covariances along a shared axis may differ, relative; strangers differ by .8 to 1
_LINE = 0.75
_SPACING = 1e-6
_ALIKE = (
    # by which covariances along rows and columns of an isotropic sample may differ, relative; real
    # ones: up to .48
    0.5
)


@dataclass(frozen=True)
class View:
    """A plane and its picture.

    Parameters
    ----------
    axis : int
        The axis of the volume that it is seen across: 0 for z, 1 for y, 2 for x.
    image : Image, (Y, X)
        Rows along the slower of the two other axes, columns along the faster.
    picture : int
        Which of the exemplars it is.
    """

    axis: int
    image: Image
    picture: int

    @property
    def across(self) -> tuple[int, int]:
        """Return the volume's axes along rows and columns."""
        rows, columns = (axis for axis in range(3) if axis != self.axis)
        return rows, columns

    @property
    def plane(self) -> str:
        """Return the name of the plane, rows first."""
        return "".join(_AXES[axis] for axis in self.across)


def views_of(
    exemplars: Sequence[Image], named: Sequence[str] = (), *, gap: int = 0
) -> tuple[View, ...]:
    """Return the views of one picture or several, at one magnification.

    Parameters
    ----------
    exemplars : sequence of Image, each (Y, X)
        With square pixels of different sizes they are brought to the largest.
    named : sequence of str
        Planes: two or three that are seen across different axes. One exemplar is for all of them;
        of several there is one for each. Where none is named: one exemplar is seen in all three
        planes; of two the first in "yx" and "zx", the second in "zy" (a material that is alike
        around x); three are seen in "yx", "zx" and "zy".
    gap : int
        Pixels from one to the next of parallel sections of a material that is alike from all sides;
        the first is then seen in all three planes. 0: they are no sections.

    Raises
    ------
    InputError
        A number of pictures or planes that does not fit; pictures that contradict each other
        (`check_views`); sections that do not fit each other, or with named planes.
    UnknownNameError
        No such plane.

    Examples
    --------
    >>> picture = Image(np.eye(8, dtype=np.uint8), "labels")
    >>> [(view.plane, view.axis) for view in views_of([picture])]
    [('yx', 0), ('zx', 1), ('zy', 2)]
    >>> views_of([picture, picture], ["yx", "yz"])[1].axis
    2
    """
    images, named = to_one_magnification(exemplars), as_planes(named)
    if gap:
        check_sections(images, gap)
        check_gap_alone(gap, named)
        images = images[:1]
    if not named:
        return _validate(_by_count(images))
    if len(images) not in (1, len(named)):
        raise InputError(
            f"{len(images)} exemplars for {len(named)} views: give one for all, or one for each in "
            "the order of the views"
        )
    numbers = [0] * len(named) if len(images) == 1 else range(len(images))
    views = [_view(images[n], n, plane) for n, plane in zip(numbers, named, strict=True)]
    return _validate(sorted(views, key=lambda view: view.axis))


def is_seen_alike(views: Sequence[View]) -> bool:
    """Return whether one picture is seen across all three axes, in cubic voxels."""
    spacing = {edge for view in views for edge in view.image.spacing}
    return len({view.picture for view in views}) == 1 and len(views) == 3 and len(spacing) == 1


def as_planes(given: str | Sequence[str]) -> tuple[str, ...]:
    """Return the planes that a setting names: a sequence, or one text such as "yx,zx".

    Raises
    ------
    InputError, UnknownNameError
        As `views_of`, of planes alone.
    """
    planes = tuple(given.replace(",", " ").split()) if isinstance(given, str) else tuple(given)
    for plane in planes:
        check_name(plane, _NAMES, name="view")
    if planes and (
        len(planes) not in (2, 3) or len({as_axis(plane) for plane in planes}) < len(planes)
    ):
        raise InputError(
            f"views {list(planes)}: give two or three planes that are seen across different axes, "
            "such as [yx, zx, zy]"
        )
    return planes


def check_gap_alone(gap: int, planes: Sequence[str]) -> None:
    """Raise where parallel sections are said to lie in planes as well."""
    if gap and planes:
        raise InputError(
            "parallel sections stand for all planes: leave out either the gap or the views"
        )


def check_plane(plane: str) -> None:
    """Raise where a plane is not named by two axes of a volume."""
    check_name(plane, _NAMES, name="view")


def as_axis(plane: str) -> int:
    """Return the axis that a plane is seen across: 0 for z, 1 for y, 2 for x."""
    return next(axis for axis, name in enumerate(_AXES) if name not in plane)


def spacing_of(views: Sequence[View]) -> tuple[float, float, float]:
    """Return the edges of a voxel along z, y, x, in the pictures' unit.

    Raises
    ------
    InputError
        Two pictures that give an axis different spacings, or units that differ.
    """
    found: dict[int, float] = {}
    for view in views:
        for axis, edge in zip(view.across, view.image.spacing, strict=True):
            if abs(found.setdefault(axis, edge) / edge - 1) > _SPACING:
                raise InputError(
                    f"the views contradict each other: {_AXES[axis]} has a spacing of "
                    f"{found[axis]:g} in one and {edge:g} in another; resample one, turn it (xy "
                    "instead of yx), or give --spacing"
                )
    if len({view.image.unit for view in views}) > 1:
        raise InputError(
            f"the views are in {' and '.join(sorted({view.image.unit for view in views}))}: give "
            "one unit"
        )
    return found[0], found[1], found[2]


def check_views(views: Sequence[View]) -> None:
    """Raise where different pictures cannot be planes of one material; where one picture
    contradicts itself, say so.

    Two planes share an axis, along which a material has one covariance, and one amount of every
    phase. A picture that is not alike along rows and columns contradicts itself in three planes,
    and is better named in two.

    Raises
    ------
    InputError
        Pictures whose fractions (or mean grey over the range) differ by more than 0.2, or whose
        covariances along a shared axis differ by more than three quarters: the statistic is named.
    """
    for first, second in combinations(views, 2):
        found = _contradiction(first, second)
        if found is None:
            continue
        if first.picture != second.picture:
            raise InputError(
                f"the views {first.plane} and {second.plane} contradict each other: {found}; give "
                "planes of one material, or turn a picture (xy instead of yx)"
            )
        shared = _AXES[_common_axis(first, second)]
        notify(
            f"the picture is not the same along rows and columns, but {first.plane} and "
            f"{second.plane} share {shared} ({found}): two views may suit it better (--set "
            "views=yx,zx)"
        )


def take_slices(volume: Image, plane: str, count: int = SLICES) -> list[Image]:
    """Take slices of a volume in a plane, evenly spread, at most `count`; rows and columns as the
    plane's name says.
    """
    axis = as_axis(plane)
    side = volume.shape[axis]
    places = [(2 * n + 1) * side // (2 * min(count, side)) for n in range(min(count, side))]
    edges = [volume.spacing["zyx".index(letter)] for letter in plane]
    found = []
    for place in places:
        values = volume.values.take(place, axis)
        values = values if plane in PLANES else values.swapaxes(0, 1)
        found.append(
            Image(
                np.ascontiguousarray(values),
                volume.kind,
                tuple(edges),
                unit=volume.unit,
                phases=volume.phases,
            )
        )
    return found


def is_isotropic(image: Image) -> bool:
    """Return whether a picture may be isotropic: square pixels, and covariances along rows and
    columns, and along the two diagonals, that differ no more than those of a sample do.
    """
    if min(image.shape) < 2 or abs(image.spacing[0] / image.spacing[1] - 1) > _SPACING:
        return False
    reach, phases = max(1, min(image.shape) // 5), sorted(_partly(image))
    if image.kind == "labels" and not phases:
        return False
    along, down = (_lines(image, axis, reach, phases) for axis in (1, 0))
    rising, falling = _diagonals(image, reach, phases)
    pairs = [*zip(along, down, strict=True), *zip(rising, falling, strict=True)]
    return all(_relative(x, y) <= _ALIKE for x, y in pairs)


def _contradiction(first: View, second: View) -> str | None:
    """Return the statistic in which two views contradict each other; None where there is none."""
    a, b = first.image, second.image
    if first.picture != second.picture:
        for name, have, other in _amounts(a, b):
            if abs(have - other) > _FRACTION:
                return f"{name} is {have:.2f} in one and {other:.2f} in the other"
    axis, phases = _common_axis(first, second), sorted(_partly(a) & _partly(b))
    reach = min(*a.shape, *b.shape) // 3
    if reach < 1 or (a.kind == "labels" and not phases):
        return None  # nothing to compare: methods say what a picture has to hold
    chosen = phases[1:] if len(phases) == 2 else phases
    lines = [_lines(view.image, view.across.index(axis), reach, chosen) for view in (first, second)]
    apart = max(_relative(x, y) for x, y in zip(*lines, strict=True))
    if apart > _LINE:
        return f"their covariances along {_AXES[axis]} differ by {apart:.0%}"
    return None


def _amounts(a: Image, b: Image) -> list[tuple[str, float, float]]:
    if a.kind == "labels":
        shares = [
            np.bincount(image.values.ravel(), minlength=len(a.phases)) / image.values.size
            for image in (a, b)
        ]
        return [
            (f"the fraction of {name}", float(x), float(y))
            for name, x, y in zip(a.phases, *shares, strict=True)
        ]
    greys = [grey_values(image) for image in (a, b)]
    low, high = min(grey.min() for grey in greys), max(grey.max() for grey in greys)
    means = [(float(grey.mean(dtype=np.float64)) - low) / max(high - low, 1e-30) for grey in greys]
    return [("the mean over the range", *means)]


def _partly(image: Image) -> set[int]:
    """Return the phases that are in a picture, but not alone."""
    if image.kind != "labels":
        return set()
    counts = np.bincount(image.values.ravel())
    return {int(phase) for phase in np.flatnonzero((counts > 0) & (counts < image.values.size))}


def _lines(image: Image, axis: int, reach: int, phases: Sequence[int]) -> np.ndarray:
    """Return covariances along an axis, from 1 at distance 0: (phases or 1, reach + 1)."""
    if image.kind != "labels":
        return autocorrelation_lines(image, lags=reach)["yx"[axis]][None]
    return np.array(
        [covariance_form(two_point(image, r_max=reach, phase=phase, axis=axis)) for phase in phases]
    )


def _diagonals(image: Image, reach: int, phases: Sequence[int]) -> list[np.ndarray]:
    """Return autocorrelations along both diagonals, from 1 at distance 0: each (phases or 1, reach
    + 1).
    """
    labels = image.kind == "labels"
    parts = (
        [Image((image.values == phase).astype(np.uint8), "labels") for phase in phases]
        if labels
        else [image]
    )
    maps = [autocorrelation(part, lags=reach) for part in parts]
    return [
        np.array([np.diagonal(each)[reach:] for each in way])
        for way in (maps, [each[:, ::-1] for each in maps])
    ]


def _relative(first: np.ndarray, second: np.ndarray) -> float:
    return float(
        np.linalg.norm(first - second) / max(np.linalg.norm(first), np.linalg.norm(second))
    )


def _common_axis(first: View, second: View) -> int:
    return next(axis for axis in first.across if axis in second.across)


def _validate(views: Sequence[View]) -> tuple[View, ...]:
    spacing_of(views)
    check_views(views)
    return tuple(views)


def _by_count(images: Sequence[Image]) -> list[View]:
    if len(images) > 3:
        raise InputError(
            f"{len(images)} exemplars: a volume has three views, give one, two or three pictures"
        )
    numbers = {1: (0, 0, 0), 2: (0, 0, 1), 3: (0, 1, 2)}[len(images)]
    return [_view(images[n], n, plane) for n, plane in zip(numbers, PLANES, strict=True)]


def _view(image: Image, number: int, plane: str) -> View:
    if image.ndim != 2:
        raise InputError(f"a view is a picture, got {image.ndim} axes of shape {image.shape}")
    if plane not in PLANES:
        turned = np.ascontiguousarray(image.values.swapaxes(0, 1))
        image = replace(image, values=turned, spacing=image.spacing[::-1])
    return View(as_axis(plane), image, number)

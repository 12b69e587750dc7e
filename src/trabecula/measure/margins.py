"""Margins of a scan that hold no material: blank outer planes, planes unlike all others, and a
round field of view.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image, as_image
from trabecula.measure.grey import grey_values

BLANK_STEP, STEP = 1.5, 3.0
"""How many times the largest step of the interior ends a margin, of blank planes and of others. In
2,960 Gaussian fields without a margin (volumes and pictures, fractions .05 to .9) none was found;
blank planes alone are rare enough to need less."""
SURE = 3.0
"""Standard errors of the interior's mean, from that of its quarters, by which blank planes have to
differ from it.
"""
FAR = 6.0
"""Standard errors of a plane's fraction by which blank planes have to be beyond the interior."""
MOST = 1 / 3
"""Of a side: the widest margin."""
FLAT = 0.25
"""Of the interior's least contrast (standard deviation of a plane): a grey plane below it holds
noise alone.
"""
LEAST = 16
"""Planes along an axis below which nothing can be said of it."""
ROUND = 1.15
"""In half sides: where nothing but one value is farther than this from the middle the field of
view is round. Corners are at 1.41; beyond 1.15 are the outer 9 percent."""
TINY = 1e-9
"""A step that counts as none."""
CORNER = 0.15
"""Of a side: the edge of a square of the area that a corner has beyond `ROUND`."""
_PASSES = 4  # a margin along one axis may hide another


@dataclass(frozen=True)
class MarginFace:
    """Outer planes without material at one face.

    Attributes
    ----------
    axis : str
        "z", "y" or "x".
    end : {"first", "last"}
    planes : int
    blank : bool
        Whether they hold one value alone; else they are unlike the material.
    value : str
        The phase, or the mean grey, that they hold.
    """

    axis: str
    end: str
    planes: int
    blank: bool
    value: str

    def __str__(self) -> str:
        count = (
            f"the {self.end} plane" if self.planes == 1 else f"the {self.end} {self.planes} planes"
        )
        verb = "holds" if self.planes == 1 else "hold"
        return f"{count} along {self.axis} " + (
            f"{verb} {self.value} alone"
            if self.blank
            else f"{'is' if self.planes == 1 else 'are'} unlike all others"
        )


@dataclass(frozen=True)
class Margins:
    """Result of `find_margins`.

    Attributes
    ----------
    shape : tuple of int
        Of the image.
    faces : tuple of Face
    round_axis : str or None
        The axis of a round field of view (a cylinder); "z" for a disc in a picture, which has no
        such axis.
    corner, size : tuple of int
        The box without the margins; within a round field the inscribed square.
    """

    shape: tuple[int, ...]
    faces: tuple[MarginFace, ...]
    round_axis: str | None
    corner: tuple[int, ...]
    size: tuple[int, ...]

    def __bool__(self) -> bool:
        return bool(self.faces) or self.round_axis is not None

    def __str__(self) -> str:
        if not self:
            return "none"
        found = [str(face) for face in _group_alike(self.faces)]
        if len(self.shape) == 2:
            found = [text.replace("plane", "line") for text in found]
        if self.round_axis is not None:
            found.append("the field of view is round: its corners hold one value alone")
        return "; ".join(found)

    def to_json(self) -> dict[str, Any]:
        """Return the margins as plain JSON."""
        return {
            "faces": [vars(face) for face in self.faces],
            "round_axis": self.round_axis,
            "corner": list(self.corner),
            "size": list(self.size),
        }


def find_margins(image: Image | ArrayLike) -> Margins:
    """Find blank outer planes, planes unlike the material, and a round field of view.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Labels, grey or colour.

    Returns
    -------
    margins : Margins
        False where there is none.

    Notes
    -----
    A plane is described by one number for each phase, its fraction (grey and colour: the mean
    grey). The *interior* is the middle half of the planes that are not blank. Outer planes are a
    margin where one of these holds:

    1. They are blank (one value alone; grey: less than a quarter of the interior's least contrast),
       and the material begins abruptly behind them: by a step of more than `BLANK_STEP` times the
       largest step between neighbouring planes of the interior, which fills its quarters evenly
       enough (`SURE`) to be no single body on blank ground.
    2. They are blank and far from the interior: beyond its range by more than the range itself and
       by more than `FAR` standard errors of a plane, which the spread of its quarters gives. A
       specimen whose rough surface is in the scan has such planes.
    3. They are not blank, but each is outside the interior's range, and they end by a step of more
       than `STEP` times the largest: a bar with text, a frame.

    So a layer of a layered material, thin walls and an open foam are none: where the interior has
    such steps or such planes as well nothing is found. More than `MOST` of a side is never called a
    margin, since then it is open what is the material.

    Examples
    --------
    >>> scan = np.random.default_rng(0).integers(0, 2, (40, 40, 40))
    >>> scan[:2] = 0
    >>> print(find_margins(scan))
    the first 2 planes along z hold void alone
    """
    image = as_image(image)
    values = image.values if image.kind == "labels" else grey_values(image)
    box = [(0, side) for side in image.shape]
    faces: dict[tuple[int, str], MarginFace] = {}
    rounded: str | None = None
    for _ in range(_PASSES):
        found = dict(_margin_faces(values, box, image))
        for (axis, end), face in found.items():
            before = faces.get((axis, end))
            faces[axis, end] = face if before is None else _join(before, face)
            start, stop = box[axis]
            box[axis] = (
                (start + face.planes, stop) if end == "first" else (start, stop - face.planes)
            )
        across = None if rounded else _round_axis(values, box)
        if across is not None:
            rounded = "zyx"[across + 3 - image.ndim] if image.ndim == 3 else "z"
            box = [
                _inscribe(*span) if image.ndim == 2 or n != across else span
                for n, span in enumerate(box)
            ]
        if not found and across is None:
            break
    corner, size = tuple(start for start, _ in box), tuple(stop - start for start, stop in box)
    return Margins(image.shape, tuple(faces[key] for key in sorted(faces)), rounded, corner, size)


def margin_note(image: Image | ArrayLike) -> str | None:
    """Say in a line that an image has margins without material, and what they do to its figures;
    None where it has none.
    """
    image = as_image(image)
    margins = find_margins(image)
    if not margins:
        return None
    advice = f"{margins}: crop them (--crop auto, tb.crop_margins), or they count as material"
    if image.kind != "labels":
        return advice
    phase = image.phases.index("void") if "void" in image.phases else 0
    box = tuple(
        slice(start, start + side) for start, side in zip(margins.corner, margins.size, strict=True)
    )
    shares = [
        np.count_nonzero(values == phase) / values.size
        for values in (image.values, image.values[box])
    ]
    name = "porosity" if "void" in image.phases else f"fraction of {image.phases[phase]}"
    return f"{advice}; {name} {shares[0]:.3f} with them, {shares[1]:.3f} without"


def _group_alike(faces: tuple[MarginFace, ...]) -> list[Any]:
    """Return the faces to put into words, those that differ in nothing but their end or axis
    together.
    """
    groups: dict[tuple[int, bool, str], list[MarginFace]] = {}
    for face in faces:
        groups.setdefault((face.planes, face.blank, face.value if face.blank else ""), []).append(
            face
        )
    return [members[0] if len(members) == 1 else _Several(members) for members in groups.values()]


class _Several:
    """Faces that hold the same."""

    def __init__(self, faces: list[MarginFace]) -> None:
        self.faces = faces

    def __str__(self) -> str:
        first = self.faces[0]
        ends: dict[str, list[str]] = {}
        for face in self.faces:
            ends.setdefault(face.axis, []).append(face.end)
        where: dict[str, list[str]] = {}
        for axis, found in ends.items():
            where.setdefault(" and the ".join(found), []).append(axis)
        count = "plane" if first.planes == 1 else f"{first.planes} planes"
        places = " and ".join(
            f"the {end} {count} along {', '.join(axes)}" for end, axes in where.items()
        )
        return (
            f"{places} hold {first.value} alone"
            if first.blank
            else f"{places} are unlike all others"
        )


def _join(before: MarginFace, more: MarginFace) -> MarginFace:
    same = before.blank and more.blank and before.value == more.value
    return MarginFace(before.axis, before.end, before.planes + more.planes, same, before.value)


def _margin_faces(
    values: np.ndarray, box: list[tuple[int, int]], image: Image
) -> Iterator[tuple[tuple[int, str], MarginFace]]:
    """Find the margins of a box along every axis."""
    part = values[tuple(slice(*span) for span in box)]
    labels = range(len(image.phases)) if image.kind == "labels" else None
    for axis in range(part.ndim):
        if part.shape[axis] < LEAST:
            continue
        figures = _fractions(part, axis, labels) if labels is not None else _greys(part, axis)
        for end, turned in (("first", figures), ("last", figures.reverse())):
            count, blank = turned.margin()
            if count:
                value = turned.value(count, image.phases)
                yield (axis, end), MarginFace("zyx"[axis + 3 - part.ndim], end, count, blank, value)


@dataclass(frozen=True)
class _Planes:
    """Figures of the planes along an axis.

    Attributes
    ----------
    quarters : (N, 4, figures) array
        Fraction of every phase, or the mean grey, of the quarters of every plane.
    blank : (N,) bool array
    """

    quarters: np.ndarray
    blank: np.ndarray

    @property
    def means(self) -> np.ndarray:
        """Return the figures of whole planes, (N, figures)."""
        return np.asarray(self.quarters.mean(axis=1))

    def reverse(self) -> _Planes:
        """Return the planes in the other order."""
        return _Planes(self.quarters[::-1], self.blank[::-1])

    def margin(self) -> tuple[int, bool]:
        """Return the number of planes of the margin at the beginning, and whether all are blank."""
        count = len(self.blank)
        begin, end = _run(self.blank), count - _run(self.blank[::-1])
        if end - begin < LEAST // 2:
            return 0, False
        quarter = (end - begin) // 4
        inside = self.quarters[begin + quarter : end - quarter]
        planes = inside.mean(axis=1)
        low, high = planes.min(axis=0), planes.max(axis=0)
        largest = np.abs(np.diff(planes, axis=0)).max(axis=0)
        most = int(MOST * count)
        outer = self.means[: most + 1]
        steps = np.abs(np.diff(outer, axis=0)) / np.maximum(largest, TINY)
        outside = (outer[:most] < low) | (outer[:most] > high)
        if 0 < begin <= most:
            last = outer[begin - 1]
            sure = np.abs(last - planes.mean(axis=0)) > SURE * _error(inside.mean(axis=0))
            abrupt = outside[:begin].all(axis=0) & (steps[begin - 1] > BLANK_STEP)
            beyond = np.maximum(low - last, last - high)
            far = beyond > np.maximum(
                high - low, FAR * np.sqrt(np.mean(_error(inside) ** 2, axis=0))
            )
            if ((abrupt & sure) | far).any():
                return begin, True
        # The widest run whose every plane is outside the range, and that ends by a step.
        for width in range(most, 0, -1):
            if ((steps[width - 1] > STEP) & outside[:width].all(axis=0)).any() and width != begin:
                return width, False
        return 0, False

    def value(self, count: int, phases: tuple[str, ...]) -> str:
        """Return the content of the first planes: the most frequent phase, or the mean grey."""
        mean = self.means[:count].mean(axis=0)
        return phases[int(np.argmax(mean))] if phases else f"one grey (about {mean[0]:.3g})"


def _run(blank: np.ndarray) -> int:
    """Return the number of blank planes at the beginning."""
    return int(np.argmin(blank)) if not blank.all() else len(blank)


def _fractions(part: np.ndarray, axis: int, labels: range) -> _Planes:
    quarters = np.stack([_quarters(part, axis, label) for label in labels], axis=-1)
    return _Planes(quarters, (quarters == 1).all(axis=1).any(axis=-1))


def _greys(part: np.ndarray, axis: int) -> _Planes:
    quarters = _quarters(part, axis, None)[..., None]
    contrast = part.std(
        axis=tuple(other for other in range(part.ndim) if other != axis), dtype=np.float64
    )
    quarter = len(contrast) // 4
    inside = contrast[quarter : len(contrast) - quarter]
    blank = contrast < FLAT * inside[inside > 0].min(initial=np.inf)
    return _Planes(quarters, blank & (inside > 0).any())


def _error(quarters: np.ndarray) -> np.ndarray:
    """Return the standard error of a mean of quarters (..., 4, figures): their spread over the root
    of their number.
    """
    return np.asarray(quarters.std(axis=-2, ddof=1) / 2)


def _quarters(part: np.ndarray, axis: int, label: int | None) -> np.ndarray:
    """Return the mean (or a label's share) of the quarters of every plane, (N, 4), of a picture's
    lines (N, 4) as well.
    """
    lines = np.moveaxis(part, axis, 0)
    if lines.ndim == 2:
        parts = _split(lines, 4, axis=1)
    else:
        parts = [
            quarter for half in _split(lines, 2, axis=1) for quarter in _split(half, 2, axis=2)
        ]
    others = tuple(range(1, lines.ndim))
    if label is None:
        return np.stack([quarter.mean(axis=others, dtype=np.float64) for quarter in parts], axis=1)
    return np.stack(
        [np.count_nonzero(quarter == label, axis=others) / quarter[0].size for quarter in parts],
        axis=1,
    )


def _split(lines: np.ndarray, count: int, axis: int) -> list[np.ndarray]:
    """Split into parts along an axis; a side too short for that stands for those it has not."""
    return [part if part.shape[axis] else lines for part in np.array_split(lines, count, axis=axis)]


def _round_axis(values: np.ndarray, box: list[tuple[int, int]]) -> int | None:
    """Return the axis along which all beyond a circle is one value, as no square of a corner's size
    within it is.
    """
    part = values[tuple(slice(*span) for span in box)]
    for axis in range(part.ndim) if part.ndim == 3 else (0,):
        lines = np.moveaxis(part, axis, 0) if part.ndim == 3 else part[None]
        corner = lines[0, 0, 0]
        if (
            min(lines.shape[1:]) < LEAST
            or not (lines[:, [0, 0, -1, -1], [0, -1, 0, -1]] == corner).all()
        ):
            continue
        filled = (lines != corner).any(axis=0)
        y, x = (np.abs(2 * np.arange(side) + 1 - side) / side for side in filled.shape)
        radius = np.hypot(y[:, None], x[None])
        if not filled[radius > ROUND].any() and _is_filled_within(filled, radius):
            return axis
    return None


def _is_filled_within(filled: np.ndarray, radius: np.ndarray) -> bool:
    """Return whether every square within the circle, as large as a corner beyond it, holds
    something.
    """
    edge = [max(2, int(CORNER * side)) for side in filled.shape]
    for y in range(0, filled.shape[0] - edge[0] + 1, edge[0]):
        for x in range(0, filled.shape[1] - edge[1] + 1, edge[1]):
            square = slice(y, y + edge[0]), slice(x, x + edge[1])
            if radius[square].max() < 1 and not filled[square].any():
                return False
    return True


def _inscribe(start: int, stop: int) -> tuple[int, int]:
    """Return the side of the square within a circle that fills a side."""
    side = stop - start
    width = int(side / np.sqrt(2))
    first = start + (side - width) // 2
    return first, first + width

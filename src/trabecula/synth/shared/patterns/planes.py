"""What pictures show of the patterns of a volume, and the patterns nearest to given ones that show
it.

A picture shows chords along its axes, and squares of 2 x 2 pixels: faces of the cubes of 2 x 2 x 2
voxels. Of all densities of cubes that have these faces those are taken that are nearest to the
given ones in relative entropy: faces are scaled in turn until all are met (Deming and Stephan 1940,
doi:10.1214/aoms/1177731829; Csiszar 1975, doi:10.1214/aop/1176996454). Euler numbers, which no
slice shows, stay those of the given ones, and so do neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.views import View, is_seen_alike
from trabecula.synth.shared.content.phase_fractions import phases_of
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.patterns.counts import LEAST_VOXELS, MOST_PHASES, Patterns
from trabecula.synth.shared.patterns.densities import NEAREST, PatternDensities
from trabecula.synth.shared.patterns.kernels import STRIDES

_CORNERS = np.arange(8).reshape(2, 2, 2)
_FACES = [
    (axis, tuple(_CORNERS.take(1 - end, axis).ravel().tolist()))  # the corners that are not of it
    for axis in range(3)
    for end in range(2)
]
_ROUNDS = 60  # over all faces
_NEVER = 1e-9  # density of cubes that do not occur
_WINDOW = 32  # pixels a side of a window of a picture, at least
_PARTS = 4  # of them along its shorter side, at most
_STEPS = 20  # of Newton's method, towards an Euler number


@dataclass(frozen=True)
class PlanePatterns:
    """Densities that pictures show.

    Attributes
    ----------
    phases : int
    chords : three arrays (bins of an axis,), or None
        Along every axis, None where no picture shows it.
    squares : three arrays (strides, p, p, p, p), or None
        Across every axis, None where no picture is seen across it: of the phases of the corners,
        row by row.
    """

    phases: int
    chords: tuple[np.ndarray | None, ...]
    squares: tuple[np.ndarray | None, ...]

    @classmethod
    def of(
        cls, views: Sequence[View], present: Sequence[int], orientations: str = "none"
    ) -> PlanePatterns:
        """Measure pictures of labels, turned and mirrored as far as a volume may be; one picture
        that is seen across all axes in every way.
        """
        order, which = tuple(present), _turns_of(views, orientations)
        return cls._of_views(views, len(order), lambda image: _measure(image, order, which))

    @classmethod
    def at_fraction(
        cls,
        views: Sequence[View],
        present: Sequence[int],
        fraction: float,
        orientations: str = "none",
    ) -> PlanePatterns | None:
        """Estimate those of a material with another fraction of the second of two phases, from how
        they change with it from window to window of the pictures; None where these do not tell.

        All pictures are taken to change by as much as the volume does.
        """
        order, which = tuple(present), _turns_of(views, orientations)
        images = {id(view.image): view.image for view in views}
        rises = {n: _Rise.of(image, order, which) for n, image in images.items()}
        mean = float(np.mean([rise.fraction for rise in rises.values()]))
        more = fraction - mean
        if not all(rise.tells_of(more) for rise in rises.values()):
            return None
        return cls._of_views(views, len(order), lambda image: rises[id(image)].after(more))

    @classmethod
    def _of_views(
        cls,
        views: Sequence[View],
        phases: int,
        measure: Callable[[Image], tuple[list[np.ndarray], np.ndarray]],
    ) -> PlanePatterns:
        """Collect what is measured of the picture of every view."""
        along: list[list[np.ndarray]] = [[], [], []]
        squares: list[np.ndarray | None] = [None, None, None]
        images = {id(view.image): view.image for view in views}  # one may be seen in all planes
        measured = {n: measure(image) for n, image in images.items()}
        for view in views:
            own, squares[view.axis] = measured[id(view.image)]
            for line, axis in zip(own, view.across, strict=True):
                along[axis].append(line)
        chords = tuple(np.mean(own, axis=0) if own else None for own in along)
        return cls(phases, chords, tuple(squares))

    def nearest_to(self, given: PatternDensities) -> PatternDensities:
        """Return the densities nearest to given ones that show what the pictures do."""
        found, bins = given.with_chords(self.chords), given.bins
        own, shape = found.own.copy(), (self.phases,) * 8
        cubes = own[bins.cubes : bins.neighbours].reshape(len(STRIDES), bins.combinations)
        eighths = np.rint(8 * bins.euler).astype(np.int64)
        euler = np.array([_by_corner(one, shape) for one in eighths])
        for number, before in enumerate(cubes):
            faces = [None if one is None else one[number] for one in self.squares]
            kept = euler if STRIDES[number] == 1 else euler[:0]
            cubes[number] = _by_code(with_faces(_by_corner(before, shape), faces, kept))
        return replace(found, own=own)


@dataclass(frozen=True)
class _Rise:
    """Chords and squares of a picture of two phases, and by how much they rise with the fraction of
    the second one from window to window; `below` and `above` its own fraction windows are found.
    """

    chords: list[np.ndarray]
    squares: np.ndarray
    chord_slopes: list[np.ndarray]
    square_slopes: np.ndarray
    fraction: float
    below: float
    above: float

    @classmethod
    def of(cls, image: Image, order: tuple[int, ...], which: str) -> _Rise:
        """Measure a picture and its windows."""
        chords, squares = _measure(image, order, which)
        fraction = float(np.mean(image.values == order[1]))
        windows = list(_windows(image))
        far = np.array([float(np.mean(one.values == order[1])) for one in windows]) - fraction
        parts = [_measure(one, order, which) for one in windows]
        weights = far / max(float(np.square(far).sum()), _NEVER)
        pairs = list(zip(weights, parts, strict=True))
        chord_slopes = [
            sum((weight * (part[0][n] - own) for weight, part in pairs), np.zeros_like(own))
            for n, own in enumerate(chords)
        ]
        square_slopes = sum(
            (weight * (part[1] - squares) for weight, part in pairs), np.zeros_like(squares)
        )
        ends = (-far).max(initial=0.0), far.max(initial=0.0)
        return cls(chords, squares, chord_slopes, square_slopes, fraction, *map(float, ends))

    def tells_of(self, more: float) -> bool:
        """Return whether there are windows whose fraction is so much higher."""
        return -max(self.below, NEAREST) <= more <= max(self.above, NEAREST)

    def after(self, more: float) -> tuple[list[np.ndarray], np.ndarray]:
        """Return chords and squares where the fraction is so much higher."""
        pairs = zip(self.chords, self.chord_slopes, strict=True)
        chords = [np.maximum(own + more * slope, 0) for own, slope in pairs]
        squares = np.maximum(self.squares + more * self.square_slopes, 0)
        return chords, squares / squares.sum(axis=(1, 2, 3, 4), keepdims=True)


def _windows(image: Image) -> Iterator[Image]:
    """Yield the windows of a picture, side by side."""
    width = max(_WINDOW, min(image.shape) // _PARTS)
    for y, x in np.ndindex(*(side // width for side in image.shape)):
        inside = (slice(y * width, (y + 1) * width), slice(x * width, (x + 1) * width))
        yield replace(image, values=np.ascontiguousarray(image.values[inside]))


def _turns_of(views: Sequence[View], orientations: str) -> str:
    """Name the symmetries in which pictures count."""
    return "all" if is_seen_alike(views) else orientations


def _measure(
    image: Image, order: tuple[int, ...], which: str
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the chords along rows and along columns of a picture, and its squares of all strides,
    means over its symmetries.
    """
    turns = symmetries(which, ndim=2, spacing=image.spacing)
    plane = phases_of(np.ascontiguousarray(image.values)[None], order)
    chords = list(Patterns.of(plane, len(order)).chord_densities[1:])
    if len({turn.axes for turn in turns}) > 1:
        chords = [np.mean(chords, axis=0)] * 2
    corners = [apply_symmetry(np.arange(4).reshape(1, 2, 2), turn).ravel() for turn in turns]
    counted = [count_squares(plane[0], len(order), stride) for stride in STRIDES]
    squares = [np.mean([one.transpose(turned) for turned in corners], axis=0) for one in counted]
    return chords, np.array(squares)


def are_told(views: Sequence[View], count: int) -> bool:
    """Return whether pictures of so many phases are large enough to tell their squares."""
    size = sum({view.picture: view.image.values.size for view in views}.values())
    return count <= MOST_PHASES and size >= LEAST_VOXELS * count**4


def count_squares(plane: np.ndarray, phases: int, stride: int) -> np.ndarray:
    """Return the densities (p, p, p, p) of the phases of four pixels of (Y, X) uint8, `stride`
    apart, row by row.
    """
    code = np.zeros([max(0, side - stride) for side in plane.shape], np.int64)
    for row in range(2):
        for column in range(2):
            shifted = plane[stride * row :, stride * column :]
            code = code * phases + shifted[: code.shape[0], : code.shape[1]]
    counts = np.bincount(code.ravel(), minlength=phases**4)
    return np.asarray(counts.reshape((phases,) * 4) / max(1, code.size))


def with_euler(given: PatternDensities, wanted: np.ndarray) -> PatternDensities:
    """Return the densities nearest to given ones with other Euler numbers a voxel, (numbers,) as
    `PatternDensities.euler` has them.
    """
    bins, own = given.bins, given.own.copy()
    cubes = own[bins.cubes : bins.cubes + bins.combinations]
    eighths, whole = np.rint(8 * bins.euler).astype(np.int64), cubes.sum()
    found = cubes / whole
    for _ in range(_ROUNDS):
        for counts, number in zip(eighths, wanted, strict=True):
            found = _with_mean(found, counts, 8 * float(number) / whole)
    cubes[:] = found * whole
    return replace(given, own=own)


def with_faces(
    cubes: np.ndarray, faces: Sequence[np.ndarray | None], kept: np.ndarray
) -> np.ndarray:
    """Return the densities (p,) * 8, by the phases of the corners, nearest to given ones whose
    faces across every axis (p, p, p, p) are as asked and whose means of whole counts `kept` (n,
    *cubes) stay, as far as they go with the faces: the last ones rather than the first.
    """
    asked = [(faces[axis], others) for axis, others in _FACES if faces[axis] is not None]
    wanted = [float((counts * cubes).sum()) for counts in kept]
    found = np.maximum(cubes, _NEVER)
    found /= found.sum()
    for _ in range(_ROUNDS):
        for face, others in asked:
            have = found.sum(axis=others)
            found = found * np.expand_dims(face / np.maximum(have, _NEVER**2), others)
        for counts, mean in zip(kept, wanted, strict=True):
            found = _with_mean(found, counts, mean)
    return found


def _with_mean(cubes: np.ndarray, counts: np.ndarray, wanted: float) -> np.ndarray:
    """Return the densities nearest to given ones with a mean of whole counts: each is multiplied by
    one factor as often as its count says.

    By products alone: the last bits of an exponential differ between processors, and with them
    voxels would.
    """
    least, factor = int(counts.min()), 1.0
    for _ in range(_STEPS):
        powers = np.cumprod([1.0, *[factor] * (int(counts.max()) - least)])
        found = cubes * powers[counts - least]
        found /= found.sum()
        mean = (found * counts).sum()
        spread = (found * counts**2).sum() - mean**2
        step = float(np.clip((wanted - mean) / max(spread, _NEVER**2), -0.5, 0.5))
        factor *= 1 + step
        if abs(step) < _NEVER:
            break
    return np.asarray(found)


def _by_corner(codes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return values (codes,) of cubes by the phases of their corners: the first is the lowest
    digit of a code.
    """
    return codes.reshape(shape).transpose()


def _by_code(corners: np.ndarray) -> np.ndarray:
    return corners.transpose().ravel()

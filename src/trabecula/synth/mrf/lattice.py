"""The output at each scale: its levels, its free and known voxels, its part of the result, and the
classes of its sites that may change at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, sum_slabs, thread_count
from trabecula.synth.mrf.picture_levels import PictureLevels

ALL = np.zeros((0, 0, 0), bool)
"""To a kernel: every voxel is marked."""

# bytes a pixel of the plane that a thread works on: drawn at random, or of known voxels
_DRAWN = 40
_ENTERED = {"labels": 20, "grey": 20, "colour": 80}


@dataclass
class SiteLattice:
    """The output at one scale.

    Attributes
    ----------
    levels : (Z, Y, X) uint8
        Present level of every voxel.
    free : (Z, Y, X) bool, or None
        Voxels to be made. Here and below None stands for all.
    domain : (Z, Y, X) bool, or None
        Voxels that count as neighbours: free and known ones; none outside a form.
    box : three int, or None
        Corner of the lattice that is the result, whose shares are controlled; a rim beyond it is
        made as well and then cut away.
    form : bool of the shape of the box, or None
        Voxels of the box that are the result.

    Notes
    -----
    A torus: every axis is periodic. Along axes where the result is not periodic, the lattice is
    longer than the result.
    """

    levels: np.ndarray
    free: np.ndarray | None = None
    domain: np.ndarray | None = None
    box: tuple[int, ...] | None = None
    form: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the voxels along z, y, x."""
        return self.levels.shape

    def in_result(self, sites: np.ndarray) -> np.ndarray:
        """Mark the sites (S,) that are voxels of the result, (S,) bool."""
        if self.form is None and self.box in (None, self.shape):
            return np.ones(len(sites), bool)
        z, rest = np.divmod(sites, self.shape[1] * self.shape[2])
        y, x = np.divmod(rest, self.shape[2])
        depth, height, width = self.box or self.shape
        asked = np.asarray((z < depth) & (y < height) & (x < width))
        if self.form is not None:
            asked[asked] = self.form[z[asked], y[asked], x[asked]]
        return asked

    def result_mask(self, first: int, last: int) -> np.ndarray:
        """Mark the voxels of the result in these planes, bool."""
        depth, height, width = self.box or self.shape
        asked = np.zeros((last - first, *self.shape[1:]), bool)
        part = asked[: max(0, min(last, depth) - first), :height, :width]
        part[...] = True if self.form is None else self.form[first : first + len(part)]
        return asked

    def count_known(self, count: int) -> tuple[int, np.ndarray]:
        """Count the free voxels of the result, and its known voxels of each of `count` levels."""

        def work(first: int, last: int) -> np.ndarray:
            asked = self.result_mask(first, last)
            if self.free is None:
                return np.append(np.zeros(count, np.int64), np.count_nonzero(asked))
            free = self.free[first:last]
            held = np.zeros(count, np.int64)
            for plane, marks in zip(self.levels[first:last], asked & ~free, strict=True):
                held += np.bincount(plane[marks], minlength=count)
            return np.append(held, np.count_nonzero(asked & free))

        found = sum_slabs(work, self.shape[0])
        return int(found[-1]), found[:-1]


def marks_or_all(marks: np.ndarray | None) -> np.ndarray:
    """Return the marks, or `ALL` for None, as a kernel takes them."""
    return ALL if marks is None else marks


def half_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape at half the resolution."""
    return tuple(-(-side // 2) for side in shape)


def coarsen_any(marks: np.ndarray) -> np.ndarray:
    """Mark the cells (Z, Y, X) bool at half the resolution in which any of the eight voxels is
    marked.
    """
    coarse = memmap.zeros(half_shape(marks.shape), bool)

    def work(first: int, last: int) -> None:
        for corner in np.ndindex(2, 2, 2):
            part = _of_corner(marks, corner, first, last)
            coarse[first:last][tuple(map(slice, part.shape))] |= part

    for_slabs(work, len(coarse))
    return coarse


def coarsen_known(values: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve the resolution of known voxels (uint8 levels): a cell takes the first of its eight
    voxels that is known.
    """
    result = memmap.zeros(half_shape(known.shape), values.dtype)
    found = memmap.zeros(half_shape(known.shape), bool)

    def work(first: int, last: int) -> None:
        for corner in np.ndindex(2, 2, 2):
            part = _of_corner(known, corner, first, last)
            cells = tuple(map(slice, part.shape))
            before = found[first:last][cells]
            fresh = part & ~before
            result[first:last][cells][fresh] = _of_corner(values, corner, first, last)[fresh]
            before |= fresh

    for_slabs(work, len(result))
    return result, found


def _of_corner(values: np.ndarray, corner: tuple[int, ...], first: int, last: int) -> np.ndarray:
    """Return one of the eight voxels of every cell of the coarse planes first .. last, where there
    is one.
    """
    z, y, x = corner
    return values[2 * first + z : 2 * last : 2, y::2, x::2]


def dilate_box(form: np.ndarray, shape: tuple[int, ...], reach: int) -> np.ndarray:
    """Mark the voxels at most `reach` (a box) from a form at the corner of a torus, (Z, Y,
    X) bool.
    """
    domain = memmap.empty(shape, bool)
    height, width = form.shape[1:]

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            plane = np.zeros(shape[1:], bool)
            near = {(z + step) % shape[0] for step in range(-reach, reach + 1)}
            for other in sorted(near & set(range(len(form)))):
                plane[:height, :width] |= form[other]
            for axis in (0, 1):
                plane = _dilate_periodic(plane, axis, reach)
            domain[z] = plane

    for_slabs(work, shape[0])
    return domain


def _dilate_periodic(plane: np.ndarray, axis: int, reach: int) -> np.ndarray:
    """Mark all cells at most `reach` from the marks of a plane along a periodic axis."""
    wide = plane.copy()
    for step in range(1, reach + 1):
        wide |= np.roll(plane, step, axis)
        wide |= np.roll(plane, -step, axis)
    return wide


def torus_shape(
    shape: Sequence[int], periodic: Sequence[bool], *, count: int, width: int
) -> tuple[int, ...]:
    """Return the shape of the torus that a result is cut from, for `count` scales.

    Along an open axis a neighbourhood must not reach from one end of the result to the other. If
    the lattice ended there, its rim, known from one side only, would look different; and a coarse
    scale needs room for a neighbourhood.
    """
    grain = 2 ** (count - 1)
    return tuple(
        side if around else -(-max(side + width - 1, width * grain) // grain) * grain
        for side, around in zip(shape, periodic, strict=True)
    )


def result_scales(shape: Sequence[int], periodic: Sequence[bool], *, count: int, width: int) -> int:
    """Return how many of `count` scales a result has: at each, a periodic axis has to hold a
    neighbourhood.
    """
    rings = [side for side, around in zip(shape, periodic, strict=True) if around]
    while count > 1 and any(-(-side // 2 ** (count - 1)) < width for side in rings):
        count -= 1
    return count


def lattice_stages(
    request: Request, content: PictureLevels, *, count: int, width: int
) -> tuple[Stage, ...]:
    """Declare the output at `count` scales, finest 0: while it is built, while each scale is
    relaxed, which begins with the coarser one, and while it becomes values.
    """
    masked, given = request.mask is not None, request.fixed is not None
    shapes, boxes = (
        [torus_shape(request.shape, request.periodic, count=count, width=width)],
        [request.shape],
    )
    for _ in range(count):
        shapes.append(half_shape(shapes[-1]))
        boxes.append(half_shape(boxes[-1]))
    levels = [Array(shape, np.uint8) for shape in shapes]
    voxels = [Array(shape, bool) for shape in shapes]
    pixels = thread_count() * math.prod(shapes[0][1:])
    held: dict[str, Array | None] = {}
    scales: list[Stage] = []
    for n in range(count):
        held |= {
            f"levels {n}": levels[n],
            f"domain {n}": voxels[n] if masked else None,
            f"free {n}": voxels[n] if given else None,
            f"form {n}": Array(boxes[n], bool) if masked and n else None,
        }
        coarser = {f"levels {n + 1}": levels[n + 1]} if n + 1 < count else {}
        scales.append(Stage(f"relax {n}", {**held, **coarser}, _DRAWN * pixels))
    known = {f"known {n}": voxels[n] for n in range(count) if given}
    one = content.values[0]
    values = Array((*request.shape, *one.shape), one.dtype, axis=-3 - one.ndim)
    return (
        Stage("build", {**held, **known}, _ENTERED[content.kind] * pixels),
        *scales,
        Stage("values", {"levels 0": levels[0], "values": values}, (12 + 2 * one.nbytes) * pixels),
    )


def build_lattices(
    work: Workspace, request: Request, content: PictureLevels, *, count: int, width: int
) -> None:
    """Build the output at `count` scales in arrays of `lattice_stages`."""
    work.enter("build")
    levels, form = work.zeros("levels 0"), request.mask
    domain: np.ndarray | None = None
    known: np.ndarray | None = None
    if form is not None:
        # A little more than the form, so that its rim as well is known from all sides.
        domain = work.adopt("domain 0", dilate_box(form, levels.shape, width // 2))
    if request.fixed is not None and request.known is not None:
        known = work.adopt("known 0", _enter_known(request, content, levels, domain))
        work.adopt("free 0", _free_sites(domain, known))
    for scale in range(1, count):
        if known is None:
            levels = work.zeros(f"levels {scale}")
        else:
            levels, known = coarsen_known(levels, known)
            work.adopt(f"levels {scale}", levels)
            work.adopt(f"known {scale}", known)
        if domain is not None and form is not None:
            domain = work.adopt(f"domain {scale}", coarsen_any(domain))
            form = work.adopt(f"form {scale}", coarsen_any(form))
        if known is not None:
            work.adopt(f"free {scale}", _free_sites(domain, known))


def lattice_at(work: Workspace, request: Request, scale: int) -> SiteLattice:
    """Return the output at one scale."""
    domain, free, form = (
        work[name] if (name := f"{part} {scale}") in work else None
        for part in ("domain", "free", "form")
    )
    box = request.shape
    for _ in range(scale):
        box = half_shape(box)
    return SiteLattice(
        work[f"levels {scale}"],
        domain if free is None else free,
        domain,
        box,
        form if scale else request.mask,
    )


def _enter_known(
    request: Request, content: PictureLevels, levels: np.ndarray, domain: np.ndarray | None
) -> np.ndarray:
    """Write the levels of known voxels, add them to the domain, and mark them (Z, Y, X) bool."""
    assert request.fixed is not None and request.known is not None
    marks, values, known = (
        request.known,
        request.fixed.values,
        memmap.zeros(levels.shape, bool),
    )
    _, height, width = marks.shape

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            known[z, :height, :width] = marks[z]
            if marks[z].any():
                levels[z, :height, :width][marks[z]] = content.nearest_levels(values[z][marks[z]])
            if domain is not None:
                domain[z, :height, :width] |= marks[z]

    for_slabs(work, len(marks))
    return known


def _free_sites(domain: np.ndarray | None, known: np.ndarray) -> np.ndarray:
    """Mark the voxels of the domain that are not known."""
    free = memmap.empty(known.shape, bool)

    def work(first: int, last: int) -> None:
        np.logical_not(known[first:last], out=free[first:last])
        if domain is not None:
            free[first:last] &= domain[first:last]

    for_slabs(work, len(free))
    return free


ClassName = tuple[int, ...]


def ring_colours(side: int, reach: int, *, even: bool = False) -> tuple[np.ndarray, int]:
    """Colour the cells of a ring so that cells of one colour lie more than `reach` apart; return
    colours and their number.

    Colours begin at 0 again in every block. A ring whose length is no multiple of reach + 1 gets
    some longer blocks, and a few more colours; so does one that needs an `even` number of blocks,
    or has one block.
    """
    blocks = max(1, side // (reach + 1))
    if even and blocks > 1:
        blocks -= blocks % 2
    starts = np.arange(blocks + 1) * side // blocks
    return np.concatenate([np.arange(stop - start) for start, stop in pairwise(starts)]), -(
        -side // blocks
    )


class SiteClasses:
    """Classes of a lattice: no two sites of a class are in each other's neighbourhood in any plane.

    Sites of equal colours along all axes lie too far apart for any plane along the axes. Sites
    whose colours differ along all three share none of these planes; so the class of all (c, c + a,
    c + b) is one, and there are m^2 classes. A plane of two diagonals reaches twice as far along an
    axis; so for `oblique` planes blocks are split like the squares of a chessboard, and there are 2
    m^3 classes.

    Parameters
    ----------
    lattice : SiteLattice
    width : int
        Of the neighbourhoods.
    oblique : bool
        Whether the planes are oblique.
    """

    def __init__(self, lattice: SiteLattice, width: int, *, oblique: bool = False) -> None:
        self.lattice = lattice
        found = [ring_colours(side, width // 2, even=oblique) for side in lattice.shape]
        self._colours = tuple(colours for colours, _ in found)
        self._blocks = tuple(np.cumsum(colours == 0) for colours in self._colours)
        self._count = max(count for _, count in found)
        every = range(self._count)
        self.names: list[ClassName] = [
            (c, a, b, square)
            for c in (every if oblique else [-1])
            for a in every
            for b in every
            for square in ((0, 1) if oblique else (-1,))
        ]

    def sites(self, name: ClassName, first: int, last: int) -> np.ndarray:
        """Return the free sites of a class in the planes first .. last as flat places, rising
        (int64).
        """
        found: np.ndarray = _sites_of_class(
            name,
            self._count,
            first,
            last,
            self._colours,
            self._blocks,
            marks_or_all(self.lattice.free),
        )
        return found


@kernel
def _sites_of_class(name, count, first, last, colours, blocks, free):
    along_z, along_y, along_x = colours
    block_z, block_y, block_x = blocks
    colour, a, b, square = name
    Y, X = len(along_y), len(along_x)
    marks = free.ravel()
    places = np.empty(0, np.int64)
    for fill in range(2):  # how many there are first
        found = 0
        for z in range(first, last):
            if colour >= 0 and along_z[z] != colour:
                continue
            for y in range(Y):
                if along_y[y] != (along_z[z] + a) % count:
                    continue
                for x in range(X):
                    fits = along_x[x] == (along_z[z] + b) % count
                    if square >= 0:
                        fits = fits and (block_z[z] + block_y[y] + block_x[x]) % 2 == square
                    place = (z * Y + y) * X + x
                    if fits and (len(marks) == 0 or marks[place]):
                        if fill:
                            places[found] = place
                        found += 1
        if not fill:
            places = np.empty(found, np.int64)
    return places

"""Largest inscribed spheres: the choice of those that are needed, and painting them.

A sphere is the set of voxels nearer to its centre than its radius. Bare voxels are bits, 64 of a
row to a word, so that a sphere whose voxels all hold a larger one's value already, as most do,
costs a quarter of its rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import distance_transform

# Neighbours in the margined array, nearest first: they are the likeliest to hold the sphere. The
# last number is the row of `_containment`.
_STEPS = tuple(
    (z + 1, y + 1, x + 1, 4 * abs(z) + 2 * abs(y) + abs(x))
    for z, y, x in sorted(product((-1, 0, 1), repeat=3), key=lambda step: sum(map(abs, step)))
    if (z, y, x) != (0, 0, 0)
)


_LONGEST, _LARGEST = 2048.0, 2.0**24
"""Radius, and voxels in an eighth of a sphere, that `_containment` covers at most: half a GiB while
it is made.
"""


@dataclass(frozen=True)
class Spheres:
    """Radii of balls and their ranks: which of the radii that occur, from the smallest up."""

    radius: np.ndarray
    levels: np.ndarray
    whole: bool

    @property
    def top(self) -> int:
        """Return the largest rank."""
        return len(self.levels) - 1

    def rank(self, radius: np.ndarray) -> np.ndarray:
        """Return the ranks of radii that occur, int32."""
        if self.whole:
            return np.rint(radius * radius).astype(np.int32)
        return np.searchsorted(self.levels, radius).astype(np.int32)


def inscribed_spheres(region: np.ndarray, steps: np.ndarray, wraps: tuple[bool, ...]) -> Spheres:
    """Return the largest ball in a region, (Z, Y, X) bool, about each of its voxels; `steps` are
    the edges of a voxel in units of the smallest.
    """
    radius = distance_transform(region, spacing=steps.tolist(), periodic=wraps)
    if bool((steps == 1).all()):  # squares are whole numbers: no need to sort
        top = int(np.rint(np.float64(radius.max()) ** 2))
        return Spheres(radius, np.sqrt(np.arange(top + 1, dtype=np.float32)), whole=True)
    return Spheres(radius, np.unique(np.append(radius[region], np.float32(0))), whole=False)


def paint_largest(radius: np.ndarray, spacing: np.ndarray, wraps: tuple[bool, ...]) -> np.ndarray:
    """Return the diameter of the largest sphere that holds each voxel, 0 where none does.

    Parameters
    ----------
    radius : float32 array, (Z, Y, X)
        Of the sphere about every voxel; 0 where there is none.
    spacing : float64 array, (3,)
        In units of the smallest edge.
    wraps : three bool
        Spheres continue at the opposite face.
    """
    need = _containment(float(radius.max()), spacing)
    # A margin of one voxel: the neighbours beyond a face are other voxels, or none.
    around = np.zeros(tuple(side + 2 for side in radius.shape), np.float32)
    around[1:-1, 1:-1, 1:-1] = radius
    for axis, wrap in enumerate(wraps):
        if wrap:
            layers = np.moveaxis(around, axis, 0)
            layers[0], layers[-1] = layers[-2], layers[1]
    ridge = np.zeros(radius.shape, bool)
    for_slabs(lambda a, b: _find_ridge(around, need, ridge, a, b), len(ridge))
    centres = np.flatnonzero(ridge)
    own = radius.ravel()[centres]
    order = np.argsort(-own, kind="stable")
    own = own[order]
    places = np.array(np.unravel_index(centres[order], radius.shape), np.int32)
    for axis, wrap in enumerate(wraps):
        if wrap:
            own, places = _with_images(own, places, axis, radius.shape[axis], float(spacing[axis]))
    bare = _bare_bits(radius > 0)
    diameter = np.zeros(radius.shape, np.float32)
    for_slabs(
        lambda a, b: _paint(own, places, spacing, bare, diameter, a, b), len(diameter), least=32
    )
    return diameter


def _with_images(
    own: np.ndarray, places: np.ndarray, axis: int, side: int, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return spheres, largest first, and their images beyond the faces of an axis that reach into
    it.
    """
    reach = (own / edge).astype(np.int64)
    turns = int(reach.max(initial=0)) // side + 1
    chosen: list[np.ndarray] = [np.arange(len(own))]
    shift: list[np.ndarray] = [np.zeros(len(own), np.int64)]
    for turn in (*range(-turns, 0), *range(1, turns + 1)):
        image = places[axis] + turn * side
        near = np.flatnonzero((image + reach >= 0) & (image - reach < side))
        chosen.append(near)
        shift.append(np.full(len(near), turn * side))
    index = np.concatenate(chosen)
    order = np.argsort(index, kind="stable")
    moved = places[:, index[order]]
    moved[axis] += np.concatenate(shift)[order].astype(np.int32)
    return own[index[order]], moved


def _bare_bits(inside: np.ndarray) -> np.ndarray:
    """Return the voxels without a diameter as bits: bit x % 64 of word x // 64 is voxel x.

    (Z + 1, Y + 1, words). The last slice and the last row are empty: they stand for whatever is
    outside.
    """
    depth, height, width = inside.shape
    octets = np.zeros((depth + 1, height + 1, -(-width // 64) * 8), np.uint8)
    octets[:depth, :height, : -(-width // 8)] = np.packbits(inside, axis=2, bitorder="little")
    return octets.view("<u8")


def _containment(largest: float, spacing: np.ndarray) -> np.ndarray:
    """Return the squared radius that a neighbour's sphere must exceed to hold every voxel of a
    sphere, by offset and squared radius.

    Dougherty and Kunzelmann 2007 (doi:10.1017/S1431927607074430): spheres are compared as sets of
    voxels, since hardly any pair of them holds as spheres of the plane do. Entry [4 dz + 2 dy + dx,
    n] is for all voxels nearer than sqrt(n). The last entry is infinite, for spheres larger than a
    table of bounded size shows: those stay.
    """
    within = min(largest, _LONGEST, np.cbrt(_LARGEST * np.prod(spacing)))
    steps = int(np.ceil(within**2)) + 1
    z, y, x = (np.arange(int(np.sqrt(steps) / edge) + 2.0) for edge in spacing)
    norm = (
        ((z * spacing[0]) ** 2)[:, None, None]
        + ((y * spacing[1]) ** 2)[:, None]
        + (x * spacing[2]) ** 2
    )
    # The ball of step n holds the voxels of norm < n; norm n itself first counts at step n + 1.
    step = np.floor(norm * (1 + 1e-9)).astype(np.int64) + 1
    inside = step <= steps
    need = np.zeros((8, steps + 2), np.float32)
    for offset in range(1, 8):
        dz, dy, dx = offset >> 2, offset >> 1 & 1, offset & 1
        far = (
            (((z + dz) * spacing[0]) ** 2)[:, None, None]
            + (((y + dy) * spacing[1]) ** 2)[:, None]
            + ((x + dx) * spacing[2]) ** 2
        )
        np.maximum.at(need[offset], step[inside], far[inside].astype(np.float32))
        need[offset, -1] = np.inf
        np.maximum.accumulate(need[offset], out=need[offset])
    return need


@kernel
def _find_ridge(around, need, ridge, start, stop):
    """Mark where no neighbour with a larger radius holds every voxel of this sphere. `around` has a
    margin of 1.
    """
    _, height, width = ridge.shape
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                own = around[z + 1, y + 1, x + 1]
                if own == 0:
                    continue
                n = int(min(np.ceil(own * own - 1e-3), np.float64(need.shape[1] - 1)))
                keep = True
                for step in _STEPS:
                    other = around[z + step[0], y + step[1], x + step[2]]
                    if other > own and other * other >= need[step[3], n] * np.float32(1.000001):
                        keep = False
                        break
                ridge[z, y, x] = keep


@inline
def _paint_word(row, out, word, mask, value):
    """Give the bare voxels of a word of a row their value; they are bare no longer."""
    left = row[word] & mask
    row[word] ^= left
    x = word * 64
    while left:
        if left & np.uint64(1):
            out[x] = value
        left >>= np.uint64(1)
        x += 1


@inline
def _paint_rows(bare, diameter, slices, rows, word, mask, value):
    depth, height, _ = diameter.shape
    for z in slices:
        for y in rows:
            if z < depth and y < height:
                _paint_word(bare[z, y], diameter[z, y], word, mask, value)


@kernel
def _paint(own, places, spacing, bare, diameter, start, stop):
    """Paint spheres from the largest down, in slices start..stop. Four rows, mirrored at the
    centre, are looked at at once.
    """
    depth, height, width = diameter.shape
    words = bare.ravel()
    per_row = bare.shape[2]
    every = np.uint64(0xFFFFFFFFFFFFFFFF)
    square, per_edge = spacing[1] ** 2, 1.0 / spacing[2]
    for k in range(len(own)):
        radius = np.float64(own[k])
        z, y, x = np.int64(places[0, k]), np.int64(places[1, k]), np.int64(places[2, k])
        reach = int(radius / spacing[0])
        if z + reach < start or z - reach >= stop:
            continue
        # Voxels nearer than the radius, the nearest outside voxel (at exactly the radius) left out.
        limit = radius * radius * (1.0 - 1e-6)
        for dz in range(reach + 1):
            rest = limit - (dz * spacing[0]) ** 2
            z0 = z - dz if start <= z - dz < stop else depth
            z1 = z + dz if start <= z + dz < stop else depth
            if rest <= 0.0 or z0 == z1 == depth:
                continue
            for dy in range(int(np.sqrt(rest) / spacing[1]) + 1):
                left = rest - dy * dy * square
                half = int(np.sqrt(left) * per_edge) if left > 0.0 else 0
                low = x - half if x > half else 0
                high = x + half if x + half < width else width - 1
                y0 = y - dy if 0 <= y - dy < height else height
                y1 = y + dy if 0 <= y + dy < height else height
                if low > high:
                    continue
                # Unsigned, or each look would ask whether the index counts from the end.
                a = np.uint64((z0 * (height + 1) + y0) * per_row)
                b = np.uint64((z0 * (height + 1) + y1) * per_row)
                c = np.uint64((z1 * (height + 1) + y0) * per_row)
                d = np.uint64((z1 * (height + 1) + y1) * per_row)
                word, last = np.uint64(low) >> np.uint64(6), np.uint64(high) >> np.uint64(6)
                mask = every << np.uint64(low & 63)
                while word <= last:
                    if word == last:
                        mask &= every >> np.uint64(63 - (high & 63))
                    if (
                        words[a + word] | words[b + word] | words[c + word] | words[d + word]
                    ) & mask:
                        _paint_rows(
                            bare,
                            diameter,
                            (z0, z1),
                            (y0, y1),
                            np.int64(word),
                            mask,
                            np.float32(2.0 * radius),
                        )
                    mask = every
                    word += np.uint64(1)

"""The exemplars as a library of patches: their size and period, and their labels packed into 64-bit
words, so that the mismatch of a candidate in an overlap of any form takes a few exclusive-ors.

A *wide* word holds as many rows of a patch as fit into 64 bits; a *narrow* one more rows of as many
columns as an overlap has. Both exist for every voxel of the exemplars as the word's first. Labels
of more than one bit have a word per bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.target import is_apparent
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_items
from trabecula.fields.local import windowed
from trabecula.measure.labelling import label_components, labels_at_faces
from trabecula.measure.percolation import AXES
from trabecula.numerics.bits import count_bits
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.period import agreement, cell_shifts, common_periods
from trabecula.synth.shared.orient import Symmetry, apply_symmetry, symmetries

MOST_LABELS = 16
"""Labels are below it; a power of two, so that a mask takes marks off a label."""

_LEAST, _MOST = 8, 24  # voxels of a patch by default

_OVER = 0.4  # share of a patch, or a period, that overlaps

_PER_DIP = 2.5  # such a patch over the distance at which agreement is least


@dataclass(frozen=True)
class PatchLibrary:
    """The exemplars as one stack, with all that does not depend on a request.

    Attributes
    ----------
    images : tuple of Image
        Every exemplar in every orientation, as it is quilted from.
    stack : (S, Z, Y, X) uint8
        Their labels; 0 beyond a smaller one's end. Of pictures Z is 1.
    patch, overlap : int
    periods : three of float or None
    shifts : (S, 3) int64
        Voxels by which an exemplar's cells are shifted from the first one's.
    words : PackedLabels
    measured : mapping of str to tuple of float32 arrays
        Descriptors of every patch of every exemplar that do not follow from its labels alone.
    turns : tuple of Symmetry
        How the images of one exemplar are turned, one after the other.
    apparent : dict of (int, str) to float32 array
        Apparent properties of all windows of an image as far as they were solved.
    """

    images: tuple[Image, ...]
    stack: np.ndarray
    patch: int
    overlap: int
    periods: tuple[float | None, ...]
    shifts: np.ndarray
    words: PackedLabels
    measured: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)
    turns: tuple[Symmetry, ...] = ()
    apparent: dict[tuple[int, str], np.ndarray] = field(default_factory=dict)

    @classmethod
    def build(cls, exemplars: Sequence[Image], config: QuiltConfig) -> PatchLibrary:
        """Build it from exemplars of labels of one material, all 2-D or all 3-D."""
        own = [
            _as_3d(labels)
            for labels in (remove_unconnected(image, config.connected) for image in exemplars)
        ]
        periods = common_periods(own) if config.period == "auto" else (None, None, None)
        patch, overlap = choose_sizes(own, config, periods)
        check_fits(exemplars, patch)
        turns = symmetries(
            config.orientations, ndim=exemplars[0].ndim, spacing=exemplars[0].spacing
        )
        turned = [_orient(labels, turn, exemplars[0].ndim) for labels in own for turn in turns]
        stack = _stack_labels(turned)
        planes = label_bits(max(int(labels.max()) for labels in own) + 1)
        words = PackedLabels.pack(stack, patch=patch, overlap=overlap, planes=planes)
        flat = exemplars[0].ndim == 2
        images = tuple(
            replace(exemplars[0], values=labels[0] if flat else labels) for labels in turned
        )
        shifts = cell_shifts(turned, periods)
        return cls(images, stack, patch, overlap, periods, shifts, words, turns=turns)

    @property
    def flat(self) -> bool:
        """Return whether the exemplars are pictures."""
        return self.images[0].ndim == 2

    @property
    def descriptor_size(self) -> int:
        """Return the side of the cube that a patch's descriptors are measured in, about its centre:
        the patch, or as many whole periods of a lattice as it holds. Part of a further period would
        count its struts, or its hollows, twice.
        """
        known = {period for period in self.periods[int(self.flat) :]}
        period = known.pop() if len(known) == 1 else None
        if period is None or period != round(period) or period > self.patch:
            return self.patch
        return self.patch // round(period) * round(period)

    @property
    def descriptor_centre(self) -> int:
        """Return the offset from a patch's first voxel to the centre of its descriptors, as in
        `fields.measure`.
        """
        return (self.patch - self.descriptor_size) // 2 + (self.descriptor_size - 1) // 2

    def describe_patches(self, number: int, name: str) -> np.ndarray:
        """Measure a descriptor of every patch of image `number`, float32, one value a position."""
        if name in self.measured:
            return self.measured[name][number]
        image, off = self.images[number], (self.patch - self.descriptor_size) // 2
        if is_apparent(name):
            found = self._apparent(number, name)
        else:
            found = windowed(image, size=self.descriptor_size, names=[name])[name]
        return found[tuple(slice(off, off + side - self.patch + 1) for side in image.shape)]

    def _apparent(self, number: int, name: str) -> np.ndarray:
        """Return an apparent property of all windows of image `number`: those of the exemplar that
        it is a turned copy of, solved once.
        """
        which = number % len(self.turns)
        turn, first = self.turns[which], number - which
        head, colon, axis = name.partition(":")
        own = f"{head}:{AXES[turn.axes[AXES.index(axis)]]}" if colon else name
        if (first, own) not in self.apparent:
            found = windowed(self.images[first], size=self.descriptor_size, names=[own])
            self.apparent[first, own] = found[own]
        return np.asarray(apply_symmetry(self.apparent[first, own][None], turn)[0])

    @property
    def box(self) -> tuple[int, int, int]:
        """Return the voxels of a patch along every axis."""
        return (1 if self.flat else self.patch, self.patch, self.patch)

    @property
    def step(self) -> tuple[int, int, int]:
        """Return the voxels between patches along every axis."""
        by = self.patch - self.overlap
        return (1 if self.flat else by, by, by)

    @property
    def strides(self) -> tuple[int, int, int]:
        """Return the voxels of the stack from one exemplar, layer and row to the next."""
        _, depth, height, width = self.stack.shape
        return (depth * height * width, height * width, width)

    @property
    def counts(self) -> list[tuple[int, ...]]:
        """Return the positions of a patch along every axis of every exemplar."""
        shapes = [(1,) * (3 - image.ndim) + image.shape for image in self.images]
        return [
            tuple(side - p + 1 for side, p in zip(shape, self.box, strict=True)) for shape in shapes
        ]

    def patch_at(self, at: int) -> np.ndarray:
        """Return the patch that begins at a voxel of the stack."""
        by_source, by_layer, by_row = self.strides
        (source, at), (depth, height, width) = divmod(at, by_source), self.box
        (z, at) = divmod(at, by_layer)
        y, x = divmod(at, by_row)
        return np.ascontiguousarray(
            self.stack[source, z : z + depth, y : y + height, x : x + width]
        )


def void_label(phases: Sequence[str]) -> int:
    """Return the label of the void: the phase of that name, or 0."""
    return list(phases).index("void") if "void" in phases else 0


def remove_unconnected(image: Image, connected: str) -> np.ndarray:
    """Remove components that could never be connected: solid that floats inside the exemplar, where
    the solid is to be connected, and enclosed void, where the void is.
    """
    labels, void = image.values, void_label(image.phases)
    if connected in ("solid", "both"):
        labels = np.where(_mark_unconnected(labels != void), np.uint8(void), labels)
    if connected in ("void", "both"):
        lost = _mark_unconnected(labels == void)
        solid = np.bincount(labels[labels != void], minlength=1)
        labels = np.where(lost, np.uint8(solid.argmax()), labels) if solid.any() else labels
    return labels


def _mark_unconnected(inside: np.ndarray) -> np.ndarray:
    """Mark components that touch no face of the image, except the largest."""
    numbers, sizes = label_components(inside)
    lost = ~labels_at_faces(numbers, len(sizes))
    lost[0] = False
    if len(sizes):
        lost[1 + int(sizes.argmax())] = False
    return lost[numbers]


def choose_sizes(
    own: Sequence[np.ndarray], config: QuiltConfig, periods: Sequence[float | None]
) -> tuple[int, int]:
    """Return patch and overlap: the settings, or sizes that suit the exemplars."""
    if config.patch:
        overlap = config.overlap or min(max(3, round(_OVER * config.patch)), config.patch - 1)
        return config.patch, overlap
    axes = [axis for axis in range(3) if own[0].shape[axis] > 1]
    shortest = min(labels.shape[axis] for labels in own for axis in axes)
    found = [period for period in periods if period is not None]
    if found:
        overlap = config.overlap or max(3, round(_OVER * max(found)))
        patch = round(max(found)) + overlap
    else:
        dips = [_first_dip(labels, axis) for labels in own for axis in axes]
        patch = round(_PER_DIP * sum(dips) / len(dips))
        overlap = 0
    patch = min(
        max(patch, _LEAST, config.overlap + 1),
        _MOST if not found else 64,
        max(_LEAST, shortest // 2),
    )
    return patch, min(config.overlap or overlap or max(3, round(_OVER * patch)), patch - 1)


def _first_dip(labels: np.ndarray, axis: int) -> int:
    """Return the distance of the first minimum of agreement: about half of a structure and
    its gap.
    """
    curve = agreement(labels, axis, max(1, labels.shape[axis] // 3))
    rises = np.flatnonzero(np.diff(curve) > 0)
    return int(rises[0]) if len(rises) else len(curve) - 1


def check_fits(exemplars: Sequence[Image], patch: int) -> None:
    """Raise where a patch fits in an exemplar in one place at most."""
    for exemplar in exemplars:
        if min(exemplar.shape) < patch + 1:
            raise InputError(
                f"the exemplar is {exemplar.shape}, a patch of {patch} needs at least {patch + 1} "
                "voxels along every axis: give a larger exemplar, or a smaller patch"
            )


def _as_3d(labels: np.ndarray) -> np.ndarray:
    """Return labels with three axes."""
    return np.ascontiguousarray(labels if labels.ndim == 3 else labels[None])


def _orient(labels: np.ndarray, turn: Symmetry, ndim: int) -> np.ndarray:
    """Return labels in another orientation."""
    own = labels if ndim == 3 else labels[0]
    return _as_3d(apply_symmetry(own[None], turn)[0])


def _stack_labels(turned: Sequence[np.ndarray]) -> np.ndarray:
    """Stack labels of different shapes, with 0 beyond a smaller one's end."""
    shape = np.max([labels.shape for labels in turned], axis=0)
    stack = np.zeros((len(turned), *shape), np.uint8)
    for own, labels in zip(stack, turned, strict=True):
        own[tuple(slice(side) for side in labels.shape)] = labels
    return stack


MOST_COLUMNS = 64

_AT_A_TIME = 256  # candidates


def label_bits(labels: int) -> int:
    """Return the bits of a label, of so many labels."""
    return max(1, int(labels - 1).bit_length())


@dataclass(frozen=True)
class PackedLabels:
    """The exemplars' words. `wide` and `narrow` are (planes, voxels) uint64; rows and columns are
    those of a word.
    """

    wide: np.ndarray
    narrow: np.ndarray
    rows: tuple[int, int]
    columns: tuple[int, int]

    @classmethod
    def pack(cls, stack: np.ndarray, *, patch: int, overlap: int, planes: int) -> PackedLabels:
        """Pack a stack of exemplars (S, Z, Y, X) uint8."""
        columns = (patch, overlap)
        rows = tuple(min(patch, MOST_COLUMNS // width) for width in columns)
        made = [np.empty((planes, stack.size), np.uint64) for _ in columns]
        layers = stack.reshape(-1, *stack.shape[-2:])
        for table, high, width in zip(made, rows, columns, strict=True):
            for plane in range(planes):
                _pack_words(layers, plane, high, width, table[plane].reshape(layers.shape))
        return cls(made[0], made[1], (rows[0], rows[1]), columns)


@dataclass(frozen=True)
class OverlapQuery:
    """The words of one overlap: their offsets from a candidate's first voxel, the bits that they
    should hold, and the masks of those that count.
    """

    offsets: np.ndarray  # int64
    narrow: np.ndarray  # bool
    bits: np.ndarray  # (planes, n) uint64
    masks: np.ndarray  # uint64
    voxels: int

    def every_nth(self, nth: int) -> OverlapQuery:
        """Keep every nth word; words run through the box row by row, so each is of another part of
        the overlap.
        """
        offsets, narrow, bits, masks = (
            np.ascontiguousarray(words[..., ::nth])
            for words in (self.offsets, self.narrow, self.bits, self.masks)
        )
        return OverlapQuery(
            offsets,
            narrow,
            bits,
            masks,
            int(np.unpackbits(masks.view(np.uint8)).sum(dtype=np.int64)),
        )


def overlap_query(
    words: PackedLabels, box: np.ndarray, near: np.ndarray, strides: tuple[int, int]
) -> OverlapQuery:
    """Collect the words that hold `near` (bool) of a box of labels."""
    planes, most = len(words.wide), box.shape[0] * box.shape[1]
    offsets, narrow = np.empty(most, np.int64), np.empty(most, np.bool_)
    bits, masks = np.zeros((planes, most), np.uint64), np.zeros(most, np.uint64)
    count, voxels = _cover(
        box, near, *strides, words.rows, words.columns, offsets, narrow, bits, masks
    )
    return OverlapQuery(
        offsets[:count],
        narrow[:count],
        np.ascontiguousarray(bits[:, :count]),
        masks[:count],
        int(voxels),
    )


def mismatches(words: PackedLabels, query: OverlapQuery, at: np.ndarray) -> np.ndarray:
    """Count the voxels of the overlap that differ, int32, for candidates with their first voxels
    `at` (int64): equation (5).
    """
    found = np.zeros(len(at), np.int32)
    overlap = query.offsets, query.narrow, query.bits, query.masks
    count = partial(_count_mismatches, words.wide, words.narrow, *overlap, at, found)
    for_items(count, len(at), least=_AT_A_TIME)
    return found


@kernel
def _pack_words(layers, plane, rows, columns, words):
    """Pack one bit of the labels into words: bit j * columns + i of a word is voxel (y + j, x + i);
    beyond the layer it is 0.
    """
    depth, height, width = layers.shape
    kept = ~np.uint64(0) >> np.uint64(64 - columns)
    one = np.uint64(1)
    lines = np.zeros((height, width), np.uint64)
    for z in range(depth):
        for y in range(height):
            line = np.uint64(0)
            for x in range(width - 1, -1, -1):
                line = ((line << one) | np.uint64((layers[z, y, x] >> plane) & 1)) & kept
                lines[y, x] = line
        for y in range(height):
            for x in range(width):
                word = np.uint64(0)
                for j in range(min(rows, height - y)):
                    word |= lines[y + j, x] << np.uint64(j * columns)
                words[z, y, x] = word


@kernel
def _count_mismatches(wide, narrow, offsets, is_narrow, bits, masks, at, found, start, stop):
    """Count mismatches of candidates start..stop word by word, for some of them at a time, so that
    a word is one simple loop over counts that stay in the cache.
    """
    planes = len(bits)
    for begin in range(start, stop, _AT_A_TIME):
        end = min(begin + _AT_A_TIME, stop)
        for w in range(len(offsets)):
            offset, mask, first = offsets[w], masks[w], bits[0, w]
            table = narrow if is_narrow[w] else wide
            if planes == 1:
                for n in range(begin, end):
                    found[n] += np.int32(count_bits((table[0, at[n] + offset] ^ first) & mask))
            else:
                for n in range(begin, end):
                    other = table[0, at[n] + offset] ^ first
                    for plane in range(1, planes):
                        other |= table[plane, at[n] + offset] ^ bits[plane, w]
                    found[n] += np.int32(count_bits(other & mask))


@kernel
def _cover(box, near, stride_z, stride_y, rows, columns, offsets, narrow, bits, masks):
    """Cover an overlap with words: rows that reach over more columns than a narrow word has take
    wide words; the others share narrow ones.
    """
    depth, height, width = box.shape
    first, last = np.empty(height, np.int64), np.empty(height, np.int64)
    count = voxels = 0
    for z in range(depth):
        for y in range(height):
            first[y], last[y] = width, -1
            for x in range(width):
                if near[z, y, x]:
                    first[y], last[y] = min(first[y], x), x
                    voxels += 1
        for y in range(height):
            if last[y] < 0:
                continue
            slim = last[y] - first[y] < columns[1]
            begin = first[y] if slim else 0
            which = 1 if slim else 0
            offsets[count], narrow[count] = z * stride_z + y * stride_y + begin, slim
            for j in range(min(rows[which], height - y)):
                if slim and (first[y + j] < begin or last[y + j] >= begin + columns[1]):
                    continue
                for x in range(first[y + j], last[y + j] + 1):
                    if near[z, y + j, x]:
                        bit = np.uint64(1) << np.uint64(j * columns[which] + x - begin)
                        masks[count] |= bit
                        label = box[z, y + j, x] & (MOST_LABELS - 1)
                        for plane in range(len(bits)):
                            if (label >> plane) & 1:
                                bits[plane, count] |= bit
                first[y + j], last[y + j] = width, -1
            count += 1
    return count, voxels

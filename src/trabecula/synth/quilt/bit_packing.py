"""Labels packed into 64-bit words, so that a candidate's mismatch in an overlap of any form is a
few exclusive-ors.

A *wide* word holds as many rows of a patch as fit into 64 bits; a *narrow* one more rows of as many
columns as an overlap has. Both are there for every voxel of the exemplars as the word's first.
Labels of more than one bit have a word per bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.voxel_codes import FIXED

MOST_COLUMNS = 64
_AT_A_TIME = 256  # candidates


def planes_for(labels: int) -> int:
    """Bits of a label, of so many labels."""
    return max(1, int(labels - 1).bit_length())


@dataclass(frozen=True)
class Words:
    """The exemplars' words. `wide` and `narrow` are (planes, voxels) uint64; rows and columns are
    those of a word.
    """

    wide: np.ndarray
    narrow: np.ndarray
    rows: tuple[int, int]
    columns: tuple[int, int]

    @classmethod
    def of(cls, stack: np.ndarray, *, patch: int, overlap: int, planes: int) -> Words:
        """Of a stack of exemplars (S, Z, Y, X) uint8."""
        columns = (patch, overlap)
        rows = tuple(min(patch, MOST_COLUMNS // width) for width in columns)
        made = [np.empty((planes, stack.size), np.uint64) for _ in columns]
        layers = stack.reshape(-1, *stack.shape[-2:])
        for table, high, width in zip(made, rows, columns, strict=True):
            for plane in range(planes):
                _pack(layers, plane, high, width, table[plane].reshape(layers.shape))
        return cls(made[0], made[1], (rows[0], rows[1]), columns)


@dataclass(frozen=True)
class Query:
    """The words of one overlap: where each begins beside a candidate's first voxel, what it should
    hold and what counts.
    """

    offsets: np.ndarray  # int64
    narrow: np.ndarray  # bool
    bits: np.ndarray  # (planes, n) uint64
    masks: np.ndarray  # uint64
    voxels: int

    def every(self, nth: int) -> Query:
        """Every nth of its words; they run through the box row by row, so that each is of another
        part of the overlap.
        """
        offsets, narrow, bits, masks = (
            np.ascontiguousarray(words[..., ::nth])
            for words in (self.offsets, self.narrow, self.bits, self.masks)
        )
        return Query(
            offsets,
            narrow,
            bits,
            masks,
            int(np.unpackbits(masks.view(np.uint8)).sum(dtype=np.int64)),
        )


def query_of(words: Words, box: np.ndarray, near: np.ndarray, strides: tuple[int, int]) -> Query:
    """The words that hold `near` (bool) of a box of labels."""
    planes, most = len(words.wide), box.shape[0] * box.shape[1]
    offsets, narrow = np.empty(most, np.int64), np.empty(most, np.bool_)
    bits, masks = np.zeros((planes, most), np.uint64), np.zeros(most, np.uint64)
    count, voxels = _cover(
        box, near, *strides, words.rows, words.columns, offsets, narrow, bits, masks
    )
    return Query(
        offsets[:count],
        narrow[:count],
        np.ascontiguousarray(bits[:, :count]),
        masks[:count],
        int(voxels),
    )


def mismatches(words: Words, query: Query, at: np.ndarray) -> np.ndarray:
    """How many voxels of the overlap differ, for candidates with their first voxels `at` (int64):
    equation (5). int32.
    """
    found = np.zeros(len(at), np.int32)
    _count(
        words.wide, words.narrow, query.offsets, query.narrow, query.bits, query.masks, at, found
    )
    return found


@kernel
def _pack(layers, plane, rows, columns, words):
    """Bit j * columns + i of a word is voxel (y + j, x + i); what lies beyond the layer is 0."""
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


@inline
def ones(word):
    """How many bits are set; compilers know this form and put one instruction in its place."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def _count(wide, narrow, offsets, is_narrow, bits, masks, at, found):
    """Word by word for some candidates at a time, so that a word is one simple loop over counts
    that stay in the cache.
    """
    planes = len(bits)
    for begin in range(0, len(at), _AT_A_TIME):
        end = min(begin + _AT_A_TIME, len(at))
        for w in range(len(offsets)):
            offset, mask, first = offsets[w], masks[w], bits[0, w]
            table = narrow if is_narrow[w] else wide
            if planes == 1:
                for n in range(begin, end):
                    found[n] += np.int32(ones((table[0, at[n] + offset] ^ first) & mask))
            else:
                for n in range(begin, end):
                    other = table[0, at[n] + offset] ^ first
                    for plane in range(1, planes):
                        other |= table[plane, at[n] + offset] ^ bits[plane, w]
                    found[n] += np.int32(ones(other & mask))


@kernel
def _cover(box, near, stride_z, stride_y, rows, columns, offsets, narrow, bits, masks):
    """Rows that reach over more columns than a narrow word has take wide words; the others share
    narrow ones.
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
                        label = box[z, y + j, x] & (FIXED - 1)
                        for plane in range(len(bits)):
                            if (label >> plane) & 1:
                                bits[plane, count] |= bit
                first[y + j], last[y + j] = width, -1
            count += 1
    return count, voxels

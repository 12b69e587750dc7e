"""Votes: fields in int16, in so fine steps that their mean can be ranked; what starts from noise
starts from such.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs

UNIT = 256
"""An int8 step of a field in the int16 of votes."""

_WORDS = 4  # of 64 bits that the generator makes at once


def votes_of(field: np.ndarray) -> np.ndarray:
    """A field (C, Z, Y, X) int8 as votes (int16)."""
    votes = memmap.empty(field.shape, np.int16, least=0)  # another process may write it

    def work(start: int, stop: int) -> None:
        np.multiply(field[:, start:stop], np.int16(UNIT), out=votes[:, start:stop], dtype=np.int16)

    for_slabs(work, field.shape[1], anywhere=True)
    return votes


def noise(shape: Sequence[int], key: int) -> np.ndarray:
    """White noise (C, Z, Y, X) int16, even from -8192 to 8191: the successive words of one
    generator.
    """
    votes = memmap.empty(shape, np.int16)
    channels, depth, height, width = votes.shape

    def work(start: int, stop: int) -> None:
        for c in range(channels):
            for z in range(start, stop):
                before = (c * depth + z) * height * width
                generator = np.random.Philox(key=key, counter=before // _WORDS)
                generator.random_raw(before % _WORDS)
                raw = generator.random_raw(height * width) >> np.uint64(50)
                votes[c, z] = raw.astype(np.int16).reshape(height, width) - np.int16(8192)

    for_slabs(work, depth)
    return votes

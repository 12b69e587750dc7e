"""The seed rule: every random number is a function of (seed, stage, coordinate), never of the order
of work.

`key` turns a seed and the name of a stage into the 64-bit key of a counter-based generator;
`generator` is the NumPy generator for one coordinate of that stage. Kernels use the same key with
`engine.random`.
"""

from __future__ import annotations

import hashlib

import numpy as np


def key(seed: int, stage: str) -> np.uint64:
    """Return a 64-bit key for one stage of one seed."""
    digest = hashlib.blake2b(f"{seed}/{stage}".encode(), digest_size=8).digest()
    return np.uint64(int.from_bytes(digest, "little"))


def generator(seed: int, stage: str, *coordinate: int) -> np.random.Generator:
    """Return a NumPy generator for one coordinate (up to three integers) of a stage."""
    counter = np.zeros(4, np.uint64)
    counter[1 : 1 + len(coordinate)] = np.asarray(coordinate, np.int64).view(np.uint64)
    return np.random.Generator(np.random.Philox(key=int(key(seed, stage)), counter=counter))

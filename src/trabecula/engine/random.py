"""Counter-based random numbers inside kernels: Philox4x32-10 (Salmon et al. 2011,
doi:10.1145/2063384.2063405).

The counter is a coordinate, the key comes from `core.seeds.key`. Any voxel's numbers can be drawn
alone, in any order.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline

_MASK = np.uint64(0xFFFFFFFF)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_SHIFT = np.uint64(32)


@inline
def philox(key, c0, c1, c2, c3):
    """Return four independent uint32 (as uint64) for one 4 x 32-bit counter under a 64-bit key."""
    k0, k1 = np.uint64(key) & _MASK, np.uint64(key) >> _SHIFT
    x0, x1, x2, x3 = (
        np.uint64(np.int64(c0)) & _MASK,
        np.uint64(np.int64(c1)) & _MASK,
        np.uint64(np.int64(c2)) & _MASK,
        np.uint64(np.int64(c3)) & _MASK,
    )
    for _ in range(10):
        p0, p1 = _M0 * x0, _M1 * x2
        x0, x1, x2, x3 = (p1 >> _SHIFT) ^ x1 ^ k0, p1 & _MASK, (p0 >> _SHIFT) ^ x3 ^ k1, p0 & _MASK
        k0, k1 = (k0 + _W0) & _MASK, (k1 + _W1) & _MASK
    return x0, x1, x2, x3


@inline
def below(word, n):
    """Return a uniform integer in 0..n-1 from one word of `philox` (bias below n / 2**32)."""
    return np.int64((word * np.uint64(n)) >> _SHIFT)

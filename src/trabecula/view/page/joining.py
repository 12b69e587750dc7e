"""Labels taken together in blocks by coverage, so that thin walls stay.

A block is drawn where half of it is, as by majority. A wall thinner than half a block covers less,
and would vanish; so a block is drawn as well where it holds more of the drawn phases than its two
neighbours along some axis together: the crest of a wall, or the axis of a strut. Such walls are
drawn one block thick.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trabecula.engine.lazy_volume import Slabs

THIN = 128
"""Added to the label of a block that only a thin wall makes drawn."""

_HALF = 128  # of 255


def join_labels(
    volume: Slabs, block: Sequence[int], box: Sequence[tuple[int, int]] | None = None
) -> np.ndarray:
    """Join blocks of labels.

    Parameters
    ----------
    volume : Slabs
    block : (z, y, x)
        Voxels along the edges of a block.
    box : ((z, z1), (y, y1), (x, x1)), optional
        Which blocks. Default: all whole ones.

    Returns
    -------
    labels : (Z, Y, X) uint8
        Of a drawn block the most frequent of the drawn labels in it, else of the others. Drawn is
        every phase but "void"; without a void all are, and the most frequent counts. THIN is added
        to the label of a block that is less than half covered: the page must not blur it away.
    """
    counts = [side // size for side, size in zip(volume.shape, block, strict=True)]
    wanted = [(0, count) for count in counts] if box is None else list(box)
    # One block more all round, for the neighbours.
    read = [(max(0, a - 1), min(b + 1, n)) for (a, b), n in zip(wanted, counts, strict=True)]
    shown = np.array([name != "void" for name in volume.phases])
    shape = tuple(b - a for a, b in read)
    cover, label, behind = (np.zeros(shape, np.uint8) for _ in range(3))
    for k, voxels in enumerate(_layers(volume, block, read)):
        votes = np.stack([_count(voxels == one, block) for one in range(len(shown))])
        cover[k] = votes[shown].sum(axis=0) * 255 // np.prod(block)
        label[k] = np.flatnonzero(shown)[votes[shown].argmax(axis=0)] if shown.any() else 0
        behind[k] = np.flatnonzero(~shown)[votes[~shown].argmax(axis=0)] if not shown.all() else 0
    kept = kept_blocks(cover, block) | shown.all()
    joined = np.where(kept, label, behind) | np.where(kept & (cover < _HALF), THIN, 0)
    inner = tuple(
        slice(a - first, b - first) for (a, b), (first, _) in zip(wanted, read, strict=True)
    )
    return np.ascontiguousarray(joined[inner], np.uint8)


def kept_blocks(cover: np.ndarray, block: Sequence[int]) -> np.ndarray:
    """Return which blocks are drawn, (Z, Y, X) bool.

    Parameters
    ----------
    cover : (Z, Y, X) uint8
        Share of the drawn phases in each block, of 255.
    block : (z, y, x)
        Less than half a voxel's wall in a block is a speck, and is not drawn.
    """
    kept = cover >= _HALF
    least = 255 // (2 * max(block))
    for axis in range(cover.ndim):
        if cover.shape[axis] == 1:
            continue
        lines, out = np.moveaxis(cover, axis, 0), np.moveaxis(kept, axis, 0)
        empty = np.zeros_like(lines[0])
        for k, here in enumerate(lines):
            before = lines[k - 1] if k else empty
            after = lines[k + 1] if k + 1 < len(lines) else empty
            # Of two equal neighbours the first: a wall is drawn once, and none ends in a crest.
            falls = here >= after if k else here > after
            crest = (here >= least) & (here > before) & falls
            out[k] |= crest & (before.astype(np.int16) + after <= here)
    return kept


def _layers(
    volume: Slabs, block: Sequence[int], spans: Sequence[tuple[int, int]]
) -> Iterator[np.ndarray]:
    """Yield the voxels of one layer of blocks after the other; a chunk of the store is read once,
    or twice where a layer ends within it.
    """
    (first, last), *across = spans
    step = max(1, -(-volume.grain // block[0]))
    for whole in range(first - first % step, last, step):
        start, stop = max(whole, first), min(whole + step, last)
        slab = volume.read(
            tuple(
                (a * size, b * size)
                for (a, b), size in zip(((start, stop), *across), block, strict=True)
            )
        )
        yield from slab.reshape(stop - start, block[0], *slab.shape[1:])


def _count(inside: np.ndarray, block: Sequence[int]) -> np.ndarray:
    """Return how many voxels of each block of a layer (z, Y, X) are inside, (rows, columns)."""
    _, tall, wide = block
    narrow = np.uint8 if len(inside) < 256 else np.uint16
    columns = np.add.reduce(inside.view(np.uint8), axis=0, dtype=narrow)
    rows = columns.reshape(-1, tall, columns.shape[1]).sum(axis=1, dtype=np.uint16)
    return rows.reshape(len(rows), -1, wide).sum(axis=2, dtype=np.uint32)

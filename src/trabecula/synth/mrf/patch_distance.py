"""From the neighbours of sites to weights by centre: by bits where labels allow, else by a matrix
product.
"""

from __future__ import annotations

import numpy as np

from trabecula.synth.mrf.density import bins_of_bits, bins_of_products
from trabecula.synth.mrf.gather import bit_rows, plain_rows, weighted_rows
from trabecula.synth.mrf.patches import Source, codes_of


def weigh(
    found: np.ndarray,
    weight: np.ndarray,
    steps: int,
    source: Source,
    features: np.ndarray,
    view: int,
    bins: np.ndarray,
    scratch: np.ndarray,
) -> None:
    """The weights by centre of one view: `bins` (S, V, L) int64, [:, view] is written.

    `found` and `weight` (S, K) uint8 are the neighbours' levels and weights, in `steps`; `scratch`
    has room for S products.
    """
    if source.bits is not None:
        words = np.empty((len(found), len(source.bits)), np.uint64)
        masks = np.empty_like(words)
        bit_rows(found, weight, *codes_of(len(features)), words, masks)
        bins_of_bits(
            words, masks, source.bits, source.centres, source.times, source.table, view, bins
        )
        return
    complete = weight.all(axis=1) if steps == 1 else np.zeros(len(weight), bool)
    for rows, plain in ((np.flatnonzero(complete), True), (np.flatnonzero(~complete), False)):
        if len(rows) == len(found):
            _weigh_products(
                found, weight, steps, source, features, view, bins, scratch, plain=plain
            )
        elif len(rows):
            part = np.empty((len(rows), 1, bins.shape[2]), np.int64)
            _weigh_products(
                found[rows], weight[rows], steps, source, features, 0, part, scratch, plain=plain
            )
            bins[rows, view] = part[:, 0]


def _weigh_products(
    found: np.ndarray,
    weight: np.ndarray,
    steps: int,
    source: Source,
    features: np.ndarray,
    view: int,
    bins: np.ndarray,
    scratch: np.ndarray,
    *,
    plain: bool,
) -> None:
    """The same by a matrix product; `plain` where all neighbours count in full, which takes fewer
    columns.
    """
    assert source.plain is not None and source.weighted is not None
    columns = source.plain if plain else source.weighted
    rows = np.empty((len(found), len(columns)), np.float32)
    if plain:
        plain_rows(found, features, rows)
    else:
        weighted_rows(found, weight, features, rows)
    products = scratch[: len(rows), : columns.shape[1]]
    np.matmul(rows, columns, out=products)
    table, shift = (
        (source.table, source.shift)
        if steps == 1
        else (source.weighted_table, source.weighted_shift)
    )
    bins_of_products(products, source.centres, table, shift, view, bins)

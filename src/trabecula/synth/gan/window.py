"""Any box of an unlimited material: the tiles of one endless grid that touch it, each made alone,
then cropped.

A tile's latent is a function of seed and place, its shape is always the same, and its network runs
in one thread: so a voxel does not depend on the box, on other tiles or on the number of threads.
(Networks give other last bits for other shapes, which is why a smaller box does not get a smaller
tile.)

Where specks are removed, a tile is made with half a cell more on every side: no speck is so wide
that a face could hide its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np
import torch

from trabecula.core.progress import track
from trabecula.engine.blocks import Box
from trabecula.engine.gaussian_random import normal_cells, quantiles
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.synth.gan.decode import CELLS, remove_specks


def make_tiles(
    network: Any,
    key: np.uint64,
    box: Box,
    periods: tuple[int, ...],
    decode: Callable[[np.ndarray], np.ndarray],
    dtype: Any,
    *,
    specks: int = 0,
) -> np.ndarray:
    """Return the values of a box.

    Parameters
    ----------
    network : generator of `networks.load_generator`
    key : of the seed's latent
    box : three pairs of int, voxels
    periods : three ints
        Cells after which an axis repeats; 0 where it does not.
    decode : (K, Z, Y, X) float32 field -> (Z, Y, X) values
    dtype : of the values
    specks : int
        Edge of the components that are removed, voxels; for labels alone.
    """
    values = np.empty([last - first for first, last in box], dtype)
    edge = CELLS * network.cell
    tiles = list(product(*(range(first // edge, -(-last // edge)) for first, last in box)))
    # One piece of work an item of `track`, so that there is progress; as many tiles as threads in
    # each.
    width = thread_count()
    with _single_threaded_networks():
        for first in track(range(0, len(tiles), width), "tiles"):
            together = tiles[first : first + width]

            def work(start: int, stop: int, together: list[Any] = together) -> None:
                for tile in together[start:stop]:
                    inside, target = _overlap(box, tile, edge)
                    field = _tile_field(network, key, tile, periods, margin_cells(specks))
                    if specks:
                        beyond = (slice(network.cell // 2, network.cell // 2 + edge),) * 3
                        values[target] = remove_specks(decode(field), specks)[beyond][inside]
                    else:
                        values[target] = decode(field[(slice(None), *inside)])

            for_slabs(work, len(together), least=1)
    return values


def margin_cells(specks: int) -> int:
    """Return the cells that a tile has beyond its own."""
    return 1 if specks else 0


def _tile_field(
    network: Any, key: np.uint64, tile: tuple[int, ...], periods: tuple[int, ...], more: int
) -> np.ndarray:
    """Return the field of a tile and of `more` cells after it, (K, Z, Y, X) float32."""
    halo = network.halo
    latent = np.empty((network.latent, *(CELLS + more + 2 * halo,) * 3), np.float32)
    corner = np.array([CELLS * place - halo for place in tile], np.int64)
    normal_cells(latent, key, corner, np.array(periods, np.int64), quantiles())
    weight = next(network.parameters())
    with torch.inference_mode():
        z = torch.from_numpy(latent)[None].to(weight.dtype, memory_format=torch.channels_last_3d)
        field: np.ndarray = network.cells(z)[0].float().numpy()
    return field


def _overlap(
    box: Box, tile: tuple[int, ...], edge: int
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the overlap of a tile and a box: its slices in the tile, and in the box."""
    inside, target = [], []
    for (first, last), place in zip(box, tile, strict=True):
        start, stop = max(first, place * edge), min(last, (place + 1) * edge)
        inside.append(slice(start - place * edge, stop - place * edge))
        target.append(slice(start - first, stop - first))
    return tuple(inside), tuple(target)


@contextmanager
def _single_threaded_networks() -> Iterator[None]:
    """Run networks in the thread that calls them: tiles are spread over threads, not layers."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)

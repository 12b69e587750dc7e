"""From the field of a generator to the values of an image, the calibration for it, and any box of
the endless material.

Each voxel counts alone, so windows agree. A field has one channel for two phases (rising into the
phase of the higher label), one for grey,
and one for each phase where there are more. A calibration is plain JSON: {"kind": "labels",
"present": [0, 1], "offsets": [t]} where the higher label is given above t; {"kind": "labels",
"present": [0, 1, 2], "offsets": [a, b, c]} where the channel that is highest after its offset is
added gives the label; {"kind": "grey", "dtype": "uint8", "from": [...], "to": [...]}, rising
tables.

A box is cropped from the tiles of one endless grid that touch it, each made alone. A tile's latent
is a function of seed and place, its shape is always the same, and its network runs in one thread:
so a voxel does not depend on the box, on other tiles or on the number of threads. (Networks give
other last bits for other shapes, which is why a smaller box does not get a smaller tile.) Where
specks are removed, a tile is made with half a cell more on every side: no speck is so wide that a
face could hide its neighbours. Where voxels change phase for the sake of patterns, with as many
more as hold these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.compile import inline, kernel
from trabecula.engine.gaussian_random import normal_cells, quantiles
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.engine.rows import copy_row
from trabecula.synth.gan.local_fractions import LocalFractions
from trabecula.synth.shared.patterns.kernels import MARGIN

CELLS = 8
"""Cells of the latent along an edge of a tile; more would waste less around it, and more on boxes
that are no multiple.
"""

LARGEST_SPECK = 2
"""Edge of the largest box, voxels, whose components may be removed: none of
them can enclose another.
"""

# Calibration takes every third voxel along every axis: neighbours say nearly the same, and an odd
# step meets all places of a cell.
_EVERY = 3
_LEVELS = 257  # of the table of grey values
_RESPONSES, _TILES = 9, 8  # fractions that are tried, and tiles for each

Given = Callable[[tuple[int, ...], tuple[int, ...]], np.ndarray]
"""Returns the local fractions of cells from a corner on, of so many sides: (K, *sides) float32."""

Flips = Callable[[np.ndarray, np.ndarray, tuple[int, ...]], np.ndarray]
"""Returns the values of a tile, some of them changed, of those with `MARGIN` voxels more on every
side, of the field that they were made of, and of its place in the grid."""

_ROUNDS = 200  # of moving the offsets of several phases


def decode(field: np.ndarray, calibration: Mapping[str, Any]) -> np.ndarray:
    """Convert a field to labels or grey values.

    Parameters
    ----------
    field : (K, Z, Y, X) float32 array
    calibration : mapping

    Returns
    -------
    (Z, Y, X) uint8 array, or grey of the exemplar's dtype
    """
    if calibration["kind"] == "grey":
        dtype = np.dtype(calibration["dtype"])
        values = np.interp(field[0], calibration["from"], calibration["to"])
        return (np.rint(values) if dtype.kind in "iu" else values).astype(dtype)
    present = np.asarray(calibration["present"], np.uint8)
    offsets = np.asarray(calibration["offsets"], np.float32)
    if len(present) == 2:
        return present[(field[0] > offsets[0]).view(np.uint8)]
    best, index = field[0] + offsets[0], np.zeros(field.shape[1:], np.uint8)
    for place in range(1, len(present)):
        value = field[place] + offsets[place]
        index[value > best] = place
        np.maximum(best, value, out=best)
    return present[index]


def remove_specks(labels: np.ndarray, edge: int) -> np.ndarray:
    """Remove the components that fit into a box of `edge` voxels along every axis.

    Components are joined across faces. One takes the label before its first voxel along x: its own
    neighbourhood alone decides, so that windows agree. Components that touch the border of the
    array stay, since they may go on beyond it. Scans have such specks too, but fewer.

    Parameters
    ----------
    labels : (Z, Y, X) uint8 array
    edge : int
        0 .. 2 voxels; 0 removes nothing.

    Returns
    -------
    labels : (Z, Y, X) uint8 array
    """
    found = np.ascontiguousarray(labels).copy()
    if edge:
        _clear_specks(
            np.ascontiguousarray(labels), edge, np.empty((LARGEST_SPECK**3, 3), np.int64), found
        )
    return found


@kernel
def _clear_specks(labels, edge, voxels, found):
    """Visit every voxel that can be the first of a component in raster order.

    `voxels` is room for the places of one component.
    """
    depth, height, width = labels.shape
    for z in range(1, depth - 1):
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                label = labels[z, y, x]
                if (
                    labels[z, y, x - 1] == label
                    or labels[z, y - 1, x] == label
                    or labels[z - 1, y, x] == label
                ):
                    continue
                for number in range(_gather(labels, z, y, x, edge, voxels)):
                    a, b, c = voxels[number]
                    found[a, b, c] = labels[z, y, x - 1]


@inline
def _gather(labels, z, y, x, edge, voxels):
    """Collect the voxels of the component that starts with a voxel; return their number.

    0 where it starts before, is larger than `edge` or touches the border.
    """
    low, high = np.array([z, y, x]), np.array([z, y, x])
    copy_row(voxels[0], low)
    count, at = 1, 0
    here = np.empty(3, np.int64)
    while at < count:
        for side in range(6):
            axis = side >> 1
            copy_row(here, voxels[at])
            here[axis] += 1 if side & 1 else -1
            if here[axis] < 0 or here[axis] == labels.shape[axis]:
                return 0
            if labels[here[0], here[1], here[2]] != labels[z, y, x]:
                continue
            known = False
            for number in range(count):
                known = known or (
                    voxels[number, 0] == here[0]
                    and voxels[number, 1] == here[1]
                    and voxels[number, 2] == here[2]
                )
            if known:
                continue
            if here[0] < z or (here[0] == z and (here[1] < y or (here[1] == y and here[2] < x))):
                return 0
            low[axis] = min(low[axis], here[axis])
            high[axis] = max(high[axis], here[axis])
            if high[axis] - low[axis] >= edge:
                return 0
            copy_row(voxels[count], here)
            count += 1
        at += 1
    return count


def calibrate(
    network: Any,
    images: Sequence[Image],
    seed: int,
    *,
    tiles: int | None = None,
    local: LocalFractions | None = None,
) -> dict[str, Any]:
    """Calibrate a generator so that `decode` gives the exemplar's fractions or grey values.

    The noise is one that the training never saw.

    Parameters
    ----------
    network : generator
        As `networks.load_generator` returns it, in the arithmetic of inference.
    images : sequence of Image
        The exemplar, or the pictures.
    seed : int
        Of the training.
    tiles : int, optional
        Number of tiles of noise. Default: the network's. Fractions differ from tile to tile, so
        that few tiles would shift every sample alike: 32 of bone (64^3) by .0025, half of the
        spread between samples of 120^3.
    local : LocalFractions, optional
        Of a generator that is given them. Default: the mean everywhere.
    """
    field = held_out_field(network, seed, tiles or network.tiles, local=local)
    values = np.concatenate([image.values.ravel() for image in images])
    if images[0].kind == "grey":
        levels = np.linspace(0, 1, _LEVELS)
        tables = {"from": np.quantile(field[0], levels), "to": np.quantile(values, levels)}
        # np.interp wants a rising table: of equal levels the first stays.
        rising = np.concatenate([[True], np.diff(tables["from"]) > 0])
        return {
            "kind": "grey",
            "dtype": str(values.dtype),
            **{k: t[rising].tolist() for k, t in tables.items()},
        }
    present = np.unique(values)
    fractions = np.bincount(values)[present] / values.size
    offsets = (
        [float(np.quantile(field[0], fractions[0]))]
        if len(present) == 2
        else balance_offsets(field, fractions)
    )
    return {"kind": "labels", "present": present.tolist(), "offsets": offsets}


def measure_response(
    network: Any,
    local: LocalFractions,
    calibration: Mapping[str, Any],
    seed: int,
    *,
    drawn: bool = False,
) -> np.ndarray:
    """Return fractions of the higher of two phases that are given everywhere, and those that come
    out, (2, N) rising; of more phases (2, 0).

    With `drawn` the fractions vary as they do in unlimited material, around the one that is given:
    what learnt from pictures has seen no place of an even fraction. Only what rises around the
    mean counts: far from it, where it has seen little, a generator may turn back.
    """
    if len(local.mean) > 1:
        return np.zeros((2, 0))
    given = np.linspace(local.levels[0, 0], local.levels[0, -1], _RESPONSES)
    made = []
    for value in given:
        varied = local if drawn else None
        field = held_out_field(network, seed, _TILES, local=varied, everywhere=float(value))
        made.append(float((field[0] > calibration["offsets"][0]).mean()))
    asked = local.mean[0] + local.deviation[0] * given
    return rising_part(np.stack([asked, made]), int(np.abs(given).argmin()))


def rising_part(response: np.ndarray, middle: int) -> np.ndarray:
    """Return the columns around the one in the middle whose last row rises, (2, N)."""
    falls = np.flatnonzero(np.diff(response[1]) <= 0)
    first = max((place + 1 for place in falls if place < middle), default=0)
    last = min((place for place in falls if place >= middle), default=response.shape[1] - 1)
    return response[:, first : last + 1]


def held_out_field(
    network: Any,
    seed: int,
    tiles: int,
    *,
    local: LocalFractions | None = None,
    everywhere: float = 0.0,
) -> np.ndarray:
    """Return every third voxel along every axis of tiles of noise, (K, voxels) float32.

    A generator that is given local fractions gets those of unlimited material, without `local` the
    mean; in both cases `everywhere` is added, in deviations from the mean.
    """
    torch = need("torch", extra="learn", purpose="method 'gan'")
    weight = next(network.parameters())
    random = torch.Generator().manual_seed(int(key(seed, "gan/held out")) >> 1)
    drawn = key(seed, "gan/held out fractions")
    side = CELLS + 2 * network.halo
    sides, found = (side,) * 3, []
    with torch.inference_mode():
        for tile in range(tiles):
            z = torch.randn(1, network.latent, *sides, generator=random)
            given = torch.zeros(1, network.fractions, *sides)
            if local is not None and network.fractions:
                # Tiles lie far apart, so that they are independent.
                corner = (64 * tile, 0, 0)
                given = torch.from_numpy(local.draw(drawn, corner, sides, (0, 0, 0))[None])
            z = torch.cat([z, given + everywhere], 1)
            z = z.to(weight.device, weight.dtype, memory_format=torch.channels_last_3d)
            field = network.cells(z)[0, :, ::_EVERY, ::_EVERY, ::_EVERY]
            found.append(field.float().flatten(1).cpu().numpy())
    return np.concatenate(found, axis=1)


def balance_offsets(field: np.ndarray, fractions: np.ndarray) -> list[float]:
    """Find offsets of the channels (K, N) such that the largest one gives the fractions, to a few
    in a thousand.

    A phase that is short is raised, one in excess lowered, by steps that shrink once a fraction has
    been passed.
    """
    offsets = np.zeros(len(field), np.float32)
    step: np.ndarray = np.full(len(field), 0.1, np.float32)
    before = np.zeros(len(field))
    for _ in range(_ROUNDS):
        share = (
            np.bincount((field + offsets[:, None]).argmax(0), minlength=len(field)) / field.shape[1]
        )
        missing = fractions - share
        step = np.where(missing * before < 0, step / 2, step * 1.1).astype(np.float32)
        offsets += np.sign(missing).astype(np.float32) * np.minimum(step, 1)
        offsets -= offsets.mean()
        before = missing
        if abs(missing).max() < 2e-4:
            break
    return [float(offset) for offset in offsets]


def make_tiles(
    network: Any,
    key: np.uint64,
    box: Box,
    periods: tuple[int, ...],
    to_values: Callable[[np.ndarray], np.ndarray],
    dtype: Any,
    *,
    specks: int = 0,
    given: Given | None = None,
    flips: Flips | None = None,
) -> np.ndarray:
    """Return the values of a box.

    Parameters
    ----------
    network : generator of `networks.load_generator`
    key : of the seed's latent
    box : three pairs of int, voxels
    periods : three ints
        Cells after which an axis repeats; 0 where it does not.
    to_values : (K, Z, Y, X) float32 field -> (Z, Y, X) values
    dtype : of the values
    specks : int
        Edge of the components that are removed, voxels; for labels alone.
    given : callable, optional
        Of a generator that takes local fractions. Default: the mean everywhere.
    flips : callable, optional
        Changes voxels of tiles. Default: none are changed.
    """
    more = margin_cells(network.cell, specks=specks, flips=flips is not None)
    edge, margin = CELLS * network.cell, more * network.cell // 2
    own = slice(margin, margin + edge)
    values = np.empty([last - first for first, last in box], dtype)
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
                    field = _tile_field(network, key, tile, periods, more, given)
                    if not more:
                        values[target] = to_values(field[(slice(None), *inside)])
                        continue
                    made = remove_specks(to_values(field), specks)
                    if flips is None:
                        made = made[(own,) * 3]
                    else:
                        around = slice(own.start - MARGIN, own.stop + MARGIN)
                        made = np.ascontiguousarray(made[(around,) * 3])
                        made = flips(made, field[(slice(None), own, own, own)], tile)
                    values[target] = made[inside]

            for_slabs(work, len(together), least=1)
    return values


def margin_cells(cell: int, *, specks: int, flips: bool) -> int:
    """Return the cells that a tile has beyond its own along an axis, half of them on either side.

    Specks take an odd number: with or without flips a tile then lies at the same place.
    """
    if not specks:
        return 2 * -(-MARGIN // cell) if flips else 0
    return 1 + 2 * -(-(2 * MARGIN - cell) // (2 * cell)) if flips else 1


def _tile_field(
    network: Any,
    key: np.uint64,
    tile: tuple[int, ...],
    periods: tuple[int, ...],
    more: int,
    given: Given | None,
) -> np.ndarray:
    """Return the field of a tile and of `more` cells around it, the odd one after it, (K, Z, Y, X)
    float32.
    """
    halo = network.halo
    latent = np.empty((network.latent, *(CELLS + more + 2 * halo,) * 3), np.float32)
    corner = np.array([CELLS * place - more // 2 - halo for place in tile], np.int64)
    normal_cells(latent, key, corner, np.array(periods, np.int64), quantiles())
    sides = latent.shape[1:]
    fractions = (
        np.zeros((network.fractions, *sides), np.float32)
        if given is None
        else given(tuple(corner.tolist()), sides)
    )
    latent = np.concatenate([latent, fractions])
    torch, weight = need("torch", extra="learn", purpose="method 'gan'"), next(network.parameters())
    with torch.inference_mode():
        z = torch.from_numpy(latent)[None]
        z = z.to(weight.device, weight.dtype, memory_format=torch.channels_last_3d)
        field: np.ndarray = network.cells(z)[0].float().cpu().numpy()
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
    torch = need("torch", extra="learn", purpose="method 'gan'")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)

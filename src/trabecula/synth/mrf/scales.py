"""From one scale to the next: what is free, known and there at each, and what a finer scale starts
from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.couplings import Couplings
from trabecula.synth.mrf.lattice import Lattice, any_of_eight, grown, halved, known_halved
from trabecula.synth.mrf.relax import Relaxation
from trabecula.synth.mrf.slice_planes import Face


def padded_shape(
    shape: Sequence[int], periodic: Sequence[bool], *, count: int, width: int
) -> tuple[int, ...]:
    """The torus that a result is cut from, for `count` scales.

    Along an open axis a neighbourhood does not reach from one end of the result to the other. Were
    the lattice to end there, its rim, known from one side alone, would look different; and a coarse
    scale needs room for a neighbourhood.
    """
    grain = 2 ** (count - 1)
    return tuple(
        side if around else -(-max(side + width - 1, width * grain) // grain) * grain
        for side, around in zip(shape, periodic, strict=True)
    )


def count_of(shape: Sequence[int], periodic: Sequence[bool], *, count: int, width: int) -> int:
    """How many of `count` scales a result has: a periodic axis has to hold a neighbourhood on each."""
    rings = [side for side, around in zip(shape, periodic, strict=True) if around]
    while count > 1 and any(-(-side // 2 ** (count - 1)) < width for side in rings):
        count -= 1
    return count


def lattices_of(request: Request, content: Content, count: int, width: int) -> list[Lattice]:
    """The output at `count` resolutions at most, finest first."""
    count = count_of(request.shape, request.periodic, count=count, width=width)
    shape = padded_shape(request.shape, request.periodic, count=count, width=width)
    box, form, known = request.shape, request.mask, None
    levels, there = memmap.zeros(shape, np.uint8), None
    if form is not None:
        # A little more than the form, so that its rim as well is known from all sides.
        there = grown(form, shape, width // 2)
    if request.fixed is not None and request.known is not None:
        known = _measured(request, content, levels, there)
    lattices = [Lattice(levels, _without(there, known), there, box, form)]
    while len(lattices) < count:
        if known is None:
            levels = memmap.zeros(halved(levels.shape), np.uint8)
        else:
            levels, known = known_halved(levels, known)
        there = None if there is None else any_of_eight(there)
        box, form = halved(box), None if form is None else any_of_eight(form)
        lattices.append(Lattice(levels, _without(there, known), there, box, form))
    return lattices


def _measured(
    request: Request, content: Content, levels: np.ndarray, there: np.ndarray | None
) -> np.ndarray:
    """Where voxels are known, (Z, Y, X) bool; their levels are written, and they are there."""
    assert request.fixed is not None and request.known is not None
    marks, values, known = request.known, request.fixed.values, memmap.zeros(levels.shape, bool)
    _, height, width = marks.shape

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            known[z, :height, :width] = marks[z]
            if marks[z].any():
                levels[z, :height, :width][marks[z]] = content.levels_of(values[z][marks[z]])
            if there is not None:
                there[z, :height, :width] |= marks[z]

    for_slabs(work, len(marks))
    return known


def _without(there: np.ndarray | None, known: np.ndarray | None) -> np.ndarray | None:
    """What is there and not known."""
    if known is None:
        return there
    free = memmap.empty(known.shape, bool)

    def work(first: int, last: int) -> None:
        np.logical_not(known[first:last], out=free[first:last])
        if there is not None:
            free[first:last] &= there[first:last]

    for_slabs(work, len(free))
    return free


def started(
    lattice: Lattice,
    coarse: np.ndarray | None,
    frames: Sequence[Sequence[Face]],
    content: Content,
    config: MrfConfig,
    *,
    seed: int,
    scale: int,
    wanted: np.ndarray,
    couplings: Couplings | None,
) -> Relaxation:
    """The relaxation of a scale at its start: white noise with the picture's histogram, and what a
    coarser one hands on.

    `wanted` are the shares (L,) of the levels in the result, known voxels among them.

    `coarse` are the levels of the coarser scale; None on the coarsest. A coarse voxel goes to the
    first of its eight ("one", 1/8), or to all ("all", 8/8); either way only the first inherits its
    temperature of 0.
    """
    marginal = np.sum([face.source.marginal for face in frames[0]], axis=0)
    # else there is nothing that it would not overwrite
    if coarse is None or config.upsampling == "one":
        _fill_with_noise(lattice, marginal, seed, scale)
    if coarse is not None:
        _hand_on(lattice, coarse, config.upsampling)
    relaxation = Relaxation(
        lattice, frames, content, config, seed, scale, _of_free(lattice, wanted), couplings
    )
    if config.relaxation == "icm":
        relaxation.temperature, relaxation.held = _warm(lattice, inherits=coarse is not None)
    return relaxation


def _of_free(lattice: Lattice, wanted: np.ndarray) -> np.ndarray:
    """The shares that voxels still to be made need, so that they and the known ones have the wanted
    shares together.
    """
    left, held = lattice.known(len(wanted))
    missing = np.maximum(wanted * (left + int(held.sum())) - held, 0)
    return missing / missing.sum() if left and missing.sum() > 0 else wanted


def _fill_with_noise(lattice: Lattice, marginal: np.ndarray, seed: int, scale: int) -> None:
    """Free voxels drawn from a histogram, each plane with random numbers of its own."""
    ends = np.cumsum(marginal)

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            raw = generator(seed, f"mrf/{scale}/noise", z).bit_generator.random_raw(
                lattice.levels[z].size
            )
            raw %= np.uint64(ends[-1])
            drawn = (
                np.searchsorted(ends, raw, side="right").astype(np.uint8).reshape(lattice.shape[1:])
            )
            _put(lattice, slice(z, z + 1), drawn[None])

    for_slabs(work, lattice.shape[0])


def _hand_on(lattice: Lattice, coarse: np.ndarray, upsampling: str) -> None:
    """What a coarser scale found goes to the first of each eight voxels, or to all; what is not
    free stays.
    """

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            if upsampling == "all":
                found = coarse[z // 2].repeat(2, axis=0).repeat(2, axis=1)
                _put(lattice, slice(z, z + 1), found[None, : lattice.shape[1], : lattice.shape[2]])
            elif z % 2 == 0:
                _put(
                    lattice,
                    (slice(z, z + 1), slice(None, None, 2), slice(None, None, 2)),
                    coarse[None, z // 2],
                )

    for_slabs(work, lattice.shape[0])


def _put(lattice: Lattice, part: Any, found: np.ndarray) -> None:
    """Levels for the free voxels of a part."""
    np.copyto(
        lattice.levels[part], found, where=True if lattice.free is None else lattice.free[part]
    )


def _warm(lattice: Lattice, *, inherits: bool) -> tuple[np.ndarray, np.ndarray]:
    """The temperatures at the start, 1 or 0, and which voxels `inherits` gave one of 0: the first
    of every eight.
    """
    temperature, held = memmap.zeros(lattice.shape, np.float32), memmap.zeros(lattice.shape, bool)

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            free = np.ones(lattice.shape[1:], bool) if lattice.free is None else lattice.free[z]
            if inherits and z % 2 == 0:
                held[z, ::2, ::2] = free[::2, ::2]
            temperature[z] = free & ~held[z]

    for_slabs(work, lattice.shape[0])
    return temperature, held

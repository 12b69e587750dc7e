"""From one scale to the next: what is free, known and there at each, and what a finer scale starts from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.couplings import Couplings
from trabecula.synth.mrf.frame import Face
from trabecula.synth.mrf.lattice import Lattice, any_of_eight, known_halved, within
from trabecula.synth.mrf.relax import Relaxation


def padded_shape(shape: Sequence[int], periodic: Sequence[bool], *, count: int, width: int) -> tuple[int, ...]:
    """The torus that a result is cut from, for `count` scales.

    Along an open axis a neighbourhood does not reach from one end of the result to the other. Were the lattice to end there, its
    rim, known from one side alone, would look different; and a coarse scale needs room for a neighbourhood.
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
    inside = tuple(slice(side) for side in request.shape)
    there, known, levels = np.ones(shape, bool), np.zeros(shape, bool), np.zeros(shape, np.uint8)
    asked = np.zeros(shape, bool)
    asked[inside] = True if request.mask is None else request.mask
    if request.mask is not None:
        # A little more than the form, so that its rim as well is known from all sides.
        there = ~within(~asked, range(3), width // 2)
    if request.fixed is not None and request.known is not None:
        known[inside] = request.known
        there |= known
        levels[known] = content.levels_of(request.fixed.values[request.known])
    lattices = [Lattice(levels, there & ~known, there, asked)]
    while len(lattices) < count:
        levels, known = known_halved(levels, known)
        there, asked = any_of_eight(there), any_of_eight(asked)
        lattices.append(Lattice(levels, there & ~known, there, asked))
    return lattices


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
    """The relaxation of a scale at its start: white noise with the picture's histogram, and what a coarser one hands on.

    `wanted` are the shares (L,) of the levels in the result, known voxels among them.

    `coarse` are the levels of the coarser scale; None on the coarsest. A coarse voxel goes to the first of its eight ("one",
    1/8), or to all ("all", 8/8); either way only the first inherits its temperature of 0.
    """
    inherited = np.zeros(lattice.shape, bool)
    marginal = np.sum([face.source.marginal for face in frames[0]], axis=0)
    _fill_with_noise(lattice, marginal, seed, scale)
    if coarse is not None:
        first = (slice(None, None, 2),) * 3
        found = coarse
        if config.upsampling == "all":
            for axis in range(3):
                found = np.repeat(found, 2, axis=axis)
            found = found[tuple(slice(side) for side in lattice.shape)]
            lattice.levels[lattice.free] = found[lattice.free]
        else:
            part = lattice.free[first]
            lattice.levels[first][part] = found[part]
        inherited[first] = lattice.free[first]
    relaxation = Relaxation(lattice, frames, content, config, seed, scale, _of_free(lattice, wanted), couplings)
    if config.relaxation == "icm":
        relaxation.temperature, relaxation.held = (lattice.free & ~inherited).astype(np.float32), inherited
    return relaxation


def _of_free(lattice: Lattice, wanted: np.ndarray) -> np.ndarray:
    """The shares that voxels still to be made need, so that they and the known ones have the wanted shares together."""
    known = lattice.asked & ~lattice.free
    size, left = int(np.count_nonzero(lattice.asked)), int(np.count_nonzero(lattice.asked & lattice.free))
    held = np.bincount(lattice.levels[known], minlength=len(wanted))
    missing = np.maximum(wanted * size - held, 0)
    return missing / missing.sum() if left and missing.sum() > 0 else wanted


def _fill_with_noise(lattice: Lattice, marginal: np.ndarray, seed: int, scale: int) -> None:
    """Free voxels drawn from a histogram, a plane at a time."""
    ends = np.cumsum(marginal)
    for z, (plane, free) in enumerate(zip(lattice.levels, lattice.free, strict=True)):
        raw = generator(seed, f"mrf/{scale}/noise", z).bit_generator.random_raw(plane.size)
        drawn = np.searchsorted(ends, raw % np.uint64(ends[-1]), side="right").astype(np.uint8)
        plane[free] = drawn.reshape(plane.shape)[free]

"""The end of a generator's material: voxels of interfaces change phase, tile by tile, by what its
patterns are off on average.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.seeds import key
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.decode import Flips, Given, decode, make_tiles
from trabecula.synth.gan.local_fractions import LocalFractions
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.content.phase_fractions import places_of
from trabecula.synth.shared.local_offset import NARROWEST
from trabecula.synth.shared.patterns.bias import PatternBias
from trabecula.synth.shared.patterns.counts import LEAST_VOXELS, MOST_PHASES
from trabecula.synth.shared.patterns.excess import cells_of, excess_of
from trabecula.synth.shared.patterns.kernels import MARGIN

SIDE, LEAST_SIDE = 256, 64
"""Voxels a side of the material that is compared with the exemplar, and of that of a training of
less than `YOUNG` iterations."""

YOUNG = 300

_WINDOW = 64  # of the parts of both that tell how patterns change with the fraction
_SLOPE = 2  # voxels over the field tanh(voxels / 2), next to an interface
_PREFIX = "patterns."
_AROUND = 16  # voxels around a tile that tell what it has too much of
_HELD_CELL = 8  # voxels a side of cells that a target holds

Wanted = Callable[[tuple[int, ...], int], np.ndarray]
"""Returns the fractions (Z, Y, X) of the second of two phases that a target has in a tile of the
grid and so many voxels around it.
"""


def learn_bias(
    network: Any,
    config: GanConfig,
    exemplar: Image,
    calibration: Mapping[str, Any],
    local: LocalFractions | None,
    *,
    side: int = SIDE,
) -> PatternBias | None:
    """Compare a generator's patterns with its exemplar's; None where there are none to compare:
    pictures, grey, more than three phases, or an exemplar too small to tell.

    Parameters
    ----------
    network : generator
        As `networks.load_generator` returns it.
    config : GanConfig
    exemplar : Image
    calibration : mapping
        As `decode` takes it.
    local : LocalFractions, optional
        Of a generator that is given them.
    side : int
        Voxels of the material that is compared.
    """
    present = calibration.get("present", ())
    count = len(present)
    if (
        not config.interface_rounds
        or exemplar.ndim != 3
        or not 2 <= count <= MOST_PHASES
        or exemplar.values.size < LEAST_VOXELS * count**8
    ):
        return None
    places = places_of(present)
    seed, periods = config.seed, (0, 0, 0)
    given: Given | None = None
    if local is not None:
        given = partial(local.draw, key(seed, "gan/patterns fractions"), periods=periods)

    def make(bias: PatternBias | None) -> np.ndarray:
        return places[
            make_tiles(
                network,
                key(seed, "gan/patterns latent"),
                ((0, side),) * 3,
                periods,
                partial(decode, calibration=calibration),
                np.uint8,
                specks=config.specks,
                given=given,
                flips=None if bias is None else make_flips(bias, calibration, seed),
            )
        ]

    width = min(_WINDOW, min(exemplar.shape) // 2)
    return PatternBias.learn([places[exemplar.values]], count, make, width=width)


def make_flips(
    bias: PatternBias,
    calibration: Mapping[str, Any],
    seed: int,
    *,
    wanted: Wanted | None = None,
) -> Flips:
    """Return what changes the tiles of labels of a seed; where a target varies, towards the
    fractions that are `wanted`.
    """
    present = calibration["present"]
    places, labels = places_of(present), np.asarray(present, np.uint8)
    offsets = np.asarray(calibration["offsets"], np.float32)
    several = len(present) > 2
    room = MARGIN - _AROUND
    inner = (slice(room, -room),) * 3

    def flips(values: np.ndarray, field: np.ndarray, tile: tuple[int, ...]) -> np.ndarray:
        z, y, x = tile
        depths = field + offsets[:, None, None, None] if several else field - offsets[0]
        phases, cells = places[values], None
        if wanted is not None:
            off = excess_of(
                phases[inner], wanted(tile, _AROUND), None, window=NARROWEST, width=_HELD_CELL
            )
            core = ((_AROUND, _AROUND + field.shape[1]),) * 3
            cells = cells_of(off, core, _HELD_CELL)
        found: np.ndarray = bias.mend(
            phases,
            np.rint(depths * np.float32(_SLOPE * UNIT)).astype(np.int16),
            key(seed, f"gan/patterns/{z}/{y}/{x}"),
            level=0.0,
            unit=UNIT,
            cells=cells,
        )
        return labels[found]

    return flips


def join_arrays(
    generator: Mapping[str, np.ndarray], bias: PatternBias | None
) -> dict[str, np.ndarray]:
    """Return the arrays of a model's file: weights, and patterns."""
    more = {} if bias is None else bias.arrays()
    return {**generator, **{_PREFIX + name: array for name, array in more.items()}}


def split_arrays(
    arrays: Mapping[str, np.ndarray], plain: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], PatternBias | None]:
    """Return weights and patterns of the arrays and the plain JSON of a model's file.

    Raises
    ------
    ValueError, TypeError, LookupError
        Damaged patterns.
    """
    cut = len(_PREFIX)
    weights = {name: array for name, array in arrays.items() if not name.startswith(_PREFIX)}
    kept = {name[cut:]: array for name, array in arrays.items() if name.startswith(_PREFIX)}
    if not kept:
        return weights, None
    return weights, PatternBias.from_parts(kept, plain["patterns"])

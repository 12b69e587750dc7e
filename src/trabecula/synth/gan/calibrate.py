"""How fields become values: found on noise that the training never saw, and stored with the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from trabecula.core.image import Image
from trabecula.core.seeds import key
from trabecula.synth.gan.window import CELLS

_EVERY = (
    # voxels along every axis one is looked at: neighbours say nearly the same, and odd meets all
    # places of a cell
    3
)
_LEVELS = 257  # of the table of grey values
_ROUNDS = 200  # of moving the offsets of several phases


def calibration_of(
    network: Any, image: Image, seed: int, *, tiles: int | None = None
) -> dict[str, Any]:
    """The calibration of a generator (see `decode`), such that the exemplar's fractions or grey
    values come out.

    Parameters
    ----------
    network : generator
        As `loading.network_of` gives it: ready for use, in the arithmetic in which material is
        made.
    image : Image
        The exemplar.
    seed : int
        Of the training.
    tiles : int, optional
        Of noise, as large as in making. Default: as many as the network says. A fraction strays
        from tile to tile, so that few of them would shift every sample alike: over 32 of bone
        (64^3) by .0025, half of what a sample of 120^3 strays.
    """
    field = held_out(network, seed, tiles or network.tiles)
    if image.kind == "grey":
        levels = np.linspace(0, 1, _LEVELS)
        tables = {"from": np.quantile(field[0], levels), "to": np.quantile(image.values, levels)}
        # np.interp wants a rising table: of equal levels the first stays.
        kept = np.concatenate([[True], np.diff(tables["from"]) > 0])
        return {
            "kind": "grey",
            "dtype": str(image.values.dtype),
            **{k: t[kept].tolist() for k, t in tables.items()},
        }
    present = np.unique(image.values)
    fractions = np.bincount(image.values.ravel())[present] / image.values.size
    offsets = (
        [float(np.quantile(field[0], fractions[0]))]
        if len(present) == 2
        else balanced(field, fractions)
    )
    return {"kind": "labels", "present": present.tolist(), "offsets": offsets}


def held_out(network: Any, seed: int, tiles: int) -> np.ndarray:
    """Every third voxel along every axis of tiles of their own noise, (K, voxels) float32."""
    weight = next(network.parameters())
    draw = torch.Generator().manual_seed(int(key(seed, "gan/held out")) >> 1)
    side = CELLS + 2 * network.halo
    found = []
    with torch.inference_mode():
        for _ in range(tiles):
            z = torch.randn(1, network.latent, side, side, side, generator=draw).to(weight.dtype)
            field = network.cells(z.to(memory_format=torch.channels_last_3d))[
                0, :, ::_EVERY, ::_EVERY, ::_EVERY
            ]
            found.append(field.float().flatten(1).numpy())
    return np.concatenate(found, axis=1)


def balanced(field: np.ndarray, fractions: np.ndarray) -> list[float]:
    """Offsets of the channels (K, N) under which the largest one gives the fractions, to a few in a
    thousand.

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

"""From the arrays of a model's file to a network that is ready to make material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.networks import generator_of
from trabecula.synth.gan.window import CELLS, more_cells


def network_of(config: GanConfig, channels: int, weights: Mapping[str, np.ndarray]) -> Any:
    """The generator with given weights, for inference on the processor.

    Raises
    ------
    ValueError
        Weights of another network.
    """
    with torch.device("meta"):  # shapes without numbers, so that none are drawn
        network = generator_of(config, channels)
    wanted = network.state_dict()
    for name in sorted({*wanted, *weights}):
        if name not in wanted or name not in weights:
            raise ValueError(
                f"the network of its settings has {'no' if name not in wanted else 'a'} weight {name!r}"
            )
        if tuple(wanted[name].shape) != weights[name].shape:
            raise ValueError(
                f"{name!r} has shape {weights[name].shape}, its settings make {tuple(wanted[name].shape)}"
            )
    network.load_state_dict(
        {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}, assign=True
    )
    network.eval().requires_grad_(False)
    return network.to(dtype_of(arithmetic(config)), memory_format=torch.channels_last_3d)


def arithmetic(config: GanConfig) -> str:
    """In what a network is run to make material: "bf16" where the processor multiplies in it, else
    "float32".
    """
    known = [
        getattr(torch.cpu, f"_is_{name}_supported", lambda: False)()
        for name in ("avx512_bf16", "amx_tile")
    ]
    return "bf16" if any(known) and config.precision != "float32" else "float32"


def dtype_of(name: str) -> torch.dtype:
    """Its type in torch."""
    return torch.bfloat16 if name == "bf16" else torch.float32


def tile_bytes(config: GanConfig, channels: int, specks: int) -> int:
    """Memory that a network takes for a tile: the layer with the largest input and output, and
    their rearranged copies.
    """
    with torch.device("meta"):  # shapes without numbers
        network = generator_of(config, channels).to(dtype_of(arithmetic(config)))
        largest = 0

        def see(module: Any, given: Any, result: torch.Tensor) -> None:
            nonlocal largest
            largest = max(largest, given[0].nbytes + result.nbytes)

        for layer in network.modules():
            if not list(layer.children()):
                layer.register_forward_hook(see)
        inner = CELLS + more_cells(specks) + 2 * network.halo
        field = network.cells(
            torch.empty(1, network.latent, inner, inner, inner, dtype=dtype_of(arithmetic(config)))
        )
        return 4 * largest + 8 * field.nbytes

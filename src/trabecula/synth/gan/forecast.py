"""What memory a training takes, told before it starts."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from trabecula.core.image import Image
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.figures import SIDE
from trabecula.synth.gan.loading import arithmetic
from trabecula.synth.gan.networks import discriminator_of, generator_of
from trabecula.synth.gan.window import CELLS

_PLAYERS = 4  # copies of the weights: their gradients, two moments and the last good state
# results of a layer that are held for the way back: its own, rearranged, and after the activation
_KEPT = 5
# bytes a voxel of the crops: products along 32 directions at every fourth, sorted, with their
# places
_SLICED = 24


def training_bytes(config: GanConfig, image: Image) -> dict[str, int]:
    """Bytes by what they are for, the exemplar itself left out.

    Parameters
    ----------
    config : GanConfig
    image : Image
        The exemplar.
    """
    count = (
        len(set(image.values.ravel()[:: max(1, image.values.size >> 16)].tolist()))
        if image.kind == "labels"
        else 1
    )
    channels = count if count > 2 else 1
    half = 2 if arithmetic(config) == "bf16" else 4
    with torch.device("meta"):  # shapes without numbers
        maker, judge = generator_of(config, channels), discriminator_of(config, channels)
        cells = config.crop // config.cell + (
            2 * maker.halo if config.generator == "subpixel" else -3
        )
        z = torch.empty(config.batch, maker.latent, cells, cells, cells)
        crop = torch.empty(config.batch, channels, config.crop, config.crop, config.crop)
        held = sum(_results(maker, lambda: maker(z))) + 2 * sum(
            _results(judge, lambda: judge(crop))
        )
        cells = max(SIDE // config.cell, CELLS) + 2 * maker.halo
        look = max(
            _results(maker, lambda: maker.cells(torch.empty(1, maker.latent, cells, cells, cells)))
        )
        weights = sum(p.numel() for net in (maker, maker, judge) for p in net.parameters())
    fields = 4 * channels * image.values.size
    return {
        "weights": 4 * weights * (1 + _PLAYERS),
        "fields": 3 * fields,
        "crops": (32 + _SLICED) * crop.numel(),
        "results of layers": _KEPT * half * held,
        "looks": 4 * half * look + 40 * channels * SIDE**3,
    }


def _results(network: nn.Module, run: Callable[[], object]) -> list[int]:
    """Numbers that each layer of a network gives."""
    found = []

    def see(module: nn.Module, given: object, result: Tensor) -> None:
        found.append(result.numel())

    hooks = [m.register_forward_hook(see) for m in network.modules() if not list(m.children())]
    run()
    for hook in hooks:
        hook.remove()
    return found

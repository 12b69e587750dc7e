"""Forecasts of a training: the bytes that it takes by purpose, on the processor and on a GPU, and
its arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import prod

import torch
from torch import Tensor, nn

from trabecula.core.errors import MemoryBudgetError
from trabecula.core.image import Image
from trabecula.engine.memory import format_bytes
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.crops import effective_config
from trabecula.synth.gan.decode import CELLS
from trabecula.synth.gan.evaluation import SIDE
from trabecula.synth.gan.losses import EDGES, TABLE
from trabecula.synth.gan.networks import (
    TwoScales,
    new_discriminator,
    new_generator,
    training_arithmetic,
)
from trabecula.synth.gan.slices import STEP, judged_channels

_COPIES = 4  # of the weights: their gradients, two moments and the last good state
# Results of a layer that backpropagation holds: its own, rearranged, and after the activation.
_RESULTS = 5
# The paper's layers are listed one by one, activations too: on a GPU each is held once, and once
# more where gradients and products in bf16 need it. An H200 held 11.0 GiB of a forecast of 18 at
# the paper's width.
_RESULTS_LISTED = 2
# Times as much in float32, where a processor lacks bf16: convolutions rearrange more, and the same
# training had peaks between 1.0 and 2.1 GB.
_REARRANGED = 2.6
# Bytes a voxel of the crops in the sliced loss: products along 32 directions at every fourth,
# sorted, with their places.
_SLICED = 24
_WORKSPACE = 2 << 30  # bytes of a GPU for the libraries' own arrays (not measured)
_LIBRARIES = 3 << 30  # bytes of the process for the GPU's libraries (not measured)

BACKWARD = 2
"""Arithmetic of a backward pass over that of a forward pass."""

_REGULARISED = 3  # of the gradient penalty, over a forward pass: twice backward, every other time


def training_bytes(
    config: GanConfig, images: Sequence[Image], device: torch.device
) -> dict[str, int]:
    """Forecast the bytes that training takes by purpose on its device, the exemplar itself left
    out.

    Parameters
    ----------
    config : GanConfig
    images : sequence of Image
        The exemplar, or the pictures.
    device : torch.device
        The processor: bytes of the process. A GPU: bytes of its memory.
    """
    config = effective_config(config, images)
    flat, on_gpu = images[0].ndim == 2, device.type == "cuda"
    channels = channel_count(images)
    half = 2 if training_arithmetic(config, device) == "bf16" else 4
    with torch.device("meta"):  # shapes without numbers
        generator, z, discriminator, crop = _networks(config, channels, flat)
        held = sum(_layer_results(generator, lambda: generator(z)))
        held += 2 * sum(_layer_results(discriminator, lambda: discriminator(crop)))
        cells = max(SIDE // config.cell, CELLS) + 2 * generator.halo
        tile = torch.empty(1, generator.latent + generator.fractions, cells, cells, cells)
        evaluation = max(_layer_results(generator, lambda: generator.cells(tile)))
        networks = (generator, generator, discriminator)
        weights = sum(p.numel() for network in networks for p in network.parameters())
    fields = 4 * channels * sum(image.values.size for image in images)
    listed = on_gpu and config.generator != "subpixel"
    results = (_RESULTS_LISTED if listed else _RESULTS) * half * held
    rearranged = _REARRANGED if half == 4 and not on_gpu else 1
    found = {
        "weights": 4 * weights * (1 + _COPIES),
        "fields": 3 * fields,
        "crops": (32 + _SLICED) * crop.numel(),
        "results of layers": round(results * rearranged),
        "looks": 4 * half * evaluation + 40 * channels * SIDE**3,
    }
    return {**found, "libraries": _WORKSPACE} if on_gpu else found


def host_bytes(config: GanConfig, images: Sequence[Image], device: torch.device) -> dict[str, int]:
    """Forecast the bytes of the process: where a GPU trains, its libraries, the fields, and the
    weights on their way to a checkpoint.
    """
    there = training_bytes(config, images, device)
    if device.type != "cuda":
        return there
    channels = channel_count(images)
    return {
        "libraries": _LIBRARIES,
        "fields": there["fields"],
        "weights": there["weights"],
        "looks": 40 * channels * SIDE**3,
    }


def check_device_memory(config: GanConfig, images: Sequence[Image], device: torch.device) -> None:
    """Raise where the forecast of a training exceeds the free memory of its GPU; say the largest
    batch that fits.

    Raises
    ------
    MemoryBudgetError
    """
    if device.type != "cuda":
        return
    free, _ = torch.cuda.mem_get_info(device)
    if sum(training_bytes(config, images, device).values()) <= free:
        return

    def fits(batch: int) -> bool:
        smaller = replace(config, batch=batch)
        return sum(training_bytes(smaller, images, device).values()) <= free

    least, most = 0, config.batch  # the largest that fits is in least .. most - 1
    while most - least > 1:
        middle = (least + most) // 2
        least, most = (middle, most) if fits(middle) else (least, middle)
    needed = sum(training_bytes(config, images, device).values())
    advice = f"set batch={least}" if least else "set a smaller width, or device='cpu'"
    raise MemoryBudgetError(
        f"training at batch={config.batch} and width={config.width} needs about "
        f"{format_bytes(needed)} of the GPU's memory, {format_bytes(free)} are free: {advice}"
    )


def iteration_flops(config: GanConfig, channels: int = 1) -> float:
    """Forecast the arithmetic of one iteration on a volume: multiplications and additions of the
    convolutions and of the structural loss's distances.

    A step of the discriminator goes forward and backward over real and generated crops, one of the
    generator through both networks; the paper's losses see features of further crops.
    """
    with torch.device("meta"):
        generator, z, discriminator, crop = _networks(config, channels, flat=False)
        making = sum(_layer_flops(generator, lambda: generator(z)))
        judging = _layer_flops(discriminator, lambda: discriminator(crop))
    judged = sum(judging)
    total: float = (1 + BACKWARD) * making + 2 * (1 + BACKWARD) * judged + 2 * judged
    if config.penalty:
        total += _REGULARISED * judged
    features = sum(judging[:3])
    if config.gram:
        total += features
    if config.structural:
        candidates = min(TABLE, 4 * config.batch)
        total += features * candidates / config.batch + _distance_flops(config, candidates)
    return total


def _distance_flops(config: GanConfig, candidates: int) -> int:
    """Return the arithmetic of all distances of equation 3."""
    total = 0
    for layer, edge in enumerate(EDGES):
        regions = (config.crop // 2 ** (layer + 1) // edge) ** 3
        numbers = config.width * 2**layer * edge**3
        total += 2 * config.batch * regions * candidates * regions * numbers
    return total


def channel_count(images: Sequence[Image]) -> int:
    """Count the channels of the fields of images; of large ones a part of the voxels tells."""
    if images[0].kind != "labels":
        return 1
    found: set[int] = set()
    for image in images:
        found |= set(image.values.ravel()[:: max(1, image.values.size >> 16)].tolist())
    return len(found) if len(found) > 2 else 1


def _networks(
    config: GanConfig, channels: int, flat: bool
) -> tuple[nn.Module, Tensor, nn.Module, Tensor]:
    """Build a generator and its latent, a discriminator and what it sees; of pictures all slices
    of the three axes.
    """
    generator = new_generator(config, channels)
    cells = config.crop // config.cell + (
        2 * generator.halo if config.generator == "subpixel" else -3
    )
    z = torch.empty(config.batch, generator.latent + generator.fractions, cells, cells, cells)
    if flat:
        slices = 3 * config.batch * (config.crop // STEP)
        seen = judged_channels(config, channels)
        crop = torch.empty(slices, seen, config.crop, config.crop)
        return generator, z, TwoScales(config.width, seen, axes=2), crop
    crop = torch.empty(config.batch, channels, config.crop, config.crop, config.crop)
    return generator, z, new_discriminator(config, channels), crop


def _layer_flops(network: nn.Module, run: Callable[[], object]) -> list[int]:
    """Count the multiplications and additions of each convolution of a network."""
    found: list[int] = []

    def see(module: nn.Module, given: tuple[Tensor, ...], result: Tensor) -> None:
        if isinstance(module, (nn.Conv2d, nn.Conv3d)):
            found.append(2 * result.numel() * prod(module.weight.shape[1:]))
        elif isinstance(module, nn.ConvTranspose3d):
            found.append(2 * given[0].numel() * prod(module.weight.shape[1:]))

    _run_with_hooks(network, see, run)
    return found


def _layer_results(network: nn.Module, run: Callable[[], object]) -> list[int]:
    """Count the numbers that each layer of a network returns."""
    found: list[int] = []

    def see(module: nn.Module, given: object, result: Tensor) -> None:
        found.append(result.numel())

    _run_with_hooks(network, see, run)
    return found


def _run_with_hooks(
    network: nn.Module, see: Callable[..., None], run: Callable[[], object]
) -> None:
    hooks = [m.register_forward_hook(see) for m in network.modules() if not list(m.children())]
    run()
    for hook in hooks:
        hook.remove()

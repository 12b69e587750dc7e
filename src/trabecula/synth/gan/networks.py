"""The networks, new or with stored weights. Imports torch: reached through `core.optional` alone.

A generator has `cell` (voxels along an edge of a cell of the latent), `halo` (cells of the latent
that it needs beyond each side), `tiles` (of noise that it is calibrated on), `latent` (channels of
noise) and `fractions` (channels of local fractions, which follow the noise). Its `cells` makes the
voxels of the inner cells, whatever lies beyond the halo. A discriminator gives verdicts, a list of
tensors, one for each scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, avg_pool3d, leaky_relu

from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.folded import Doubling, Halving
from trabecula.synth.gan.local_fractions import CELL
from trabecula.synth.gan.rearranged import depth_to_space, space_to_depth

_SLOPE = 0.2
_MIDDLE = 40  # voxels


def new_generator(config: GanConfig, channels: int) -> Subpixel | Deconvolution:
    """Build the generator of a config with new weights.

    Parameters
    ----------
    config : GanConfig
    channels : int
        Of its output.
    """
    if config.generator == "subpixel":
        return Subpixel(
            config.latent,
            config.width,
            channels,
            fractions=channels if config.fractions else 0,
            smoothing=config.smoothing,
            polish=config.polish,
        )
    return Deconvolution(
        config.latent, config.width, channels, last=config.generator == "deconvolution+conv"
    )


def new_discriminator(config: GanConfig, channels: int) -> TwoScales | Score:
    """Build the discriminator of a config with new weights."""
    if config.discriminator == "scales":
        return TwoScales(config.width, channels)
    return Score(config.width, channels, config.crop, whole=config.discriminator == "score")


HALO = 3
"""Cells of the latent that a cell of the sub-pixel generator depends on, on every side."""


class Subpixel(nn.Module):
    """Convolutions without padding that double by sub-pixels: a voxel never knows where its tile
    ends.

    Parameters
    ----------
    latent, width, channels, fractions : int
        Channels of the noise, of the finest layer, of the output and of the local fractions.
    smoothing, polish : int
        How often the output is blurred, and how often more when material is made.
    """

    cell = CELL
    halo = HALO
    tiles = 256

    def __init__(
        self,
        latent: int,
        width: int,
        channels: int,
        *,
        fractions: int,
        smoothing: int,
        polish: int,
    ) -> None:
        super().__init__()
        self.latent, self.fractions = latent, fractions
        self.smoothing, self.polish = smoothing, polish
        self.layers = nn.ModuleList(
            [
                nn.Conv3d(latent + fractions, 4 * width, 3),
                nn.Conv3d(4 * width, 8 * 2 * width, 2),
                nn.Conv3d(2 * width, 2 * width, 3),
                nn.Conv3d(2 * width, 8 * width, 2),
                nn.Conv3d(width, width, 3),
                nn.Conv3d(width, 8 * channels, 3),
            ]
        )
        for layer in self.layers:
            nn.init.kaiming_normal_(layer.weight, a=_SLOPE)
            nn.init.zeros_(layer.bias)

    def forward(self, z: Tensor) -> Tensor:
        """Map (B, C, a + 6, b + 6, c + 6) to (B, K, 8 a, 8 b, 8 c) for the discriminator."""
        return self._upsample(z, self.smoothing)

    def cells(self, z: Tensor) -> Tensor:
        """Map the same latent to the field that becomes material."""
        return self._upsample(z, self.smoothing + self.polish)

    def _upsample(self, z: Tensor, blurs: int) -> Tensor:
        x = z
        for place, layer in enumerate(self.layers):
            x = layer(x)
            x = depth_to_space(x) if place % 2 else x
            x = leaky_relu(x, _SLOPE) if place < 5 else x
        x = x.float()
        for _ in range(blurs):
            x = blur(x)
        return torch.tanh(crop_centre(x, *(8 * (side - 6) for side in z.shape[2:])))


def blur(x: Tensor) -> Tensor:
    """Average with weights 1 2 1 along every axis; each side loses a voxel.

    No chequerboard, the known artefact of sub-pixel convolution, passes this filter.
    """
    for axis in (2, 3, 4):
        n = x.shape[axis] - 2
        x = 0.25 * (x.narrow(axis, 0, n) + x.narrow(axis, 2, n)) + 0.5 * x.narrow(axis, 1, n)
    return x


def crop_centre(x: Tensor, *sides: int) -> Tensor:
    """Crop a volume to `sides` around its middle."""
    for axis, side in enumerate(sides, start=2):
        x = x.narrow(axis, (x.shape[axis] - side) // 2, side)
    return x


class Deconvolution(nn.Module):
    """The paper's generator (its section 3.4): transposed convolutions of 4^3, the first from 1 to
    4, the others doubling.

    Parameters
    ----------
    latent, width, channels : int
        Channels of the latent, of the finest layer (64 in the paper) and of the output.
    last : bool
        Whether an output convolution follows the fifth layer (reading A), or that is the output
        (reading B).
    """

    cell = 16
    halo = 3
    tiles = 8
    fractions = 0

    def __init__(self, latent: int, width: int, channels: int, *, last: bool) -> None:
        super().__init__()
        self.latent = latent
        maps = [latent, 8 * width, 8 * width, 4 * width, 2 * width, width if last else channels]
        layers: list[nn.Module] = []
        for place, (before, after) in enumerate(pairwise(maps)):
            layers.append(
                Doubling(before, after) if place else nn.ConvTranspose3d(before, after, 4)
            )
            if place < 4 or last:
                layers += [nn.BatchNorm3d(after), nn.ReLU()]
        if last:
            layers.append(nn.Conv3d(width, channels, 3, padding=1))
        self.layers = nn.Sequential(*layers, nn.Tanh())
        self.layers.apply(_init_dcgan)

    def forward(self, z: Tensor) -> Tensor:
        """Map (B, C, a, b, c) to (B, K, 16 a + 48, 16 b + 48, 16 c + 48)."""
        return self.layers(torch.erf(z * 0.5**0.5))  # uniform in -1 .. 1, as the paper's

    def cells(self, z: Tensor) -> Tensor:
        """Return the voxels out of reach of padding: 64 less on one side, 80 on the other.

        Each layer makes only what the next one needs of it: 128^3 voxels instead of 272^3.
        """
        x = torch.erf(z * 0.5**0.5)
        spans = [(64, 64 + 16 * (side - 6)) for side in z.shape[2:]]
        steps = []
        for layer in reversed(list(self.layers)):
            needed = [_inputs_of(layer, *span) for span in spans]
            steps.append((layer, needed, spans))
            spans = needed
        x = _narrow(x, spans, [0, 0, 0])
        for layer, needed, spans in reversed(steps):
            x = layer(x)
            if isinstance(layer, (nn.Conv3d, nn.ConvTranspose3d)):
                # Without the inputs before `needed`, the first output is that of its first.
                step = layer.stride[0] if isinstance(layer, nn.ConvTranspose3d) else 1
                x = _narrow(x, spans, [first * step for first, _ in needed])
        return x


def _inputs_of(layer: nn.Module, first: int, last: int) -> tuple[int, int]:
    """Return the inputs, first and the one after the last, that outputs first .. last - 1 of a
    layer along an axis depend on.

    A transposed convolution gives o = stride i - padding + k, k = 0 .. kernel - 1, of input i.
    """
    if not isinstance(layer, (nn.Conv3d, nn.ConvTranspose3d)):
        return first, last
    kernel, step, padding = layer.kernel_size[0], layer.stride[0], int(layer.padding[0])
    if isinstance(layer, nn.ConvTranspose3d):
        return -(-(first + padding - kernel + 1) // step), (last - 1 + padding) // step + 1
    return first - padding, last - 1 - padding + kernel


def _narrow(x: Tensor, spans: list[tuple[int, int]], offsets: list[int]) -> Tensor:
    """Return the part of (B, C, Z, Y, X) within spans; its first voxels are at `offsets`."""
    for axis, ((first, last), offset) in enumerate(zip(spans, offsets, strict=True), start=2):
        x = x.narrow(axis, first - offset, last - first)
    return x


class TwoScales(nn.Module):
    """Verdicts for every place on two scales, 20 voxels wide and 40 on a field of half the
    resolution, without padding.

    Parameters
    ----------
    width, channels : int
    axes : int
        3 for crops of volumes, 2 for slices.
    """

    def __init__(self, width: int, channels: int, *, axes: int = 3) -> None:
        super().__init__()
        convolution = nn.Conv3d if axes == 3 else nn.Conv2d
        self.halve = avg_pool3d if axes == 3 else avg_pool2d
        self.near, self.far = (
            nn.ModuleList(
                [
                    convolution(2**axes * channels, 2 * width, 3),
                    convolution(2 * width, 4 * width, 4, 2),
                    convolution(4 * width, 8 * width, 3),
                    convolution(8 * width, 1, 1),
                ]
            )
            for _ in range(2)
        )
        for layer in (*self.near[:3], *self.far[:3]):
            nn.init.kaiming_normal_(layer.weight, a=_SLOPE)
            nn.init.zeros_(layer.bias)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the verdicts (B, 1, ...) on (B, K, Z, Y, X), multiples of 4 and at least 40; or
        on slices (B, K, Y, X).

        The near ones come from the middle: there are many of them, and they are expensive.
        """
        return [
            _verdicts(self.near, crop_centre(x, *(min(side, _MIDDLE) for side in x.shape[2:]))),
            _verdicts(self.far, self.halve(x, 2)),
        ]


def _verdicts(layers: nn.ModuleList, x: Tensor) -> Tensor:
    x = space_to_depth(x)
    for layer in layers[:-1]:
        x = leaky_relu(layer(x), _SLOPE)
    return layers[-1](x)


class Score(nn.Module):
    """The paper's discriminator: five convolutions of 4^3; `features` are those after its first
    three.

    Parameters
    ----------
    width, channels, crop : int
    whole : bool
        One verdict for the whole crop, or one for every place of the last layer (PatchGAN).
    """

    def __init__(self, width: int, channels: int, crop: int, *, whole: bool) -> None:
        super().__init__()
        maps = [channels, width, 2 * width, 4 * width, 8 * width]
        self.blocks = nn.ModuleList(
            nn.Sequential(Halving(before, after), nn.BatchNorm3d(after), nn.LeakyReLU(_SLOPE))
            for before, after in pairwise(maps)
        )
        self.fifth = Halving(8 * width, 8 * width)
        self.head = nn.Conv3d(8 * width, 1, crop // 32 if whole else 1)
        self.apply(_init_dcgan)

    def features(self, x: Tensor) -> list[Tensor]:
        """Return the features after each of the first three layers."""
        found = []
        for block in self.blocks[:3]:
            x = block(x)
            found.append(x)
        return found

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the verdicts (B, 1, ...) on (B, K, Z, Y, X), before the sigmoid."""
        return self.verdicts(self.features(x))

    def verdicts(self, features: list[Tensor]) -> list[Tensor]:
        """Return the verdicts on what `features` returned."""
        return [self.head(leaky_relu(self.fifth(self.blocks[3](features[-1])), _SLOPE))]


def _init_dcgan(layer: nn.Module) -> None:
    """Draw normal weights of standard deviation 0.02 (Radford, Metz, Chintala 2016)."""
    if isinstance(layer, (nn.Conv3d, nn.ConvTranspose3d)):
        nn.init.normal_(layer.weight, 0.0, 0.02)
        nn.init.zeros_(layer.bias)
    elif isinstance(layer, nn.BatchNorm3d):
        nn.init.normal_(layer.weight, 1.0, 0.02)
        nn.init.zeros_(layer.bias)


def load_generator(
    config: GanConfig,
    channels: int,
    weights: Mapping[str, np.ndarray],
    device: torch.device | None = None,
) -> Any:
    """Build a generator with stored weights, for inference.

    Parameters
    ----------
    config : GanConfig
    channels : int
        Of its output.
    weights : mapping of str to array
    device : torch.device, optional
        Default: the processor.

    Raises
    ------
    ValueError
        Weights of another network.
    """
    with torch.device("meta"):  # shapes without numbers, so that none are drawn
        network = new_generator(config, channels)
    wanted = network.state_dict()
    for name in sorted({*wanted, *weights}):
        if name not in wanted or name not in weights:
            raise ValueError(
                f"the network of its settings has {'no' if name not in wanted else 'a'} weight "
                f"{name!r}"
            )
        if tuple(wanted[name].shape) != weights[name].shape:
            raise ValueError(
                f"{name!r} has shape {weights[name].shape}, its settings make "
                f"{tuple(wanted[name].shape)}"
            )
    network.load_state_dict(
        {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}, assign=True
    )
    network.eval().requires_grad_(False)
    dtype = dtype_of(arithmetic(config, device))
    return network.to(device, dtype, memory_format=torch.channels_last_3d)


def arithmetic(config: GanConfig, device: torch.device | None = None) -> str:
    """Return the arithmetic of inference: "bf16" where the device multiplies in it, else
    "float32".

    Parameters
    ----------
    config : GanConfig
    device : torch.device, optional
        Default: the processor.
    """
    return "bf16" if _has_bf16(device) and config.precision != "float32" else "float32"


def training_arithmetic(config: GanConfig, device: torch.device) -> str:
    """Return the arithmetic of a training on a device: the config's where it names one."""
    if config.precision != "auto":
        return config.precision
    return "bf16" if _has_bf16(device) else "float32"


def _has_bf16(device: torch.device | None) -> bool:
    """Tell whether a device multiplies in bf16: a GPU from compute capability 8 on."""
    if device is not None and device.type == "cuda":
        return torch.cuda.get_device_capability(device)[0] >= 8
    known = ("avx512_bf16", "amx_tile")
    return any(getattr(torch.cpu, f"_is_{name}_supported", lambda: False)() for name in known)


def dtype_of(name: str) -> torch.dtype:
    """Return the torch type of an arithmetic."""
    return torch.bfloat16 if name == "bf16" else torch.float32


def inference_bytes(config: GanConfig, channels: int, cells: int) -> int:
    """Forecast the memory of inference on a tile of `cells`^3 cells of the latent.

    The peak is the layer with the largest input and output, and their rearranged copies.
    """
    with torch.device("meta"):  # shapes without numbers
        network = new_generator(config, channels).to(dtype_of(arithmetic(config)))
        largest = 0

        def see(module: Any, given: Any, result: Tensor) -> None:
            nonlocal largest
            largest = max(largest, given[0].nbytes + result.nbytes)

        for layer in network.modules():
            if not list(layer.children()):
                layer.register_forward_hook(see)
        inner = cells + 2 * network.halo
        inputs = network.latent + network.fractions
        field = network.cells(
            torch.empty(1, inputs, inner, inner, inner, dtype=dtype_of(arithmetic(config)))
        )
        return 4 * largest + 8 * field.nbytes

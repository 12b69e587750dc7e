"""The paper's convolutions, 4^3 with stride 2 and padding 1, as a GPU makes them fast.

On a processor they are PyTorch's own. On a GPU the library's own are slow, some at a twentieth of
the others (measured on an H200 with PyTorch 2.11, bf16). Each has an equal on half the grid, where
the voxels of a cell of 2^3 are channels and the kernel is of 2^3 with stride 1, which is fast; and
a transposed one is fast as it is, forward, but for few channels. So a convolution is made folded,
and its gradient by the field as a transposed one; with a transposed one it is the reverse. The
gradient by the weights is folded in both.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import conv3d, conv_transpose3d, pad

from trabecula.synth.gan.rearranged import depth_to_space, space_to_depth

_THIN = 8  # channels: a transposed convolution to fewer is slow as it is


class Halving(nn.Conv3d):
    """A convolution of 4^3 with stride 2 and padding 1: (B, K, 2 Z, 2 Y, 2 X) to
    (B, C, Z, Y, X).
    """

    def __init__(self, before: int, after: int) -> None:
        super().__init__(before, after, 4, 2, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return the convolution of a field."""
        if not x.is_cuda:
            return super().forward(x)
        return halve(*_in_one_arithmetic(x, self.weight, self.bias))


class Doubling(nn.ConvTranspose3d):
    """A transposed convolution of 4^3 with stride 2 and padding 1: (B, C, Z, Y, X) to
    (B, K, 2 Z, 2 Y, 2 X).
    """

    def __init__(self, before: int, after: int) -> None:
        super().__init__(before, after, 4, 2, 1)

    def forward(self, x: Tensor, output_size: list[int] | None = None) -> Tensor:
        """Return the transposed convolution of a field."""
        if not x.is_cuda:
            return super().forward(x, output_size)
        return double(*_in_one_arithmetic(x, self.weight, self.bias))


def halve(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Convolve (B, K, 2 Z, 2 Y, 2 X) with weights (C, K, 4, 4, 4), stride 2 and padding 1."""
    found: Tensor = _Halved.apply(x, weight, bias)
    return found


def double(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Convolve (B, C, Z, Y, X) transposed with weights (C, K, 4, 4, 4), stride 2 and padding 1."""
    if weight.shape[1] < _THIN:
        return _double_folded(x, weight, bias)
    found: Tensor = _Doubled.apply(x, weight, bias)
    return found


def _in_one_arithmetic(x: Tensor, *parts: Tensor | None) -> tuple[Any, ...]:
    """Return all as what autocast would make of them, or as they are."""
    if not torch.is_autocast_enabled("cuda"):
        return (x, *parts)
    dtype = torch.get_autocast_dtype("cuda")
    return tuple(part if part is None else part.to(dtype) for part in (x, *parts))


class _Halved(torch.autograd.Function):
    """A convolution that is folded forward, and has a transposed one as its gradient."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(x, weight)
        return conv3d(_fold(x), _fold_weights(weight), bias)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (slope,), (x, weight) = gradients, ctx.saved_tensors
        needed = ctx.needs_input_grad
        return (
            double(slope, weight) if needed[0] else None,
            _weight_gradient(x, slope, weight) if needed[1] else None,
            slope.sum((0, 2, 3, 4)) if needed[2] else None,
        )


class _Doubled(torch.autograd.Function):
    """A transposed convolution as it is, with a folded convolution as its gradient."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        ctx.save_for_backward(x, weight)
        return conv_transpose3d(x, weight, bias, stride=2, padding=1)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (slope,), (x, weight) = gradients, ctx.saved_tensors
        needed = ctx.needs_input_grad
        return (
            halve(slope, weight) if needed[0] else None,
            _weight_gradient(slope, x, weight) if needed[1] else None,
            slope.sum((0, 2, 3, 4)) if needed[2] else None,
        )


def _double_folded(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Return a transposed convolution through one of 2^3.

    Input i reaches the outputs 2 i - 1 + k, k = 0 .. 3. So the cell of the outputs 2 p - 1 and
    2 p has the inputs p - 1 by k = 2 and 3, and p by k = 0 and 1.
    """
    channels, out = weight.shape[:2]
    taps = weight.reshape(channels, out, 2, 2, 2, 2, 2, 2).flip(2, 4, 6)
    small = taps.permute(3, 5, 7, 1, 0, 2, 4, 6).reshape(8 * out, channels, 2, 2, 2)
    biases = None if bias is None else bias.repeat(8)
    cells = conv3d(pad(x, (1,) * 6), _last(small), biases)
    return depth_to_space(cells)[:, :, 1:-1, 1:-1, 1:-1]


def _fold(x: Tensor) -> Tensor:
    """Return the padded field with its cells as channels."""
    return space_to_depth(pad(x, (1,) * 6))


def _fold_weights(weight: Tensor) -> Tensor:
    """Rearrange (C, K, 4, 4, 4) as (C, 8 K, 2, 2, 2): channels as `space_to_depth` has them."""
    out, channels = weight.shape[:2]
    cells = weight.reshape(out, channels, 2, 2, 2, 2, 2, 2)
    return _last(cells.permute(0, 3, 5, 7, 1, 2, 4, 6).reshape(out, 8 * channels, 2, 2, 2))


def _unfold_weights(small: Tensor, like: Tensor) -> Tensor:
    """Invert `_fold_weights`."""
    cells = small.reshape(len(small), 2, 2, 2, -1, 2, 2, 2)
    return cells.permute(0, 4, 5, 1, 6, 2, 7, 3).reshape(like.shape)


def _weight_gradient(x: Tensor, slope: Tensor, weight: Tensor) -> Tensor:
    """Return the gradient by the weights of the convolution of x where that by its result is
    given.
    """
    _, small, _ = torch.ops.aten.convolution_backward(
        slope,
        _fold(x),
        _fold_weights(weight),
        None,
        [1, 1, 1],
        [0, 0, 0],
        [1, 1, 1],
        False,
        [0, 0, 0],
        1,
        [False, True, False],
    )
    return _unfold_weights(small, weight)


def _last(weight: Tensor) -> Tensor:
    return weight.contiguous(memory_format=torch.channels_last_3d)

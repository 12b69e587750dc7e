"""Cells of 2^3 voxels, or 2^2 pixels, as channels, and back."""

from __future__ import annotations

from torch import Tensor


def depth_to_space(x: Tensor) -> Tensor:
    """Rearrange (B, 8 K, Z, Y, X) as (B, K, 2 Z, 2 Y, 2 X): eight channels become a 2^3 cell."""
    b, k, z, y, w = x.shape
    x = x.permute(0, 2, 3, 4, 1).reshape(b, z, y, w, 2, 2, 2, k // 8)
    x = x.permute(0, 1, 4, 2, 5, 3, 6, 7).reshape(b, 2 * z, 2 * y, 2 * w, k // 8)
    return x.permute(0, 4, 1, 2, 3)  # channels last in memory, as the convolutions like it


def space_to_depth(x: Tensor) -> Tensor:
    """Invert `depth_to_space`; of slices (B, K, Y, X) four pixels become channels."""
    b, k, *sides = x.shape
    axes = len(sides)
    x = x.movedim(1, -1).reshape(b, *(n for side in sides for n in (side // 2, 2)), k)
    places, inner = range(1, 2 * axes, 2), range(2, 2 * axes + 1, 2)
    x = x.permute(0, *places, *inner, 2 * axes + 1)
    return x.reshape(b, *(side // 2 for side in sides), 2**axes * k).movedim(-1, 1)

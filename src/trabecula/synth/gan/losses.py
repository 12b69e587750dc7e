"""What the training minimises."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool3d, conv3d, softplus


def relativistic(better: Sequence[Tensor], worse: Sequence[Tensor]) -> Tensor:
    """Paired: a verdict on one kind should lie above that on the other (Jolicoeur-Martineau 2018,
    Huang et al. 2024).
    """
    return sum(
        (softplus(w.float() - b.float()).mean() for b, w in zip(better, worse, strict=True)),
        torch.zeros(()),
    )


def standard(verdicts: Sequence[Tensor], *, real: bool) -> Tensor:
    """The non-saturating loss on verdicts before the sigmoid (equation 1 of the paper)."""
    return sum(
        (softplus(-v.float() if real else v.float()).mean() for v in verdicts), torch.zeros(())
    )


def gradient_penalty(judge: nn.Module, real: Tensor) -> Tensor:
    """R1 (Mescheder et al. 2018): squared gradient of a verdict by the crop it is on, a mean over
    verdicts.
    """
    real = real.detach().requires_grad_(True)
    total = sum(
        (v.float().sum() / (v.numel() / len(v)) ** 0.5 for v in judge(real)), torch.zeros(())
    )
    (slope,) = torch.autograd.grad(total, real, create_graph=True)
    return slope.float().square().sum() / len(real)


def sliced(
    made: Tensor,
    real: Tensor,
    draw: torch.Generator,
    *,
    width: int = 7,
    count: int = 32,
    scales: int = 3,
) -> Tensor:
    """Distance of the distributions of neighbourhoods along random directions, on several scales
    (Rabin et al. 2011).

    Parameters
    ----------
    made, real : (B, K, Z, Y, X) tensor
    draw : torch.Generator
        Of the directions and of where the grid of neighbourhoods starts.
    width : int
        Of a neighbourhood, voxels of its scale.
    count : int
        Directions a scale.
    scales : int
        Each has half the resolution of the one before, and twice as dense a grid.
    """
    total = torch.zeros((), device=made.device)
    for scale in range(scales):
        step = max(1, 4 >> scale)
        directions = torch.randn(
            count, made.shape[1], width, width, width, generator=draw, device=draw.device
        )
        directions = (directions / directions.flatten(1).norm(dim=1)[:, None, None, None, None]).to(
            made.device
        )
        starts = torch.randint(0, step, (3,), generator=draw, device=draw.device).tolist()
        a, b = (_along(volume, directions, starts, step) for volume in (made, real))
        total = total + (a - b).square().mean()
        made, real = avg_pool3d(made, 2), avg_pool3d(real, 2)
    return total


def _along(volume: Tensor, directions: Tensor, starts: Sequence[int], step: int) -> Tensor:
    """(directions, places) sorted products of neighbourhoods with directions."""
    z, y, x = starts
    products = conv3d(volume[:, :, z:, y:, x:], directions, stride=step)
    return torch.sort(products.movedim(1, 0).flatten(1), dim=1).values

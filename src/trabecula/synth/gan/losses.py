"""The losses: adversarial, sliced transport, and the paper's on the discriminator's features.

The gram (section 3.3) and the structural loss (section 3.2, equations 3 and 4) are means, so that
their weights do not depend on the size of a crop, or the sums that the paper prints.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, avg_pool3d, conv2d, conv3d, softplus

from trabecula.synth.gan.local_fractions import CELL, REACH, WEIGHTS, LocalFractions
from trabecula.synth.gan.networks import Score, crop_centre

SLICES = 4
"""Equally spaced slices along every axis that the gram loss looks at."""

TABLE, CHUNK = 16, 4
"""Crops that hold the candidates of the structural loss, and how many of them at once."""

_STEEP = 8.0  # of the step between two phases: a voxel beside an interface belongs to one

EDGES = (8, 4, 2)
"""Edge and stride of the cubical regions of the structural loss, voxels of each of the first three
layers.
"""


def relativistic(better: Sequence[Tensor], worse: Sequence[Tensor]) -> Tensor:
    """Return the paired relativistic loss: verdicts on one kind should exceed those on the other
    (Jolicoeur-Martineau 2018, Huang et al. 2024).
    """
    return sum(
        (softplus(w.float() - b.float()).mean() for b, w in zip(better, worse, strict=True)),
        torch.zeros(()),
    )


def standard(verdicts: Sequence[Tensor], *, real: bool) -> Tensor:
    """Return the non-saturating loss on verdicts before the sigmoid (equation 1 of the paper)."""
    return sum(
        (softplus(-v.float() if real else v.float()).mean() for v in verdicts), torch.zeros(())
    )


def local_fractions(fake: Tensor, given: Tensor, local: LocalFractions) -> Tensor:
    """Return the squared distance of the fractions around the cells of generated crops to those
    that were given, in variances of the exemplar's.

    Parameters
    ----------
    fake : (B, K, Z, Y, X) tensor
        Fields of labels.
    given : (B, K, z, y, x) tensor
        Of the cells of the crops and the same number more on every side (`TrainingFields.given`).
    local : LocalFractions
    """
    around = standardised(fractions_around(soft_labels(fake)), local)
    return (around - crop_centre(given, *around.shape[2:])).square().mean()


def standardised(around: Tensor, local: LocalFractions) -> Tensor:
    """Return fractions (B, K, z, y, x) in deviations from the exemplar's mean."""
    mean, deviation = (
        torch.tensor(part, dtype=torch.float32, device=around.device).reshape(1, -1, 1, 1, 1)
        for part in (local.mean, local.deviation)
    )
    return (around - mean) / deviation


def soft_labels(field: Tensor) -> Tensor:
    """Return the share of each phase in every voxel of a field (B, K, Z, Y, X): of one channel
    that of the higher label.
    """
    steep = _STEEP * field
    return torch.sigmoid(steep) if field.shape[1] == 1 else torch.softmax(steep, 1)


def fractions_around(shares: Tensor) -> Tensor:
    """Return the fractions around every cell (as in `local_fractions`) of the shares of
    voxels, (B, K, Z, Y, X).
    """
    cells = avg_pool3d(shares, CELL)
    for axis in range(2, 5):
        inner = cells.shape[axis] - 2 * REACH
        cells = sum(
            (weight * cells.narrow(axis, i, inner) for i, weight in enumerate(WEIGHTS)),
            torch.zeros((), device=cells.device),
        )
    return cells


def gradient_penalty(discriminator: nn.Module, real: Tensor) -> Tensor:
    """Return R1 (Mescheder et al. 2018): the squared gradient of a verdict by its crop, a mean
    over verdicts.
    """
    real = real.detach().requires_grad_(True)
    total = sum(
        (v.float().sum() / (v.numel() / len(v)) ** 0.5 for v in discriminator(real)),
        torch.zeros(()),
    )
    (slope,) = torch.autograd.grad(total, real, create_graph=True)
    return slope.float().square().sum() / len(real)


def sliced(
    fake: Tensor,
    real: Tensor,
    random: torch.Generator,
    *,
    width: int = 7,
    count: int = 32,
    scales: int = 3,
) -> Tensor:
    """Return the distance of the distributions of neighbourhoods along random directions, on
    several scales (Rabin et al. 2011).

    Parameters
    ----------
    fake, real : (B, K, Z, Y, X) tensor, or of slices (B, K, Y, X)
    random : torch.Generator
        Source of the directions and of the first place of the grid of neighbourhoods.
    width : int
        Of a neighbourhood, voxels of its scale.
    count : int
        Directions a scale.
    scales : int
        Each has half the resolution of the one before, and twice as dense a grid.
    """
    total = torch.zeros((), device=fake.device)
    axes = fake.ndim - 2
    halve = avg_pool3d if axes == 3 else avg_pool2d
    for scale in range(scales):
        step = max(1, 4 >> scale)
        directions = torch.randn(
            count, fake.shape[1], *(width,) * axes, generator=random, device=random.device
        )
        lengths = directions.flatten(1).norm(dim=1).reshape(-1, *(1,) * (axes + 1))
        directions = (directions / lengths).to(fake.device)
        starts = torch.randint(0, step, (axes,), generator=random, device=random.device).tolist()
        a, b = (_sort_projections(volume, directions, starts, step) for volume in (fake, real))
        total = total + (a - b).square().mean()
        fake, real = halve(fake, 2), halve(real, 2)
    return total


def _sort_projections(
    volume: Tensor, directions: Tensor, starts: Sequence[int], step: int
) -> Tensor:
    """Return (directions, places), the sorted projections of neighbourhoods on directions."""
    beyond = volume[(slice(None), slice(None), *(slice(start, None) for start in starts))]
    convolve = conv3d if len(starts) == 3 else conv2d
    products = convolve(beyond, directions, stride=step)
    return torch.sort(products.movedim(1, 0).flatten(1), dim=1).values


def gram(fake: Sequence[Tensor], real: Sequence[Tensor], *, reduction: str = "mean") -> Tensor:
    """Return the squared distance of the gram matrices of slices in three directions, a sum over
    layers, a mean over crops.

    Parameters
    ----------
    fake, real : sequence of (B, C, Z, Y, X) tensor
        Features of the layers.
    reduction : {"mean", "sum"}
        "mean": products are means over the voxels of a slice, distances over slices and pairs of
        features. "sum": both are sums (section 3.3).
    """
    total = torch.zeros((), device=fake[0].device)
    # The printed sums grow with the slices: products in bf16 would keep two digits of them.
    exact = torch.autocast(fake[0].device.type, enabled=False)
    with exact if reduction == "sum" else nullcontext():
        for a, b in zip(fake, real, strict=True):
            apart = _gram_matrices(a, reduction) - _gram_matrices(b.detach(), reduction)
            total = total + _reduce(apart.square(), reduction, crops=len(a))
    return total


def _reduce(squares: Tensor, reduction: str, *, crops: int) -> Tensor:
    """Return the mean of squares, or their sum over one crop, a mean over crops."""
    return squares.mean() if reduction == "mean" else squares.sum() / crops


def _gram_matrices(features: Tensor, reduction: str) -> Tensor:
    """Return (B, 3 directions, slices, C, C), the products of every two features, each a mean or a
    sum over the voxels of a slice.
    """
    found = []
    for axis in (2, 3, 4):
        side = features.shape[axis]
        at = torch.arange(SLICES, device=features.device) * side // SLICES + side // (2 * SLICES)
        # (B, slices, C, voxels)
        flat = features.index_select(axis, at).movedim(axis, 1).flatten(3).float()
        products = flat @ flat.transpose(2, 3)
        found.append(products / flat.shape[3] if reduction == "mean" else products)
    return torch.stack(found, 1)


class CandidateTable:
    """The look-up table of the structural loss, refreshed in chunks so that it need not be in
    memory at once.

    Parameters
    ----------
    crops : (N, K, Z, Y, X) tensor
        Crops of the exemplar that hold the candidates, sampled before the training.
    chunk : int
        Crops whose features are held at once.
    """

    def __init__(self, crops: Tensor, *, chunk: int) -> None:
        self.crops = crops
        self.chunk = chunk

    def loss(
        self, discriminator: Score, fake: Sequence[Tensor], *, reduction: str = "mean"
    ) -> Tensor:
        """Return the squared distance of the regions of generated features to the nearest of the
        exemplar, a sum over layers, a mean over crops.

        Parameters
        ----------
        discriminator : Score
            The discriminator after its latest step: it gives the candidates' features.
        fake : sequence of (B, C, Z, Y, X) tensor
            Its features of generated crops.
        reduction : {"mean", "sum"}
            "mean": a mean over regions and their numbers. "sum": the sums of equations 3 and 4.
        """
        queries = [cubes_of(layer, edge) for layer, edge in zip(fake, EDGES, strict=True)]
        nearest = self._nearest(discriminator, [cubes.detach() for cubes in queries])
        return sum(
            (
                _reduce((cubes.float() - match.float()).square(), reduction, crops=len(fake[0]))
                for cubes, match in zip(queries, nearest, strict=True)
            ),
            torch.zeros((), device=fake[0].device),
        )

    def _nearest(self, discriminator: Score, queries: Sequence[Tensor]) -> list[Tensor]:
        """Find the candidate nearest to each query (Q, D), layer by layer."""
        best = [torch.full((len(cubes),), torch.inf, device=cubes.device) for cubes in queries]
        found = [torch.empty_like(cubes) for cubes in queries]
        lengths = [squares_of(cubes) for cubes in queries]
        with torch.no_grad():
            for chunk in self.crops.split(self.chunk):
                for layer, features in enumerate(discriminator.features(chunk)):
                    candidates = cubes_of(features, EDGES[layer]).to(queries[layer].dtype)
                    distance, index = squared_distances(
                        queries[layer], candidates, lengths[layer]
                    ).min(1)
                    nearer = distance < best[layer]
                    best[layer][nearer] = distance[nearer]
                    found[layer][nearer] = candidates[index[nearer]]
        return found


def cubes_of(features: Tensor, edge: int) -> Tensor:
    """Split (B, C, Z, Y, X) into cubes of `edge`, (B Z Y X / edge^3, C edge^3); cut the rest."""
    b, c, *sides = features.shape
    z, y, x = (side // edge for side in sides)
    cut = features[:, :, : z * edge, : y * edge, : x * edge]
    return (
        cut.reshape(b, c, z, edge, y, edge, x, edge)
        .permute(0, 2, 4, 6, 1, 3, 5, 7)
        .reshape(b * z * y * x, -1)
    )


def squared_distances(a: Tensor, b: Tensor, squares: Tensor | None = None) -> Tensor:
    """Return (N, M) float32, the squared distances of rows (equation 3 of the paper).

    Parameters
    ----------
    a, b : (N, D) and (M, D) tensor
    squares : (N,) float32 tensor, optional
        `squares_of(a)`, where it is known.
    """
    first = squares_of(a) if squares is None else squares
    return first[:, None] + squares_of(b) - 2 * (a @ b.T).float()


def squares_of(rows: Tensor) -> Tensor:
    """Return (N,) float32, the sum of the squares of each row."""
    return rows.float().square().sum(1)

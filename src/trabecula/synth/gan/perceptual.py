"""The paper's losses on the discriminator's features: gram (section 3.3) and structural (section
3.2, equations 3 and 4).

Both are means rather than the sums of the paper's equations, so that their weights do not depend on
the size of a crop.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from trabecula.synth.gan.networks import Score

SLICES = 4
"""Equally spaced slices along every axis that the gram loss looks at."""

EDGES = (8, 4, 2)
"""Edge and stride of the cubical regions of the structural loss, voxels of each of the first three
layers.
"""


def gram(made: Sequence[Tensor], real: Sequence[Tensor]) -> Tensor:
    """Squared distance of the gram matrices of slices in three directions, a sum over layers, a
    mean over crops.

    Parameters
    ----------
    made, real : sequence of (B, C, Z, Y, X) tensor
        Features of the layers.
    """
    return sum(
        (
            (_gram_of(a) - _gram_of(b.detach())).square().mean()
            for a, b in zip(made, real, strict=True)
        ),
        torch.zeros((), device=made[0].device),
    )


def _gram_of(features: Tensor) -> Tensor:
    """(B, 3 directions, slices, C, C): products of every two features, a mean over the voxels of a
    slice.
    """
    found = []
    for axis in (2, 3, 4):
        side = features.shape[axis]
        at = torch.arange(SLICES, device=features.device) * side // SLICES + side // (2 * SLICES)
        # (B, slices, C, voxels)
        flat = features.index_select(axis, at).movedim(axis, 1).flatten(3).float()
        found.append(flat @ flat.transpose(2, 3) / flat.shape[3])
    return torch.stack(found, 1)


class Table:
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

    def loss(self, judge: Score, made: Sequence[Tensor]) -> Tensor:
        """Mean squared distance of the regions of made features to the nearest of the exemplar, a
        sum over layers.

        Parameters
        ----------
        judge : Score
            The discriminator after its latest step: what the candidates' features are taken from.
        made : sequence of (B, C, Z, Y, X) tensor
            Its features of made crops.
        """
        asked = [regions_of(layer, edge) for layer, edge in zip(made, EDGES, strict=True)]
        nearest = self._nearest(judge, [regions.detach() for regions in asked])
        return sum(
            (
                (regions.float() - match.float()).square().mean()
                for regions, match in zip(asked, nearest, strict=True)
            ),
            torch.zeros((), device=made[0].device),
        )

    def _nearest(self, judge: Score, asked: Sequence[Tensor]) -> list[Tensor]:
        """The candidate nearest to each of the regions (Q, D) that are asked for, layer by layer."""
        best = [torch.full((len(regions),), torch.inf, device=regions.device) for regions in asked]
        found = [torch.empty_like(regions) for regions in asked]
        with torch.no_grad():
            for chunk in self.crops.split(self.chunk):
                for layer, features in enumerate(judge.features(chunk)):
                    candidates = regions_of(features, EDGES[layer]).to(asked[layer].dtype)
                    distance, index = squared_distances(asked[layer], candidates).min(1)
                    nearer = distance < best[layer]
                    best[layer][nearer] = distance[nearer]
                    found[layer][nearer] = candidates[index[nearer]]
        return found


def regions_of(features: Tensor, edge: int) -> Tensor:
    """(B, C, Z, Y, X) as its cubes of `edge`, side by side: (B Z Y X / edge^3, C edge^3); what is
    left over is cut.
    """
    b, c, *sides = features.shape
    z, y, x = (side // edge for side in sides)
    cut = features[:, :, : z * edge, : y * edge, : x * edge]
    return (
        cut.reshape(b, c, z, edge, y, edge, x, edge)
        .permute(0, 2, 4, 6, 1, 3, 5, 7)
        .reshape(b * z * y * x, -1)
    )


def squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(N, M) float32 squared distances of rows (equation 3)."""
    squares = [part.float().square().sum(1) for part in (a, b)]
    return squares[0][:, None] + squares[1] - 2 * (a @ b.T).float()

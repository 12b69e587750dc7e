"""What sliced rounds aim at: neighbourhoods of exemplars on their principal components, in whole
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.synth.shared.neighbourhoods import SCALE, Basis, Triple, principal_basis, project
from trabecula.synth.shared.votes import UNIT

FINE = 4096  # what an orthonormal basis is multiplied by on the way back
_MOST = 1 << 16  # neighbourhoods of the exemplars that stand for all of them, about


@dataclass(frozen=True)
class SliceTarget:
    """What sliced rounds aim at: neighbourhoods of exemplars on their principal components.

    `features` (N, P) float32 and `back` (P, C * voxels) float64 hold whole numbers, P is a power of
    two; `rest` (C,) int64 is what the components leave out of the mean, in 1 / UNIT of an int8
    step.
    """

    basis: Basis
    features: np.ndarray
    back: np.ndarray
    rest: np.ndarray


def slice_target(
    fields: Sequence[np.ndarray],
    *,
    width: int = 4,
    variance: float = 0.95,
    most: int = 64,
    flat: bool = False,
) -> SliceTarget:
    """The neighbourhoods of fields (C, Z, Y, X) int8 of one number of channels, about 65 thousand
    of them at most.

    Parameters
    ----------
    fields : sequence of arrays
        The exemplars at one resolution. The components are those of the first.
    width : int
        Voxels a side of a neighbourhood.
    variance : float
        Share that the components keep, 0..1.
    most : int
        Components at most.
    flat : bool
        Whether neighbourhoods are squares of one plane z, as of a picture (C, 1, Y, X), rather than
        cubes.
    """
    basis = principal_basis(fields[0], width=width, variance=variance, most=most, flat=flat)
    count = basis.vectors.shape[1]
    size = 1 << max(2, (count - 1).bit_length())
    sides = [
        [side - w + 1 for side, w in zip(field.shape[1:], basis.box, strict=True)]
        for field in fields
    ]
    stride = max(1, round((sum(map(math.prod, sides)) / _MOST) ** (1 / 2 if flat else 1 / 3)))
    rows = np.concatenate(
        [project(field, basis, step=stride).reshape(-1, count) for field in fields]
    )
    features = np.zeros((len(rows), size), np.float32)
    features[:, :count] = rows
    back = np.zeros((size, len(basis.vectors)))
    back[:count] = np.rint(basis.vectors.T.astype(np.float64) * (FINE / basis.scale))
    middle = (rows.sum(axis=0, dtype=np.float64) / len(rows)) @ back[:count] / (SCALE * FINE)
    rest = _mean_of_neighbourhoods(fields, basis.box) - middle.reshape(len(fields[0]), -1).mean(
        axis=1
    )
    rest = np.rint(UNIT * rest).astype(np.int64)
    return SliceTarget(basis, features, back, rest)


def _mean_of_neighbourhoods(fields: Sequence[np.ndarray], box: Triple) -> np.ndarray:
    """The mean (C,) of all values in all neighbourhoods: a voxel near a face lies in fewer of them."""
    sums, count = np.zeros(len(fields[0])), 0
    for field in fields:
        covers = [
            np.convolve(np.ones(side - w + 1, np.int64), np.ones(w, np.int64))
            for side, w in zip(field.shape[1:], box, strict=True)
        ]
        for axis, cover in enumerate(covers):  # sums of whole numbers: exact
            shape = [1, 1, 1]
            shape[axis] = -1
            covers[axis] = cover.reshape(shape)
        weights = covers[0] * covers[1] * covers[2]
        sums += [float(np.sum(channel * weights)) for channel in field]
        count += int(weights.sum())
    return np.asarray(sums / count)

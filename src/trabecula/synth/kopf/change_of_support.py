"""From the coarse scan to the material at the picture's resolution: its volume fraction and its
interface.

A majority over blocks loses what is smaller than half a block: a rare phase becomes rarer, and has
less interface. The picture shows how much, where it is down-sampled as the scan is. But a square of
a plane is not a cube: a cube holds more voxels, so its mean varies less. The picture is therefore
averaged over squares that are larger, by as much as makes the variance of their means that of cubes
(the dispersion variance of geostatistics, where going from points to blocks is the change of
support: Journel and Huijbregts 1978, *Mining Geostatistics*, chapters II and VI). What a slice has
more or less of than the volume then cancels: fractions are compared as probits, interfaces as
shares of phi (1 - phi).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from trabecula.measure.correlation import two_point

_NORMAL = NormalDist()
_LEAST = 1e-6  # of a fraction, so that its probit is finite


@dataclass(frozen=True)
class Material:
    """A phase at some resolution.

    Attributes
    ----------
    fraction : float
        Its volume fraction.
    interface : float
        Share of pairs of voxels, one apart along an axis, that lie on different sides.
    """

    fraction: float
    interface: float


def refine(
    coarse: np.ndarray, pictures: Sequence[np.ndarray], sides: Sequence[int], fraction: float | None
) -> Material:
    """Estimate the material at the pictures' resolution.

    Parameters
    ----------
    coarse : (z, y, x) bool
        The phase in the scan.
    pictures : sequence of (Y, X) bool
    sides : three ints
        Voxels of the result in a voxel of the scan.
    fraction : float, optional
        The volume fraction, where the scan tells it (its values are partial volumes).
    """
    own = _material(coarse, [1, 1, 1])
    found = [_refine_by(own, picture, sides, fraction) for picture in pictures]
    return Material(
        float(np.mean([one.fraction for one in found])),
        float(np.mean([one.interface for one in found])),
    )


def _refine_by(
    own: Material, picture: np.ndarray, sides: Sequence[int], fraction: float | None
) -> Material:
    lag = max(1, round(float(np.prod(sides)) ** (1 / 3)))
    fine = _material(picture, [1, 1])
    seen = _material(block_majority(picture, equivalent_side(picture, sides)), [lag, lag])
    if fraction is None:
        fraction = _NORMAL.cdf(
            _probit(own.fraction) + _probit(fine.fraction) - _probit(seen.fraction)
        )
    shares = [one.interface / _spread(one.fraction) for one in (own, fine, seen)]
    interface = shares[0] * shares[1] / max(shares[2], _LEAST) * _spread(fraction)
    return Material(fraction, min(interface, 1.0))


def equivalent_side(picture: np.ndarray, sides: Sequence[int]) -> int:
    """Return the side of squares whose means vary as those of blocks of `sides` do in a material
    that looks like the picture from everywhere.
    """
    curve = _covariance(picture, sides)
    wanted = block_variance(curve, sides)
    candidates = range(1, len(curve))
    return min(candidates, key=lambda side: abs(block_variance(curve, (side, side)) - wanted))


def variance_share(pictures: Sequence[np.ndarray], sides: Sequence[int]) -> float:
    """Return the variance of means over blocks, as a share of phi (1 - phi)."""
    shares = [
        block_variance(_covariance(one, sides), sides) / _spread(float(one.mean()))
        for one in pictures
    ]
    return float(np.mean(shares))


def _covariance(picture: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """Return the covariance of a picture, as far as the squares reach that stand for blocks."""
    longest = max(1, min(min(picture.shape) // 2, int(np.ceil(np.sqrt(3) * max(sides)))))
    return two_point(picture.astype(np.uint8), r_max=longest, phase=1) - float(picture.mean()) ** 2


def block_variance(covariance: np.ndarray, sides: Sequence[int]) -> float:
    """Return the variance of means over blocks: the mean of the covariance C(r), r = 0, 1, ...,
    over all pairs of voxels in a block.
    """
    square, weight = np.zeros(()), np.ones(())
    for side in sides:
        lags = np.arange(1 - side, side)
        square = np.add.outer(square, lags**2)
        weight = np.multiply.outer(weight, (side - np.abs(lags)) / side**2)
    found = np.interp(np.sqrt(square), np.arange(len(covariance)), covariance)
    return float((found * weight).sum())


def block_majority(picture: np.ndarray, side: int) -> np.ndarray:
    """Return whether most pixels of the square that begins at each place are True."""
    sums = np.pad(picture.astype(np.int64), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    total = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return np.asarray(2 * total > side**2)


def _material(phase: np.ndarray, lags: Sequence[int]) -> Material:
    changes = [
        np.mean(np.diff(phase.take(range(start, side, lag), axis), axis=axis))
        for axis, (side, lag) in enumerate(zip(phase.shape, lags, strict=True))
        for start in range(min(lag, side - lag))
    ]
    return Material(float(phase.mean()), float(np.mean(changes)) if changes else 0.0)


def _probit(fraction: float) -> float:
    return _NORMAL.inv_cdf(min(max(fraction, _LEAST), 1 - _LEAST))


def _spread(fraction: float) -> float:
    return max(fraction * (1 - fraction), _LEAST)

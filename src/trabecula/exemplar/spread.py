"""Distribution of the phases' volume fractions over samples of a material.

Every sample of a material has fractions of its own. How far they scatter follows from the
covariance of the phases, by the integral range (`measure.mean_variance`); where there are several
exemplars, what they differ by beyond that is added. Fractions are drawn as normal log-ratios
(Aitchison 1982, doi:10.1111/j.2517-6161.1982.tb01195.x): they stay above 0 and add up to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.seeds import generator
from trabecula.measure.mean_variance import SpatialCovariance

_STAGE = "spread"
_SAMPLE = 4096  # draws by which the mean is corrected
_ROUNDS = 8  # of the correction


@dataclass(frozen=True)
class FractionSpread:
    """Mean and covariance of the fractions of samples of one shape.

    Attributes
    ----------
    phases : tuple of str
    mean : (P,) float64
        Fractions, in all 1.
    covariance : (P, P) float64
    """

    phases: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    def draw(self, seeds: Sequence[int], *, scale: float = 1.0) -> list[dict[str, float]]:
        """Draw the fractions of samples, by the phase's name.

        Parameters
        ----------
        seeds : sequence of int
            One a sample. Same seed, same fractions.
        scale : float
            Factor of the standard deviations; 0 gives the mean.
        """
        there = np.flatnonzero(self.mean > 0)
        mean, covariance = self.mean[there], scale**2 * self.covariance[np.ix_(there, there)]
        normal = [generator(seed, _STAGE).standard_normal(len(there)) for seed in seeds]
        found = np.zeros((len(seeds), len(self.mean)))
        found[:, there] = _log_normal_fractions(np.array(normal), mean, covariance)
        return [dict(zip(self.phases, map(float, row), strict=True)) for row in found]

    def to_json(self) -> dict[str, Any]:
        """Return mean and standard deviation of every phase."""
        deviations = np.sqrt(np.diag(self.covariance))
        return {
            name: {"mean": float(mean), "standard_deviation": float(deviation)}
            for name, mean, deviation in zip(self.phases, self.mean, deviations, strict=True)
        }


def _log_normal_fractions(
    normal: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Return fractions (N, P) of standard normal numbers (N, P), with this mean and, to first
    order, this covariance.
    """
    centring = np.eye(len(mean)) - 1 / len(mean)
    slope = centring / mean  # of the centred logarithms, at the mean
    values, vectors = np.linalg.eigh(slope @ covariance @ slope.T)
    factor = vectors * np.sqrt(np.maximum(values, 0))
    centre = np.log(mean)
    sample = generator(0, _STAGE, 1).standard_normal((_SAMPLE, len(mean)))
    for _ in range(_ROUNDS):  # the mean of exponentials is not the exponential of the mean
        centre += np.log(mean / _softmax(centre + sample @ factor.T).mean(axis=0))
    return _softmax(centre + normal @ factor.T)


def _softmax(ratios: np.ndarray) -> np.ndarray:
    """Return fractions of log-ratios (N, P)."""
    weights = np.exp(ratios - ratios.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def fraction_spread(exemplars: Sequence[Image], shape: Sequence[int]) -> FractionSpread:
    """Return the distribution of the fractions of samples of `shape` voxels of the exemplars'
    material.

    Parameters
    ----------
    exemplars : sequence of Image of labels
        Of one material, with the same phases.
    shape : sequence of int
        Voxels of a sample, as many axes as the exemplars have.

    Raises
    ------
    InputError
        Exemplars of another kind, or of other axes than the samples.
    """
    first = exemplars[0]
    if first.kind != "labels":
        raise InputError(
            f"a spread of fractions needs phases, the exemplar is {first.kind}: segment it "
            "(tb.segment, or --threshold auto), or give --spread 0"
        )
    if first.ndim != len(shape):
        raise InputError(
            f"a spread is known for samples of {first.ndim} axes, as the exemplar has, not for "
            f"{tuple(shape)}: give --spread 0"
        )
    fields = [_indicators(image) for image in exemplars]
    means = np.array([each.reshape(len(each), -1).mean(axis=1) for each in fields])
    weights = np.array([image.values.size for image in exemplars], np.float64)
    weights /= weights.sum()
    mean = weights @ means
    known = [SpatialCovariance.of(each[1:]) for each in fields]
    covariance = np.tensordot(weights, [_complete(each.of_means(shape)) for each in known], 1)
    if len(exemplars) > 1:
        own = [
            _complete(each.of_means(image.shape))
            for each, image in zip(known, exemplars, strict=True)
        ]
        covariance = covariance + _excess(np.cov(means.T), np.tensordot(weights, own, 1))
    return FractionSpread(first.phases, mean, covariance)


def _indicators(image: Image) -> np.ndarray:
    """Return 1 where a voxel is of a phase, (P, ...) float32."""
    return np.stack([image.values == label for label in range(len(image.phases))]).astype(
        np.float32
    )


def _complete(covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of all fractions, of which the first is what the others leave."""
    others = np.vstack([-np.ones(len(covariance)), np.eye(len(covariance))])
    return np.asarray(others @ covariance @ others.T)


def _excess(between: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return what exemplars differ by beyond the covariance that is expected of their sizes."""
    values, vectors = np.linalg.eigh(between - expected)
    return np.asarray((vectors * np.maximum(values, 0)) @ vectors.T)

"""Random structures whose two-point function is known, and the length at which it decays."""

import math

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure.correlation import (
    correlation_length,
    covariance_form,
    cross_correlation,
    two_point,
    two_point_cluster,
)


def overlapping_spheres(seed, *, side, radius, count):
    rng = np.random.default_rng(seed)
    solid = np.zeros((side,) * 3, bool)
    for centre in rng.random((count, 3)) * side:
        gaps = [np.abs(np.arange(side) - at) for at in centre]
        z, y, x = (np.minimum(gap, side - gap) ** 2 for gap in gaps)
        solid |= z[:, None, None] + y[:, None] + x < radius**2
    return solid


def test_overlapping_spheres_follow_their_formula():
    # Torquato 2002, chapter 5: between overlapping spheres S2 = exp(-n V(r)), V the union of two
    # spheres r apart; for a count that is fixed, (1 - V / volume)^count, without any error of
    # voxels, since a voxel is its centre.
    side, radius, count, seeds = 44, 7.0, 40, 30
    r = np.arange(21)
    union = (
        4
        / 3
        * np.pi
        * radius**3
        * np.where(r < 2 * radius, 1 + 0.75 * r / radius - (r / radius) ** 3 / 16, 2)
    )
    theory = (1 - union / side**3) ** count
    curves = np.array(
        [
            np.mean(
                [
                    two_point(solid, r_max=20, phase="void", axis=axis, periodic=True)
                    for axis in range(3)
                ],
                axis=0,
            )
            for solid in (
                overlapping_spheres(s, side=side, radius=radius, count=count) for s in range(seeds)
            )
        ]
    )
    error = curves.std(axis=0, ddof=1) / np.sqrt(seeds)
    assert np.all(error < 0.012)
    assert np.all(np.abs(curves.mean(axis=0) - theory) < 4 * error)


def gaussian_fields(seeds, *, side, width):
    """Draw periodic Gaussian fields with covariance exp(-(r / width)^2), variance 1."""
    lag = np.minimum(np.arange(side), side - np.arange(side))
    covariance = np.exp(-((lag / width) ** 2))
    amplitude = np.sqrt(np.maximum(np.fft.fft(covariance).real, 0))
    filters = amplitude[:, None, None] * amplitude[:, None] * amplitude
    for seed in range(seeds):
        noise = np.fft.fftn(np.random.default_rng(seed).standard_normal((side,) * 3))
        yield np.fft.ifftn(noise * filters).real


def over_offsets(function, r_max):
    """Average a function of distance over the offsets that round to r: for r = 1 they are 1 or
    sqrt(2) long.
    """
    lengths = np.sqrt(
        sum(np.square(axis) for axis in np.ogrid[[slice(-r_max - 1, r_max + 2)] * 3])
    ).ravel()
    bins = (lengths + 0.5).astype(int)
    near = bins <= r_max
    return np.bincount(bins[near], function(lengths[near])) / np.bincount(bins[near])


@pytest.mark.whole
def test_halved_gaussian_fields_follow_the_arcsine():
    # Where half of the field lies above: S2 = 1/4 + asin(rho(r)) / (2 pi).
    def theory(r):
        return 0.25 + np.arcsin(np.exp(-((r / 6.0) ** 2))) / (2 * np.pi)

    axes, radial, cross = [], [], []
    for field in gaussian_fields(10, side=60, width=6.0):
        solid = field > 0
        axes.append(
            np.mean(
                [two_point(solid, r_max=16, axis=axis, periodic=True) for axis in range(3)], axis=0
            )
        )
        radial.append(two_point(solid, r_max=16, periodic=True))
        cross.append(cross_correlation(solid, first=0, second=1, r_max=16, periodic=True))
    binned = over_offsets(theory, 16)
    for curves, truth in [(axes, theory(np.arange(17))), (radial, binned), (cross, 0.5 - binned)]:
        error = np.std(curves, axis=0, ddof=1) / np.sqrt(len(curves))
        assert np.all(error < 0.01)
        assert np.all(np.abs(np.mean(curves, axis=0) - truth) <= 4 * error)


def test_correlation_length_of_a_gaussian_field():
    # Covariance 2 / pi asin(exp(-(r / w)^2)) is 1 / e at r = w sqrt(-log(sin(pi / 2e))).
    width = 6.0
    theory = width * math.sqrt(-math.log(math.sin(math.pi / (2 * math.e))))
    solids = [field > 0 for field in gaussian_fields(4, side=60, width=width)]
    lengths = [correlation_length(solid, periodic=True) for solid in solids]
    assert np.mean(lengths) == pytest.approx(theory, rel=0.05)
    image = tb.Image(solids[0], "labels", spacing=2.5, unit="um")
    assert correlation_length(image, periodic=True) == pytest.approx(2.5 * lengths[0], rel=1e-12)


def test_correlation_length_runs_in_the_images_unit_along_every_axis():
    # Blocks of 4 x 8 independent pixels: covariance 1 - r / side of the block.
    blocks = np.random.default_rng(1).random((64, 64)) < 0.5
    image = tb.Image(
        np.kron(blocks, np.ones((4, 8), bool)), "labels", spacing=(3.0, 1.0), unit="um"
    )
    assert correlation_length(image, axis=0) == pytest.approx(4 * (1 - 1 / math.e) * 3, rel=0.1)
    assert correlation_length(image, axis=-1, r_max=60) == pytest.approx(
        8 * (1 - 1 / math.e), rel=0.1
    )
    assert 4 < correlation_length(image) < 9


def test_correlation_length_without_decay_or_without_a_phase():
    stripes = np.tile([1, 1, 1, 0, 0, 0], (8, 8))
    assert correlation_length(stripes, axis=1, r_max=15) == math.inf
    half = np.zeros((20, 20, 20), np.uint8)
    half[:10] = 1
    assert correlation_length(half, axis=1) == math.inf
    assert correlation_length(np.zeros((8, 8, 8), np.uint8)) == 0
    assert correlation_length(np.ones((8, 8, 8), np.uint8)) == 0


def test_covariance_form_of_a_cube_of_chequers():
    board = np.indices((12, 12, 12)).sum(axis=0) % 2
    assert covariance_form(two_point(board, r_max=4, axis=0)).tolist() == [1, -1, 1, -1, 1]
    assert two_point_cluster(board, r_max=4, axis=0).tolist() == [0.5, 0, 0, 0, 0]


def test_half_plane_pairs_that_fit():
    # Half of n planes: of n - r pairs across, n / 2 - r lie in the half.
    half = np.zeros((20, 6, 6), np.uint8)
    half[:10] = 1
    expected = [max(0, 10 - r) / (20 - r) for r in range(16)]
    np.testing.assert_allclose(two_point(half, r_max=15, axis=0), expected, atol=1e-15)
    np.testing.assert_allclose(two_point(half, r_max=5, axis=1), 0.5, atol=1e-15)
    np.testing.assert_allclose(
        two_point(half, r_max=5, direction=(1, 0, 1)), expected[:6], atol=1e-15
    )

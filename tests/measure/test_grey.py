"""Histograms, their divergence, autocorrelation: known values, sums done by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.measure.grey import autocorrelation, histogram, kullback_leibler, ten_bins
from trabecula.measure.smooth import gaussian

counts = arrays(np.float64, 6, elements=st.integers(0, 50)).filter(lambda values: values.sum() > 0)


def grey(values, **fields):
    return tb.Image(np.asarray(values), "grey", **fields)


def test_histogram_counts_levels_of_grey_colour_and_labels():
    ramp = grey(np.arange(256, dtype=np.uint8).reshape(16, 16))
    assert np.array_equal(histogram(ramp), np.full(256, 1 / 256))
    assert histogram(ramp, bins=[0, 64, 256]).tolist() == [0.25, 0.75]
    assert histogram(ramp, bins=[100, 128, 192]).tolist() == [0.5, 0.5]
    assert histogram(grey([[0.0, 1.0], [3.0, 4.0]]), bins=2).tolist() == [0.5, 0.5]
    colour = np.zeros((4, 4, 3), np.uint8)
    colour[..., 1] = 255
    assert histogram(tb.Image(colour, "colour"), bins=2).tolist() == [[1, 0], [0, 1], [1, 0]]
    assert histogram(np.array([[0, 1], [1, 1]])).tolist() == [0.25, 0.75]


def test_mask_leaves_voxels_out():
    values = np.array([[10, 200], [10, 10]], np.uint8)
    assert histogram(grey(values), bins=2, mask=values > 100).tolist() == [0, 1]
    with pytest.raises(tb.errors.InputError, match="mark with True"):
        histogram(grey(values), mask=values > 250)
    with pytest.raises(tb.errors.InputError, match="shape"):
        histogram(grey(values), mask=np.ones((3, 2), bool))


def test_ten_bins_are_those_of_the_paper():
    ramp = np.arange(256, dtype=np.uint8).reshape(16, 16)
    expected = np.array([25] * 9 + [31]) / 256
    assert np.allclose(ten_bins(grey(ramp)), expected)
    assert np.allclose(ten_bins(grey(ramp.astype(np.float32))), expected)
    for wrong in (grey(ramp * 2.0), np.eye(3, dtype=np.uint8)):
        with pytest.raises(tb.errors.InputError):
            ten_bins(wrong)


def test_divergence_of_known_histograms():
    assert kullback_leibler([0.5, 0.5], [0.9, 0.1], floor=0) == pytest.approx(
        np.log(0.5 / np.sqrt(0.09))
    )
    assert kullback_leibler([0, 4], [2, 2], floor=0) == pytest.approx(np.log(2))
    assert kullback_leibler([1, 1], [1, 0], floor=0) == np.inf
    assert kullback_leibler([1, 1], [1, 0], floor=1e-6) == pytest.approx(
        0.5 * np.log(0.25e6), rel=1e-3
    )
    assert kullback_leibler([[1, 1], [0, 4]], [[1, 1], [2, 2]], floor=0) == pytest.approx(
        np.log(2) / 2
    )
    for wrong in ([1, 2, 3], [1, -1], [0, 0]):
        with pytest.raises(tb.errors.InputError):
            kullback_leibler([1, 1], wrong)


@pytest.mark.whole
@given(counts, counts)
def test_divergence_is_positive_and_zero_of_itself(p, q):
    assert kullback_leibler(p, 3 * p) == pytest.approx(0, abs=1e-12)
    assert kullback_leibler(p, q) >= 0
    if not np.allclose(p / p.sum(), q / q.sum()):
        assert kullback_leibler(p, q) > 0


def test_cosine_correlates_as_a_cosine():
    x = np.arange(80)
    rho = autocorrelation(grey(np.cos(2 * np.pi * x / 10) + np.zeros((30, 1))), lags=20)
    assert rho.shape == (41, 41)
    expected = np.cos(2 * np.pi * np.arange(-20, 21) / 10)
    assert np.allclose(rho, expected, atol=0.03)  # pairs that fit cover no whole number of periods
    assert np.allclose(rho[:, 20], 1)  # equal along y


@pytest.mark.whole
@given(
    arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=6),
        elements=st.integers(0, 9),
    ),
    st.integers(1, 4),
)
def test_autocorrelation_equals_the_sum_over_pairs(values, lags):
    rho = autocorrelation(grey(values), lags=lags)
    centred = values.astype(float) - values.mean(dtype=float)
    reach = [min(lags, side - 1) for side in values.shape]
    assert rho.shape == tuple(2 * far + 1 for far in reach)
    for offset in np.ndindex(rho.shape):
        k = np.array(offset) - reach
        here = tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(k, values.shape, strict=True))
        there = tuple(
            slice(max(0, s), n - max(0, -s)) for s, n in zip(k, values.shape, strict=True)
        )
        expected = (
            (centred[here] * centred[there]).mean() / centred.var()
            if centred.any()
            else float(not k.any())
        )
        assert rho[offset] == pytest.approx(expected, abs=2e-4)


def test_autocorrelation_of_colour_and_labels():
    pattern = np.random.default_rng(0).integers(0, 2, (20, 20)).astype(np.uint8)
    expected = autocorrelation(grey(pattern), lags=5)
    assert np.allclose(
        autocorrelation(tb.Image(np.stack([200 * pattern] * 3, axis=-1), "colour"), lags=5),
        expected,
        atol=1e-5,
    )
    assert np.allclose(autocorrelation(pattern, lags=5), expected)
    with pytest.raises(tb.errors.InputError, match="phases"):
        autocorrelation(pattern * 2, lags=5)


def test_gaussian_has_its_width_and_keeps_the_mean():
    point = np.zeros((41, 61), np.float32)
    point[20, 30] = 1
    smooth = gaussian(point, (2.0, 3.0))
    y, x = np.ogrid[-20:21, -30:31]
    assert np.allclose(
        smooth, np.exp(-(y**2) / 8 - x**2 / 18) / (12 * np.pi), atol=2e-4 / (12 * np.pi) * 10
    )
    assert smooth.sum() == pytest.approx(1, rel=1e-5)
    assert np.allclose(gaussian(np.full((5, 6, 7), 3, np.uint8), 1.5), 3)
    assert point.sum() == 1

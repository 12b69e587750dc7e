"""Dependent parts and tests of two samples: known variances, and SciPy, where it has the same."""

import numpy as np
import pytest
from scipy import stats

from trabecula.numerics.quantiles import (
    student,
    student_tail,
    variance_ratio,
    variance_ratio_share,
)
from trabecula.report import two_samples
from trabecula.report.dependence import CorrelatedSample, correlate_boxes, join_blocks, spread_boxes
from trabecula.report.two_samples import RankTests, adjust, mean_p, spread_interval, spread_p


def test_boxes_reach_from_face_to_face_and_overlap_by_half_where_few_fit():
    boxes = spread_boxes((200, 100, 130), (100, 100, 50))
    starts = [sorted({box[axis].start for box in boxes}) for axis in range(3)]
    assert starts == [[0, 50, 100], [0], [0, 26, 53, 80]]
    assert len(spread_boxes((90, 90, 90), (30, 30, 30))) == 27, "enough side by side: no overlap"
    assert spread_boxes((99, 200, 200), (100, 100, 100)) == []
    assert len(spread_boxes((100, 100, 100), (100, 100, 100))) == 1


def test_without_long_waves_the_correlation_is_the_share_of_common_voxels():
    boxes = spread_boxes((50, 40, 30), (24, 20, 16))
    found = correlate_boxes(boxes, 1.0)
    masks = np.zeros((len(boxes), 50, 40, 30), bool)
    for mask, box in zip(masks, boxes, strict=True):
        mask[box] = True
    flat = masks.reshape(len(boxes), -1).astype(float)
    assert found == pytest.approx(flat @ flat.T / (24 * 20 * 16))


@pytest.mark.parametrize("exponent", [1.0, 0.7, 0.4])
def test_the_mean_of_all_boxes_side_by_side_has_the_variance_of_the_whole(exponent):
    boxes = spread_boxes((72, 72, 72), (24, 24, 24))
    whole = CorrelatedSample(np.zeros(27), correlate_boxes(boxes, exponent))
    assert 1 / whole.count == pytest.approx(27**-exponent), "V to the power -a"


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_the_deviation_of_overlapping_parts_is_unbiased_with_the_freedom_that_it_says(exponent):
    correlation = correlate_boxes(spread_boxes((80, 80, 80), (40, 40, 40)), exponent)
    draws = np.random.default_rng(0).standard_normal((20000, 27)) @ two_samples._root(correlation).T
    samples = [CorrelatedSample(3 * values, correlation) for values in draws[:4000]]
    variances = np.array([sample.deviation**2 for sample in samples])
    assert variances.mean() == pytest.approx(9, rel=0.03)
    assert 2 * 81 / variances.var() == pytest.approx(samples[0].freedom, rel=0.1)
    assert 1 / draws.mean(axis=1).var() == pytest.approx(samples[0].count, rel=0.05)
    assert np.var(draws, axis=1, ddof=1).mean() < 0.9, "the plain variance is too small"


def test_independent_values_have_the_plain_deviation():
    values = [1.0, 4.0, 2.0, 9.0]
    sample = CorrelatedSample.independent(values)
    assert sample.deviation == pytest.approx(np.std(values, ddof=1))
    assert sample.freedom == pytest.approx(3) and sample.count == pytest.approx(4)
    both = join_blocks([np.ones((2, 2)), np.eye(1)])
    assert both.tolist() == [[1, 1, 0], [1, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("counts", [(4, 6), (24, 27), (9, 40)])
def test_rank_tests_are_scipys_exact_ones(counts, shift):
    rng = np.random.default_rng(7)
    first, second = (rng.normal(size=count) for count in counts)
    first += shift
    tests = RankTests(*(np.eye(count) for count in counts))
    exact = stats.ks_2samp(first, second, method="exact")
    assert two_samples.kolmogorov_smirnov(first, second) == pytest.approx(exact.statistic)
    assert tests.kolmogorov_smirnov(first, second) == pytest.approx(exact.pvalue, abs=0.012)
    exact = stats.mannwhitneyu(first, second, method="exact")
    assert tests.mann_whitney(first, second) == pytest.approx(exact.pvalue, abs=0.012)


def test_statistics_of_equal_values_are_scipys():
    rng = np.random.default_rng(1)
    first, second = rng.integers(0, 5, 12).astype(float), rng.integers(1, 6, 15).astype(float)
    assert two_samples.kolmogorov_smirnov(first, second) == pytest.approx(
        stats.ks_2samp(first, second).statistic
    )
    pairs = stats.mannwhitneyu(first, second).statistic
    assert two_samples.mann_whitney(first, second) == pytest.approx(pairs / (12 * 15) - 0.5)


def test_dependent_parts_of_one_population_are_rejected_as_often_as_said():
    correlation = correlate_boxes(spread_boxes((80, 80, 80), (40, 40, 40)), 0.5)
    rng, root = np.random.default_rng(2), two_samples._root(correlation)
    known, blind = RankTests(np.eye(16), correlation), RankTests(np.eye(16), np.eye(27))
    found = []
    for _ in range(400):
        values = rng.standard_normal(16), root @ rng.standard_normal(27)
        found.append([test.mann_whitney(*values) < 0.05 for test in (known, blind)])
    rate, wrong = np.mean(found, axis=0)
    assert 0.02 < rate < 0.08
    assert wrong > 0.2, "as if parts were independent"


@pytest.mark.parametrize("ratio", [0.4, 0.9, 1.1, 1.8])
def test_spreads_are_compared_by_fishers_distribution(ratio):
    law = stats.f(15, 9.5)
    tail = 2 * min(law.cdf(ratio**2), law.sf(ratio**2))
    assert spread_p(ratio, (15, 9.5)) == pytest.approx(tail)
    low, high = spread_interval(ratio, (15, 9.5), 0.95)
    assert (low, high) == pytest.approx(
        (ratio / law.ppf(0.975) ** 0.5, ratio / law.ppf(0.025) ** 0.5)
    )


@pytest.mark.parametrize("freedom", [1, 2.5, 8, 40, 300])
def test_quantiles_and_tails_are_scipys(freedom):
    for level in (0.75, 0.975, 0.995):
        assert student(freedom, level) == pytest.approx(stats.t.ppf(level, freedom))
        law = stats.f(freedom, 12.5)
        assert variance_ratio(freedom, 12.5, level) == pytest.approx(law.ppf(level))
    for distance in (0.0, 0.3, 2.0, 30.0):
        assert student_tail(freedom, distance) == pytest.approx(2 * stats.t.sf(distance, freedom))
    share = stats.f.cdf(1.5, freedom, 12.5) - stats.f.cdf(1 / 1.5, freedom, 12.5)
    assert variance_ratio_share(freedom, 12.5, 1.5) == pytest.approx(share)


def test_heavy_tails_widen_what_is_known_of_a_spread():
    rng = np.random.default_rng(3)
    normal, heavy = (
        CorrelatedSample.independent(draw(size=200)) for draw in (rng.normal, rng.laplace)
    )
    assert two_samples.tail_share(normal) > 0.8
    # the kurtosis of Laplace's distribution is 6
    assert two_samples.tail_share(heavy) == pytest.approx(0.4, abs=0.2)


def test_means_are_compared_as_welch_does():
    rng = np.random.default_rng(4)
    first, second = rng.normal(0.5, 1, 12), rng.normal(0, 3, 20)
    one, other = CorrelatedSample.independent(first), CorrelatedSample.independent(second)
    freedom = two_samples.welch_freedom((one.error, other.error), (one.freedom, other.freedom))
    found = mean_p(one.mean - other.mean, np.hypot(one.error, other.error), freedom)
    exact = stats.ttest_ind(first, second, equal_var=False)
    assert found == pytest.approx(exact.pvalue)
    assert freedom == pytest.approx(exact.df)


def test_correction_is_scipys():
    values = np.random.default_rng(5).random(20) ** 3
    assert adjust(values) == pytest.approx(stats.false_discovery_control(values))
    assert adjust([0.5]) == [0.5]

"""Pictures with pixels of different sizes: averages, what is left as it is, methods and the
certificate.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError
from trabecula.exemplar.magnification import _means, to_one_magnification
from trabecula.exemplar.views import spacing_of, views_of
from trabecula.measure.smooth import gaussian


def blobs(side, sigma, seed, share=0.35):
    """Return a picture of which `share` is solid, with blobs of some width in pixels."""
    smooth = gaussian(np.random.default_rng(seed).normal(size=(side, side)), sigma)
    return (smooth > np.quantile(smooth, 1 - share)).astype(np.uint8)


def picture(values, edge, **rest):
    return tb.Image(values, "labels", spacing=edge, unit="um", **rest)


@settings(max_examples=30, deadline=None)
@given(st.integers(3, 40), st.floats(1.0, 4.0), st.integers(0, 9))
def test_means_over_areas_are_those_of_fine_parts(side, ratio, seed):
    """As sums over parts of a sixtieth of a pixel, which the ends are rounded to."""
    ratio = round(ratio * 60) / 60
    values = np.random.default_rng(seed).random((side, side + 1))
    found = _means(values, ratio)
    parts = np.kron(values, np.ones((60, 60)))
    length = round(60 * ratio)
    rows, columns = (extent // length for extent in parts.shape)
    kept = parts[: rows * length, : columns * length]
    expected = kept.reshape(rows, length, columns, length).mean(axis=(1, 3))
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_labels_keep_the_fraction_and_the_places():
    coarse = blobs(60, 3.0, 0)
    for factor in (2, 3):
        fine = picture(np.kron(coarse, np.ones((factor, factor), np.uint8)), 1 / factor)
        found, other = to_one_magnification([fine, picture(blobs(60, 3.0, 1), 1.0)])
        np.testing.assert_array_equal(found.values, coarse)
        assert found.spacing == pytest.approx((1.0, 1.0)) and other.values.shape == (60, 60)
        assert found.recipe.steps[-1]["ratio"] == pytest.approx(factor)
    thin = picture(blobs(90, 1.0, 2, share=0.2), 1.0)  # a majority would lose much of it
    found, _ = to_one_magnification([thin, picture(coarse, 2.5)])
    assert found.values.shape == (36, 36)
    assert found.values.mean() == pytest.approx(thin.values.mean(), abs=1e-3)
    three = picture(np.kron([[0, 1], [2, 0]], np.ones((8, 8))).astype(np.uint8), 1.0)
    found, _ = to_one_magnification([three, picture(three.values, 4.0)])
    assert found.values.tolist() == np.kron([[0, 1], [2, 0]], np.ones((2, 2))).tolist()


def test_grey_and_colour_are_means():
    ramp = np.arange(64, dtype=np.uint8).reshape(8, 8)
    grey = tb.Image(ramp, "grey", spacing=1.0)
    found, _ = to_one_magnification([grey, tb.Image(ramp, "grey", spacing=2.0)])
    assert found.values.dtype == np.uint8
    np.testing.assert_array_equal(found.values, np.rint(ramp.reshape(4, 2, 4, 2).mean(axis=(1, 3))))
    colour = tb.Image(np.stack([ramp, ramp + 64, ramp * 0], -1).astype(np.uint8), "colour")
    large = tb.Image(colour.values, "colour", spacing=4.0)
    found, _ = to_one_magnification([colour, large])
    assert found.values.shape == (2, 2, 3) and found.values[0, 0].tolist() == [14, 78, 0]


def test_what_agrees_or_has_other_units_or_long_pixels_is_left_alone():
    values = blobs(40, 2.0, 3)
    same = [picture(values, 1.0), picture(values, 1.0 + 1e-9)]
    units = [picture(values, 1.0), tb.Image(values, "labels", spacing=2.0, unit="mm")]
    long = [picture(values, (1.0, 2.0)), picture(values, (2.0, 1.0))]
    for images in (same, units, long):
        for one, other in zip(to_one_magnification(images), images, strict=True):
            assert one is other


@pytest.mark.whole
def test_methods_make_the_same_of_a_finer_picture_and_its_average():
    coarse = [blobs(48, 2.5, seed) for seed in (4, 5, 6)]
    given = [picture(values, 1.0) for values in coarse]
    finer = [picture(np.kron(coarse[0], np.ones((2, 2), np.uint8)), 0.5), *given[1:]]
    assert spacing_of(views_of(finer)) == pytest.approx((1.0, 1.0, 1.0))
    quick = {"first_rounds": 2, "rounds": (2,)}
    one, other = (
        tb.method("kopf", **quick).fit(images).generate(24, seed=1) for images in (given, finer)
    )
    np.testing.assert_array_equal(one.values, other.values)
    assert other.spacing == pytest.approx((1.0, 1.0, 1.0))


def test_a_finer_picture_that_is_too_small_at_the_others_magnification_is_refused():
    boards = np.kron(np.indices((16, 16)).sum(axis=0) % 2, np.ones((3, 3))).astype(np.uint8)
    small = np.kron(boards[:11, :11], np.ones((4, 4), np.uint8))
    given = [picture(small, 0.25), picture(boards, 1.0), picture(boards, 1.0)]
    with pytest.raises(InputError, match=r"the exemplar is \(11, 11\)"):
        tb.method("kopf").fit(given)


@pytest.mark.whole
def test_the_certificate_compares_at_one_magnification():
    coarse = [blobs(64, 2.5, seed) for seed in (4, 5, 6)]
    given = [picture(values, 1.0) for values in coarse]
    finer = [picture(np.kron(coarse[0], np.ones((2, 2), np.uint8)), 0.5), *given[1:]]
    made = tb.Image(
        np.stack([blobs(48, 2.5, seed) for seed in range(48)]), "labels", spacing=1, unit="um"
    )
    one, other = (tb.verify(images, made, level="quick") for images in (given, finer))
    assert {name: metric.value for name, metric in one.metrics.items()} == {
        name: metric.value for name, metric in other.metrics.items()
    }

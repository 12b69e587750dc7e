"""Thresholds: Otsu's against every threshold there is, two of them against what they should keep,
and what is refused.
"""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.errors import InputError, UnknownNameError
from trabecula.exemplar.segment import otsu


def grey(values, **fields):
    return tb.Image(np.asarray(values), "grey", **fields)


def between_class_variance(values, thresholds):
    """Otsu's criterion from its definition: sum over classes of weight times squared distance of
    the means.
    """
    values = np.asarray(values, float).ravel()
    classes = np.searchsorted(thresholds, values, side="left")
    parts = [values[classes == number] for number in range(len(thresholds) + 1)]
    return sum(
        len(part) / len(values) * (part.mean() - values.mean()) ** 2 for part in parts if len(part)
    )


def best_variance(values, count):
    levels = np.unique(values).astype(float)
    middles = (levels[1:] + levels[:-1]) / 2
    return max(between_class_variance(values, chosen) for chosen in combinations(middles, count))


@pytest.fixture
def bimodal():
    """Two Gaussians of weights 0.7 and 0.3 at 60 and 160, and which voxel is of which."""
    draw = np.random.default_rng(1)
    solid = draw.random((20, 30, 40)) < 0.3
    return np.where(
        solid, draw.normal(160, 12, solid.shape), draw.normal(60, 12, solid.shape)
    ), solid


@pytest.mark.parametrize("dtype", ["u1", "u2", "i2", "f4", "f8"])
def test_two_populations_are_told_apart(bimodal, dtype):
    values, solid = bimodal
    image = tb.segment(
        grey(np.clip(np.rint(values), 0, 255).astype(dtype), spacing=(3, 2, 1), unit="um")
    )
    assert image.kind == "labels" and image.phases == ("void", "solid")
    assert image.spacing == (3.0, 2.0, 1.0) and image.unit == "um"
    np.testing.assert_array_equal(image.values, solid)
    assert 95 < image.recipe.steps[-1]["threshold"] < 125


@pytest.mark.whole
@given(
    arrays.arrays(
        st.sampled_from(["u1", "i2", "f4"]),
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=6),
        elements=st.integers(0, 20),
    )
)
def test_otsu_is_the_best_of_all_thresholds(values):
    assume(np.ptp(values) > 0)
    assert between_class_variance(values, otsu(values)) == pytest.approx(
        best_variance(values, 1), rel=1e-9
    )


@given(arrays.arrays("u1", (4, 5), elements=st.integers(0, 12)))
def test_otsu_of_three_classes_is_the_best_of_all_pairs(values):
    assume(len(np.unique(values)) > 2)
    low, high = otsu(values, classes=3)
    assert low < high
    assert between_class_variance(values, (low, high)) == pytest.approx(
        best_variance(values, 2), rel=1e-9
    )


def test_three_populations_get_a_threshold_in_either_gap():
    draw = np.random.default_rng(2)
    values = np.concatenate([draw.normal(mean, 4, 3000) for mean in (30, 90, 200)])
    low, high = otsu(values, classes=3)
    assert 45 < low < 75 and 110 < high < 185


def test_many_levels_are_binned_finely_enough():
    draw = np.random.default_rng(3)
    values = np.concatenate([draw.normal(0, 1, 4000), draw.normal(7, 1.5, 2000)])
    (found,) = otsu(values)
    score = between_class_variance(values, (found,))
    assert score == pytest.approx(
        max(between_class_variance(values, (t,)) for t in np.linspace(1, 6, 400)), rel=1e-4
    )


def test_few_levels_far_apart_are_not_binned_together():
    values = np.array([[0, 1, 1, 0, 60000]], np.uint16)
    low, high = otsu(values, classes=3)
    assert 0 <= low < 1 <= high < 60000


@pytest.mark.parametrize("offset", [0, 1e3, 1e9])
def test_an_offset_moves_the_threshold_along(bimodal, offset):
    values = np.rint(bimodal[0])
    assert otsu(values + offset)[0] == otsu(values)[0] + offset


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_neighbouring_numbers_are_told_apart(dtype):
    """Their middle rounds down for one pair and up for the next."""
    first = dtype(1)
    for _ in range(2):
        second = np.nextafter(first, dtype(2))
        assert tb.segment(grey([[first, second]])).values.tolist() == [[0, 1]]
        first = second


def test_half_precision_is_no_trap():
    values = np.linspace(-60000, 60000, 10000).astype(np.float16).reshape(100, 100)
    assert tb.segment(grey(values)).values.mean() == pytest.approx(0.5, abs=0.02)


def test_a_threshold_that_is_given_divides_and_is_recorded():
    values = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    image = tb.segment(grey(values), 9.5, phases=("pore", "bone"))
    np.testing.assert_array_equal(image.values, values > 9.5)
    step = image.recipe.steps[-1]
    assert image.phases == ("pore", "bone")
    assert (step["verb"], step["threshold"], step["found_by"], step["phases"]) == (
        "segment",
        9.5,
        "given",
        ["pore", "bone"],
    )
    assert step["sha256"] == digest(image.values)


def test_what_was_found_gives_the_same_when_given(bimodal):
    for way in ("otsu", "dual"):
        found = tb.segment(grey(bimodal[0]), way)
        step = found.recipe.steps[-1]
        assert step["found_by"] == way and np.size(step["threshold"]) == {"otsu": 1, "dual": 2}[way]
        again = tb.segment(grey(bimodal[0]), step["threshold"])
        np.testing.assert_array_equal(again.values, found.values)


@pytest.fixture
def strut():
    """A bright core with a dim strut that hangs on it (by faces), and dim specks that do not."""
    values = np.full((9, 9, 9), 10, np.uint8)
    values[3:6, 3:6, 3:6] = 200
    values[4, 4, 6:9] = 90
    kept = values > 50
    values[0, 0, 0] = values[8, 8, 7:9] = 90
    values[2, 2, 2] = 90  # touches the core by a corner alone
    values[0, 8, 8] = 220  # bright by itself
    kept[0, 8, 8] = True
    return values, kept


def test_two_thresholds_keep_dim_struts_and_drop_dim_specks(strut):
    values, kept = strut
    np.testing.assert_array_equal(tb.segment(grey(values), (50, 150)).values, kept)
    np.testing.assert_array_equal(tb.segment(grey(values), "dual").values, kept)


def test_two_thresholds_lie_between_either_alone(strut):
    draw = np.random.default_rng(4)
    values = draw.normal(100, 30, (12, 12, 12))
    pair, low, high = (
        tb.segment(grey(values), threshold).values for threshold in ((90, 150), 90, 150)
    )
    assert (high <= pair).all() and (pair <= low).all()
    assert high.sum() < pair.sum() < low.sum()
    np.testing.assert_array_equal(tb.segment(grey(values), (90, 90)).values, low)


def test_pictures_are_segmented_too(strut):
    plane = strut[0][4]
    np.testing.assert_array_equal(tb.segment(grey(plane), (50, 150)).values, plane > 50)


@pytest.mark.parametrize(
    ("threshold", "says"),
    [
        (255, r"threshold 255 leaves one phase only: the image runs from 0 to 23"),
        (-1, "leaves one phase only"),
        ((30, 40), "threshold 30, 40 leaves one phase only"),
        ((5, 4), r"should be one finite number, or a pair \(low, high\)"),
        ((1, 2, 3), "should be one finite number"),
        ((), "should be one finite number"),
        (float("nan"), "should be one finite number"),
        ((1, float("inf")), "should be one finite number"),
        (None, "should be a number"),
        ([None], "should be a number"),
        ({}, "should be a number"),
    ],
)
def test_refused_thresholds(threshold, says):
    with pytest.raises(InputError, match=says):
        tb.segment(grey(np.arange(24).reshape(2, 3, 4)), threshold)


def test_refused_ways_and_images():
    values = np.arange(24).reshape(2, 3, 4)
    with pytest.raises(
        UnknownNameError, match="unknown way to find a threshold 'otus': did you mean 'otsu'"
    ):
        tb.segment(grey(values), "otus")
    with pytest.raises(InputError, match=r"one value only \(7\): there is nothing to segment"):
        tb.segment(grey(np.full((3, 3), 7)))
    with pytest.raises(InputError, match="segment takes a grey image, got labels"):
        tb.segment(tb.Image(values % 2, "labels"))
    with pytest.raises(InputError, match="segment takes a grey image, got colour"):
        tb.segment(tb.Image(np.zeros((2, 2, 3), np.uint8), "colour"))
    with pytest.raises(InputError, match="beyond 1e\\+150: rescale"):
        tb.segment(grey([[-1e308, 1.7e308]]))
    with pytest.raises(InputError, match="at least 2 labels"):
        tb.segment(grey(values), 5, phases=("solid",))


def test_the_image_is_left_alone(bimodal):
    values = bimodal[0].copy()
    tb.segment(grey(values), "dual")
    np.testing.assert_array_equal(values, bimodal[0])


def test_a_voxel_at_the_threshold_is_void():
    image = tb.Image(np.array([[4, 5, 6]]), "grey")
    assert tb.segment(image, 5).values.tolist() == [[0, 0, 1]]


def test_the_threshold_lies_in_the_middle_of_the_gap():
    image = tb.Image(np.array([[10, 10, 50, 50, 50]], np.uint8), "grey")
    assert tb.segment(image, "otsu").recipe.steps[-1]["threshold"] == 30

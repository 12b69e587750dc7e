"""Checks and conversions: what they let through, and that each refusal says what was given and what
to do.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trabecula.core.checks import (
    MOST_VOXELS,
    as_seed,
    as_shape,
    as_spacing,
    check_finite,
    check_name,
)
from trabecula.core.errors import InputError, UnknownNameError


def test_a_known_name_passes_and_a_near_one_is_suggested():
    check_name("texture", ["noise", "texture"], name="method")
    with pytest.raises(
        UnknownNameError,
        match=r"unknown method 'textrue': did you mean 'texture'\? known are noise, tex",
    ):
        check_name("textrue", ["texture", "noise"], name="method")


def test_no_name_is_suggested_where_none_is_near():
    with pytest.raises(UnknownNameError) as caught:
        check_name("zzz", ["texture"], name="method")
    assert "did you mean" not in str(caught.value) and "texture" in str(caught.value)
    with pytest.raises(UnknownNameError, match="known are none"):
        check_name("fast", [], name="preset")


def test_a_value_that_is_no_text_is_unknown_too():
    with pytest.raises(UnknownNameError, match=r"unknown kind \['labels'\]"):
        check_name(["labels"], ["labels"], name="kind")


def test_only_floats_can_hold_nan():
    check_finite(np.array([1, 2]), name="it")
    check_finite(np.array([1.5]), name="it")
    with pytest.raises(InputError, match="it holds 2 NaN or infinite values of 3"):
        check_finite(np.array([np.nan, np.inf, 0.0]), name="it")
    with pytest.raises(InputError, match="complex"):
        check_finite(np.array([1j]), name="it")


@pytest.mark.parametrize(
    ("given_shape", "ndim", "shape"),
    [
        (5, 3, (5, 5, 5)),
        ([4], 2, (4, 4)),
        ((1, 2, 3), 3, (1, 2, 3)),
        (np.int16(7), 3, (7,) * 3),
        ([2.0, 3, 4], 3, (2, 3, 4)),
    ],
)
def test_shapes(given_shape, ndim, shape):
    found = as_shape(given_shape, ndim=ndim)
    assert found == shape and all(type(side) is int for side in found)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (0, "must be positive"),
        ((4, -1, 4), "must be positive"),
        ((4, 4), "has 2 numbers: give one"),
        ((), "has 0 numbers"),
        (2.5, "whole numbers"),
        ((4, 4, 4.5), "whole numbers"),
        (float("nan"), "not made of integers"),
        (float("inf"), "not made of integers"),
        ("12", "not made of"),
        (None, "not made of integers"),
        (10**10, "more than 2\\*\\*48 voxels"),
        (10**400, "more than 2\\*\\*48 voxels"),
    ],
)
def test_refused_shapes(value, says):
    with pytest.raises(InputError, match=says):
        as_shape(value)


@given(st.lists(st.integers(1, 2**17), min_size=3, max_size=3))
def test_a_shape_that_passes_can_be_forecast_in_64_bits(sides):
    try:
        shape = as_shape(sides)
    except InputError:
        assert np.prod(sides, dtype=object) > MOST_VOXELS
    else:
        assert int(np.prod(shape, dtype=np.int64)) * 1000 == np.prod(sides, dtype=object) * 1000


@pytest.mark.parametrize(
    ("value", "spacing"),
    [
        (None, (1.0, 1.0, 1.0)),
        (2, (2.0, 2.0, 2.0)),
        ((1, 2, 3), (1.0, 2.0, 3.0)),
        (np.array([0.5, 1.5, 2.5]), (0.5, 1.5, 2.5)),
        (np.float32(0.25), (0.25, 0.25, 0.25)),
    ],
)
def test_spacings(value, spacing):
    assert as_spacing(value, ndim=3) == spacing


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (0, "positive and finite"),
        (-1.0, "positive and finite"),
        (float("nan"), "positive and finite"),
        ((1, 1, float("inf")), "positive and finite"),
        ((1, 2), "has 2 numbers"),
        (1e-30, "outside 1e-20 .. 1e\\+20"),
        (1e30, "outside 1e-20 .. 1e\\+20"),
        ((1, 1, 1e16), r"differs between axes by more than 1e\+15 times"),
        ("fine", "not made of numbers"),
        (1j, "not made of numbers"),
        ((1, None, 1), "not made of numbers"),
    ],
)
def test_refused_spacings(value, says):
    with pytest.raises(InputError, match=says):
        as_spacing(value, ndim=3)


def test_seeds():
    assert as_seed(0) == 0 and as_seed(np.int32(7)) == 7 and as_seed(2**63 - 1) == 2**63 - 1
    for value in (-1, 2**63):
        with pytest.raises(InputError, match=r"outside 0 \.\. 2\*\*63 - 1"):
            as_seed(value)
    for value in (1.0, True, "1", None):
        with pytest.raises(InputError, match="is not an integer"):
            as_seed(value)

"""`Image`: what it takes, what it refuses and how it says so."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb
from trabecula.core.image import (
    MAX_PHASES,
    as_image,
    check_labels,
    default_phases,
    describe_fields,
    distinct_levels,
    phase_index,
    with_values,
)
from trabecula.errors import InputError, UnknownNameError

BINARY = np.array([[[0, 1], [1, 0]], [[1, 1], [0, 0]]])
GREY = np.linspace(0, 1, 24, dtype=np.float32).reshape(2, 3, 4)
RGB = np.zeros((4, 5, 3), np.uint8)


def test_labels_are_kept_as_bytes_with_default_names():
    image = tb.Image(BINARY, "labels")
    assert image.values.dtype == np.uint8 and image.phases == ("void", "solid")
    assert image.spacing == (1.0, 1.0, 1.0) and image.unit == "voxel" and not image.recipe
    assert tb.Image(BINARY == 1, "labels").values.tolist() == BINARY.tolist()


def test_bytes_and_greys_are_not_copied():
    labels = BINARY.astype(np.uint8)
    assert tb.Image(labels, "labels").values is labels
    assert tb.Image(GREY, "grey").values is GREY


@pytest.mark.parametrize(
    ("values", "kind", "ndim", "shape"),
    [
        (BINARY, "labels", 3, (2, 2, 2)),
        (GREY[0], "grey", 2, (3, 4)),
        (RGB, "colour", 2, (4, 5)),
        (RGB[None], "colour", 3, (1, 4, 5)),
    ],
)
def test_colour_is_no_axis(values, kind, ndim, shape):
    image = tb.Image(values, kind)
    assert image.ndim == ndim and image.shape == shape and len(image.spacing) == ndim


def test_three_channels_do_not_make_a_volume_a_picture():
    assert tb.Image(np.zeros((4, 5, 3), np.uint8), "labels").ndim == 3


def test_more_phases_get_names():
    assert tb.Image(BINARY * 3, "labels").phases == ("void", "solid", "phase2", "phase3")
    assert tb.Image(BINARY, "labels", phases=["pore", "carbon", "binder"]).phases == (
        "pore",
        "carbon",
        "binder",
    )
    assert tb.Image(np.zeros((2, 2), int), "labels").phases == ("void", "solid")
    assert default_phases(1) == ("void",)


def test_the_text_of_an_image_says_what_it_is():
    image = tb.Image(BINARY, "labels", (2.5, 1, 1), "um")
    assert repr(image) == "<Image 2x2x2 labels, voxel 2.5x1x1 um, phases void/solid>"


@pytest.mark.parametrize(
    ("values", "kind", "fields", "says"),
    [
        (np.zeros(3, int), "labels", {}, "2 or 3 axes"),
        (np.zeros((2,) * 4, int), "labels", {}, "2 or 3 axes"),
        (np.zeros((0, 2, 2), int), "labels", {}, "the image is empty"),
        (BINARY, "lables", {}, "did you mean 'labels'"),
        (BINARY - 1, "labels", {}, r"got -1\.\.0: use tb.labels"),
        (BINARY * 255, "labels", {}, r"got 0\.\.255: use tb.labels"),
        (BINARY.astype(float), "labels", {}, "segment a grey image"),
        (BINARY == 1, "grey", {}, "a boolean array is labels"),
        (np.array([[np.nan, 1.0]]), "grey", {}, "1 NaN or infinite"),
        (np.array([[np.inf, 1.0]]), "grey", {}, "1 NaN or infinite"),
        (np.array([[1j, 1.0]]), "grey", {}, "complex"),
        (np.array([["a", "b"]]), "grey", {}, "numbers are needed"),
        (np.array([[None, 1]]), "grey", {}, "numbers are needed"),
        ([[1, 2], [3]], "labels", {}, "differ in length"),
        (RGB.astype(float), "colour", {}, "uint8 with 3 channels"),
        (RGB[..., :2], "colour", {}, "uint8 with 3 channels"),
        (BINARY, "labels", {"spacing": 0}, "positive and finite"),
        (BINARY, "labels", {"spacing": (1, 2)}, "has 2 numbers"),
        (BINARY, "labels", {"phases": ("solid",)}, "at least 2 labels"),
        (BINARY * 2, "labels", {"phases": ("a", "b")}, "at least 3 labels"),
        (BINARY, "labels", {"phases": ("a", "a")}, "each name once"),
        (BINARY, "labels", {"phases": "void"}, "one name per label"),
        (GREY, "grey", {"phases": ("a", "b")}, "phases name labels"),
    ],
)
def test_refused(values, kind, fields, says):
    with pytest.raises(InputError, match=says):
        tb.Image(values, kind, **fields)


def test_most_phases():
    assert len(tb.Image(np.arange(MAX_PHASES).reshape(4, 4), "labels").phases) == MAX_PHASES
    with pytest.raises(InputError, match=f"at most {MAX_PHASES - 1}"):
        tb.Image(np.arange(MAX_PHASES + 1).reshape(1, -1), "labels")


def test_an_image_does_not_change():
    image = tb.Image(BINARY, "labels")
    for field in dataclasses.fields(image):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(image, field.name, None)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.int64, np.float32, bool])
def test_levels_become_labels_in_rising_order(dtype):
    values = (
        np.array([[1, 0, 1], [0, 0, 1]], dtype)
        if dtype is bool
        else np.array([[100, 7, 100], [7, 7, 9]], dtype)
    )
    expected = [[1, 0, 1], [0, 0, 1]] if dtype is bool else [[2, 0, 2], [0, 0, 1]]
    image = tb.labels(values, spacing=2, unit="um")
    assert image.values.tolist() == expected and image.values.dtype == np.uint8
    assert image.spacing == (2.0, 2.0) and image.unit == "um"


@given(
    arrays.arrays(
        st.sampled_from(["u1", "u2", "i2", "i8", "f4"]),
        arrays.array_shapes(min_dims=2, max_dims=3, max_side=5),
        elements=st.integers(0, 12),
    )
)
def test_labels_agree_with_unique(values):
    np.testing.assert_array_equal(
        tb.labels(values).values, np.unique(values, return_inverse=True)[1].reshape(values.shape)
    )


def test_levels_that_appear_late_in_a_large_array_are_found():
    values = np.zeros((3, 300, 300), np.int32)
    values[-1, -1, -1] = 5
    assert tb.labels(values).values.sum() == 1
    for dtype in (np.uint8, np.int32, np.float64):
        assert distinct_levels(values.astype(dtype), limit=8).tolist() == [0, 5]
    assert distinct_levels(np.arange(20), limit=8) is None
    late = np.concatenate([np.zeros(70000, np.uint16), np.arange(20, dtype=np.uint16)])
    assert distinct_levels(late, limit=8) is None


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.arange(20).reshape(4, 5), "more than 16 levels"),
        (np.array([[0.5, 1.0]]), r"holds 0\.5: segment it"),
        (np.array([[np.nan, 1.0]]), "NaN"),
        (np.zeros((0, 3)), "empty"),
        (np.array([["a"]]), "numbers are needed"),
    ],
)
def test_arrays_that_are_no_labels(values, says):
    with pytest.raises(InputError, match=says):
        tb.labels(values)


def test_plain_arrays_of_small_integers_are_labels_and_others_are_not_guessed():
    image = tb.Image(GREY, "grey")
    assert as_image(image) is image
    assert as_image(BINARY.tolist()).kind == "labels" and as_image(BINARY == 1).kind == "labels"
    for values in (BINARY * 255, BINARY - 1, GREY):
        with pytest.raises(
            InputError, match=r"the scan is a plain array of \w+ whose meaning is open"
        ):
            as_image(values, name="the scan")


def test_checks_of_kind_and_phase():
    image = tb.Image(BINARY, "labels", phases=("pore", "bone"))
    check_labels(image)
    with pytest.raises(InputError, match="the scan is grey, labels are needed"):
        check_labels(tb.Image(GREY, "grey"), name="the scan")
    assert phase_index(image, "bone", default="pore") == 1
    assert phase_index(image, None, default="pore") == 0
    assert phase_index(image, 1, default="pore") == 1
    with pytest.raises(UnknownNameError, match=r"unknown phase 'bones': did you mean 'bone'"):
        phase_index(image, "bones", default="pore")
    with pytest.raises(UnknownNameError, match="unknown phase 'solid'"):
        phase_index(image, None, default="solid")
    with pytest.raises(InputError, match=r"phase 2 does not exist: the image has 0\.\.1"):
        phase_index(image, 2, default="pore")


def test_other_values_keep_the_rest():
    image = tb.Image(BINARY, "labels", (3, 2, 1), "um", ("pore", "bone"))
    other = with_values(image, 1 - BINARY)
    assert describe_fields(other) == describe_fields(image)
    assert (
        other.values.tolist() == (1 - BINARY).tolist() and image.values.tolist() == BINARY.tolist()
    )
    assert describe_fields(image) == {
        "kind": "labels",
        "spacing": [3.0, 2.0, 1.0],
        "unit": "um",
        "phases": ["pore", "bone"],
        "recipe": [],
    }

"""An image is taken for an array, and is sliced like one."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.core import indexing
from trabecula.core.recipe import Recipe
from trabecula.errors import InputError
from trabecula.pipeline.replay import replay

VALUES = np.arange(4 * 5 * 6, dtype=np.uint16).reshape(4, 5, 6)
GREY = tb.Image(VALUES, "grey", spacing=(2.0, 3.0, 0.1), unit="um")
LABELS = tb.Image(
    (VALUES % 3).astype(np.uint8),
    "labels",
    spacing=(2.0, 3.0, 0.1),
    unit="um",
    phases=("a", "b", "c"),
)
COLOUR = tb.Image(np.zeros((4, 5, 3), np.uint8), "colour", spacing=(2.0, 3.0))


def test_numpy_gets_the_values_themselves():
    assert np.asarray(GREY) is GREY.values and GREY.dtype == np.uint16
    assert np.shares_memory(np.array(GREY, copy=False), VALUES)
    assert not np.shares_memory(np.array(GREY), VALUES), "np.array copies, as it says"
    wide = np.asarray(GREY, dtype=np.float64)
    assert wide.dtype == np.float64 and np.array_equal(wide, VALUES)
    with pytest.raises(ValueError, match="copy"):
        np.asarray(GREY, dtype=np.float64, copy=False)


def test_functions_of_numpy_take_it():
    assert np.mean(GREY) == VALUES.mean() and np.array_equal(np.flip(GREY, 0), VALUES[::-1])
    assert np.array_equal(np.stack([GREY, GREY]), np.stack([VALUES, VALUES]))
    assert np.array_equal(np.asarray(LABELS) == 1, LABELS.values == 1)
    assert np.array_equal(np.add(GREY, 1), VALUES + 1)


def test_the_shape_is_of_space_and_the_array_has_the_channels():
    assert COLOUR.shape == (4, 5) and np.asarray(COLOUR).shape == (4, 5, 3) and len(COLOUR) == 4


def test_what_is_computed_is_an_array():
    for computed, plain in [
        (GREY + 1, VALUES + 1),
        (1 - np.asarray(GREY, float), 1 - VALUES.astype(float)),
        (GREY > 3, VALUES > 3),
        (GREY == 7, VALUES == 7),
        (VALUES != GREY, np.zeros(VALUES.shape, bool)),
        (GREY == VALUES, np.ones(VALUES.shape, bool)),
        (LABELS * GREY, LABELS.values * VALUES),
        (GREY.astype(float), VALUES.astype(float)),
        (GREY.reshape(-1), VALUES.ravel()),
        (GREY.max(axis=0), VALUES.max(axis=0)),
    ]:
        assert type(computed) is np.ndarray and np.array_equal(computed, plain)
    assert GREY.mean() == VALUES.mean() and GREY.size == 120 and GREY.copy() is not VALUES


def test_images_are_equal_where_they_are_the_same_object():
    twin = copy.copy(GREY)
    assert GREY == GREY and (twin == GREY) is False and twin != GREY and (GREY != GREY) is False
    assert GREY != None and (GREY == "grey") is False  # noqa: E711
    assert GREY in [twin, GREY] and twin not in [GREY, LABELS] and len({GREY, LABELS, GREY}) == 2
    assert np.array_equal(pickle.loads(pickle.dumps(GREY)).values, VALUES)


def test_nothing_changes_an_image():
    image = GREY
    with pytest.raises(InputError, match="an Image does not change"):
        image += 1
    with pytest.raises(InputError, match="an Image does not change"):
        np.add(VALUES, 1, out=GREY)
    with pytest.raises(TypeError):
        GREY[0] = 1
    with pytest.raises(AttributeError):
        GREY.sort()
    assert GREY.values is VALUES and VALUES[0, 0, 1] == 1


@pytest.mark.parametrize(
    ("index", "spacing"),
    [
        (np.s_[1:3], (2.0, 3.0, 0.1)),
        (np.s_[...], (2.0, 3.0, 0.1)),
        (np.s_[:, :, ::2], (2.0, 3.0, 0.2)),
        (np.s_[..., 1:4:3], (2.0, 3.0, 0.1 * 3)),
        (np.s_[::-1], (2.0, 3.0, 0.1)),
        (np.s_[3:0:-2, ..., :], (4.0, 3.0, 0.1)),
        (np.s_[2], (3.0, 0.1)),
        (np.s_[:, -1], (2.0, 0.1)),
        (np.s_[..., np.int64(3)], (2.0, 3.0)),
        (np.s_[1:2, 0:5, 5:99], (2.0, 3.0, 0.1)),
    ],
    ids=str,
)
@pytest.mark.parametrize("image", [GREY, LABELS], ids=["grey", "labels"])
def test_a_part_keeps_what_its_voxels_mean(image, index, spacing):
    part = image[index]
    assert (
        np.array_equal(part.values, image.values[index]) and part.values.dtype == image.values.dtype
    )
    assert np.shares_memory(part.values, image.values), "a view, as NumPy's"
    assert part.spacing == spacing and part.shape == image.values[index].shape
    assert (part.kind, part.unit, part.phases) == (image.kind, image.unit, image.phases)


def test_colour_is_no_axis_of_an_index():
    part = COLOUR[1:3, ::2]
    assert part.shape == (2, 3) and part.values.shape == (2, 3, 3) and part.spacing == (2.0, 6.0)
    with pytest.raises(InputError, match="up to 2 indices"):
        COLOUR[:, :, 0]


SIDES = st.integers(-7, 7)
ITEMS = st.one_of(
    SIDES, st.builds(slice, *[st.none() | SIDES] * 2, st.none() | SIDES.filter(bool)), st.just(...)
)


@pytest.mark.whole
@given(st.lists(ITEMS, max_size=4).map(tuple))
def test_an_index_gives_what_numpy_gives_or_is_refused(index):
    try:
        part = GREY[index]
    except InputError as error:
        assert "\n" not in str(error)
        try:
            there = VALUES[index]
        except IndexError:
            return
        assert there.ndim < 2 or there.size == 0
    else:
        assert np.array_equal(part.values, VALUES[index])
        plain = indexing.to_json(indexing.read_index(index, shape=GREY.shape))
        assert np.array_equal(GREY[indexing.from_json(plain)].values, part.values)


@pytest.mark.parametrize(
    ("index", "says"),
    [
        (VALUES > 3, "got ndarray; for a mask, a list or a new axis index the array, image.values"),
        ([0, 1], "got list; for a mask"),
        (True, "got bool"),
        (None, "got NoneType"),
        ("z", "got str"),
        (1.0, "got float"),
        (4, "index 4 is outside the image's 4 voxels along z"),
        (np.s_[:, :, -7], "index -7 is outside the image's 6 voxels along x"),
        (np.s_[:, 5:], "empty: the image has 5 voxels there"),
        (np.s_[::0], "a step other than 0"),
        (np.s_[0.5:], "takes whole numbers"),
        (np.s_[0, 0], "leaves fewer than 2 axes"),
        (np.s_[..., ..., 0], r"one \.\.\."),
        (np.s_[0:1, 0:1, 0:1, 0:1], "up to 3 indices"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_other_indices_are_refused_in_a_line(index, says):
    with pytest.raises(InputError, match=says) as raised:
        GREY[index]
    assert "\n" not in str(raised.value)


def test_a_volume_is_a_row_of_slices():
    assert len(GREY) == 4 and [plane.shape for plane in GREY] == [(5, 6)] * 4
    assert np.array_equal(np.stack(list(GREY)), VALUES)
    with pytest.raises(InputError, match="fewer than 2 axes"):
        list(COLOUR)


def test_a_part_can_be_made_again_from_its_recipe(tmp_path):
    image = tb.read(tb.write(GREY, tmp_path / "x.npy"))
    part = image[::-1, 1:4][:, 0]
    assert [step["verb"] for step in part.recipe.steps] == [
        *(s["verb"] for s in image.recipe.steps),
        "slice",
        "slice",
    ]
    path = tb.write(part, tmp_path / "part.tif")
    again = replay(tb.read(path).recipe, folder=tmp_path)
    assert np.array_equal(again.values, part.values) and again.spacing == part.spacing == (2.0, 0.1)


def test_an_image_without_a_recipe_gets_none():
    assert GREY[1:].recipe == Recipe()


def test_an_image_is_not_taken_for_an_array_where_its_spacing_would_be_lost():
    for take in (lambda: tb.Image(GREY, "grey"), lambda: tb.labels(LABELS)):
        with pytest.raises(InputError, match="an Image is given where its values are wanted"):
            take()

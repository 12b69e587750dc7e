"""Boxes cut out of an image."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.errors import InputError

VALUES = np.arange(4 * 6 * 9).reshape(4, 6, 9) % 3
IMAGE = tb.Image(VALUES, "labels", (3, 2, 1), "um", ("void", "solid", "binder"))


def test_the_box_is_central_unless_a_corner_is_given():
    np.testing.assert_array_equal(tb.crop(IMAGE, (2, 2, 3)).values, VALUES[1:3, 2:4, 3:6])
    np.testing.assert_array_equal(tb.crop(IMAGE, 2).values, VALUES[1:3, 2:4, 3:5])
    np.testing.assert_array_equal(tb.crop(IMAGE, 2, corner=(2, 0, 7)).values, VALUES[2:4, :2, 7:])
    np.testing.assert_array_equal(tb.crop(IMAGE, IMAGE.shape).values, VALUES)


def test_everything_else_stays():
    part = tb.crop(IMAGE, (1, 1, 2), corner=(0, 0, 0))
    assert part.phases == IMAGE.phases and part.spacing == IMAGE.spacing and part.unit == "um"
    assert part.values.flags.c_contiguous
    assert part.recipe.steps[-1] == {
        **part.recipe.steps[-1],
        "verb": "crop",
        "size": [1, 1, 2],
        "corner": [0, 0, 0],
    }
    assert part.recipe.steps[-1]["sha256"] == digest(part.values)


def test_pictures_and_colour():
    colour = np.arange(5 * 6 * 3, dtype=np.uint8).reshape(5, 6, 3)
    part = tb.crop(tb.Image(colour, "colour"), (3, 2))
    np.testing.assert_array_equal(part.values, colour[1:4, 2:4])
    assert part.shape == (3, 2)


@given(st.data())
def test_a_recorded_crop_can_be_done_again(data):
    size = [data.draw(st.integers(1, side)) for side in IMAGE.shape]
    part = tb.crop(IMAGE, size)
    step = part.recipe.steps[-1]
    np.testing.assert_array_equal(
        tb.crop(IMAGE, step["size"], corner=step["corner"]).values, part.values
    )
    assert part.shape == tuple(size)


@pytest.mark.parametrize(
    ("size", "corner", "says"),
    [
        (
            5,
            None,
            r"^a crop of \(5, 5, 5\) does not lie inside the image of \(4, 6, 9\): "
            r"give a smaller one$",
        ),
        (2, (3, 0, 0), r"a crop of \(2, 2, 2\) at \(3, 0, 0\) does not lie inside"),
        (2, (-1, 0, 0), "does not lie inside"),
        (2, (0, 0), "does not lie inside"),
        (0, None, "crop .* must be positive"),
        ((2, 2), None, "crop .* has 2 numbers"),
        (1.5, None, "crop .* whole numbers"),
    ],
)
def test_refused(size, corner, says):
    with pytest.raises(InputError, match=says):
        tb.crop(IMAGE, size, corner=corner)

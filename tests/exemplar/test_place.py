"""Place: a scan in a larger image, and the block where it is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError, UnknownNameError
from trabecula.exemplar.place import as_slab, block, place


@given(st.data())
def test_the_scan_lies_where_it_was_put(data):
    size, before, after = (data.draw(st.tuples(*[st.integers(low, 4)] * 3)) for low in (1, 0, 0))
    scan = tb.Image(
        np.random.default_rng(0).integers(0, 3, size), "labels", (3, 2, 1), "um", ("void", "a", "b")
    )
    shape = tuple(a + n + b for a, n, b in zip(before, size, after, strict=True))
    larger, known = place(scan, shape, corner=before), block(size, shape, corner=before)
    expected = np.pad(np.ones(size, int), list(zip(before, after, strict=True)))
    assert np.array_equal(known.values, expected)
    assert (
        np.array_equal(larger.values[expected == 1], scan.values.ravel())
        and not larger.values[expected == 0].any()
    )
    assert (larger.spacing, larger.unit, larger.phases) == (scan.spacing, scan.unit, scan.phases)


def test_recipes_say_where():
    scan = tb.Image(np.eye(3, dtype=int), "labels")
    assert place(scan, (4, 5), corner=(1, 2)).recipe.steps[-1]["corner"] == [1, 2]
    assert block((3, 3), (4, 5), corner=(1, 2)).recipe.steps[-1]["shape"] == [4, 5]


def test_colour_keeps_its_channels():
    picture = tb.Image(np.full((2, 2, 3), 9, np.uint8), "colour")
    larger = place(picture, 4, corner=(1, 1))
    assert larger.values.shape == (4, 4, 3) and larger.values.sum() == 9 * 12


@pytest.mark.parametrize("corner", [(2, 0, 0), (0, -1, 0), (0, 0, 99)])
def test_a_place_outside_is_refused(corner):
    with pytest.raises(
        InputError, match=r"a scan of \(3, 3, 3\) voxels at .* does not lie inside \(4, 4, 4\)"
    ):
        place(tb.Image(np.ones((3, 3, 3), int), "labels"), 4, corner=corner)
    with pytest.raises(InputError, match="has 2 numbers"):
        block((3, 3, 3), 4, corner=(0, 0))


@pytest.mark.parametrize("plane", ["yx", "zx", "zy", "xy", "xz", "yz"])
def test_a_picture_lies_in_the_plane_of_the_axes_that_are_named(plane):
    picture = tb.Image(np.arange(6).reshape(2, 3), "labels", (5.0, 7.0), "um", tuple("abcdef"))
    corner = (1, 2, 0)
    volume = place(picture, (6, 7, 8), corner=corner, plane=plane, across=3.0)
    rows, columns = ("zyx".index(axis) for axis in plane)
    for (row, column), value in np.ndenumerate(picture.values):
        at = list(corner)
        at[rows] += row
        at[columns] += column
        assert volume.values[tuple(at)] == value
    assert volume.values.sum() == 15
    assert (volume.spacing[rows], volume.spacing[columns]) == (5.0, 7.0) and sorted(
        volume.spacing
    ) == [3.0, 5.0, 7.0]
    known = block(as_slab(picture, plane).shape, (6, 7, 8), corner=corner)
    assert known.values.sum() == 6 and volume.values[known.values == 0].sum() == 0


def test_a_picture_of_colour_stays_colour():
    picture = tb.Image(np.arange(24, dtype=np.uint8).reshape(2, 4, 3), "colour")
    assert np.array_equal(as_slab(picture, "xz").values[:, 0], picture.values.swapaxes(0, 1))


def test_planes_that_are_none_and_volumes_are_refused():
    picture = tb.Image(np.eye(3, dtype=int), "labels")
    with pytest.raises(UnknownNameError, match="view 'zz'"):
        place(picture, (4, 4, 4), corner=(0, 0, 0), plane="zz")
    with pytest.raises(InputError, match="for a picture"):
        place(tb.Image(np.ones((2, 2, 2), int), "labels"), 4, corner=(0, 0, 0), plane="yx")
    with pytest.raises(InputError, match="has 3 numbers"):
        place(picture, (4, 4, 4), corner=(0, 0, 0))

"""Sheets of slices: every voxel at its place in its colour, at a true scale."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError, UnknownNameError
from trabecula.view.looks import LOOKS, phase_colours
from trabecula.view.scale import format_length, round_length
from trabecula.view.slices import montage, slices

TOP = 14  # gap around the panels


def panel(sheet, left, shape, factors):
    """Return the voxels of a panel, after a check that every voxel is a block of one colour."""
    height, width = shape[0] * factors[0], shape[1] * factors[1]
    pixels = sheet.values[TOP : TOP + height, left : left + width]
    blocks = pixels.reshape(shape[0], factors[0], shape[1], factors[1], 3)
    assert (blocks == blocks[:, :1, :, :1]).all()
    return blocks[:, 0, :, 0]


@pytest.fixture
def image():
    values = np.random.default_rng(1).integers(0, 3, (20, 30, 40)).astype(np.uint8)
    return tb.Image(values, "labels", spacing=2.0, unit="um")


def test_the_middle_slices_are_enlarged_by_whole_factors(image):
    sheet, colours = slices(image, side=320), phase_colours(image, LOOKS["bone"])
    left = TOP
    for plane in (image.values[10], image.values[:, 15], image.values[:, :, 20]):
        np.testing.assert_array_equal(panel(sheet, left, plane.shape, (8, 8)), colours[plane])
        left += max(8 * plane.shape[1], 0) + TOP


def test_spacing_gives_voxels_their_shape(image):
    tall = tb.Image(image.values, "labels", spacing=(3.0, 1.0, 1.0))
    colours = phase_colours(tall, LOOKS["bone"])
    sheet = slices(tall, side=320)
    plane = image.values[:, 15]
    np.testing.assert_array_equal(
        panel(sheet, 2 * TOP + 40 * 5, plane.shape, (15, 5)), colours[plane]
    )


def test_unequal_edges_take_the_zoom_that_distorts_least():
    grey = tb.Image(np.zeros((10, 20, 20), np.uint8), "grey", spacing=(2.5, 1, 1))
    sheet = slices(grey, side=75)  # 3 would fit, but 2.5 * 3 is not whole; 2.5 * 2 is
    black = (sheet.values == 0).all(axis=-1)
    rows = np.flatnonzero(black.any(axis=1))
    assert rows[0] == TOP and np.ptp(rows) + 1 == 50


def test_grey_and_colour_are_shown_as_they_are():
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    np.testing.assert_array_equal(
        panel(slices(tb.Image(grey, "grey"), side=64), TOP, (16, 16), (4, 4))[..., 0], grey
    )
    deep = tb.Image(grey.astype(np.uint16) * 100 + 500, "grey")
    np.testing.assert_array_equal(panel(slices(deep, side=64), TOP, (16, 16), (4, 4))[..., 0], grey)
    colour = np.random.default_rng(0).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    np.testing.assert_array_equal(
        panel(slices(tb.Image(colour, "colour"), side=64), TOP, (16, 16), (4, 4)), colour
    )


def test_a_large_image_is_thinned():
    grey = np.random.default_rng(0).integers(0, 256, (1400, 700)).astype(np.uint8)
    sheet = slices(tb.Image(grey, "grey"))
    np.testing.assert_array_equal(panel(sheet, TOP, (467, 234), (1, 1))[..., 0], grey[::3, ::3])


def test_several_slices_an_axis_are_evenly_spaced(image):
    one, three = slices(image, side=160), slices(image, side=160, per_axis=3)
    assert three.shape[0] > 2 * one.shape[0]
    colours = phase_colours(image, LOOKS["bone"])
    left = TOP
    for at in (3, 10, 16):
        np.testing.assert_array_equal(
            panel(three, left, (30, 40), (4, 4)), colours[image.values[at]]
        )
        left += 160 + TOP + int(max(0, _caption_room(at, 20) - 160))


def _caption_room(at, length):
    from trabecula.view.picture import font
    from trabecula.view.slices import _LETTERS

    return int(font(_LETTERS).getlength(f"z = {at} of {length}")) + 90


def test_the_bar_below_a_panel_is_as_long_as_it_says(image):
    sheet = slices(image, side=320)  # 8 pixels are 2 um
    ink = (sheet.values == (40, 44, 52)).all(axis=-1)
    below = ink[TOP + 30 * 8 :, TOP : TOP + 320]
    longest = max(below.sum(axis=1))
    assert longest in [length * 4 for length in (1, 2, 5, 10, 20, 50)]


def test_a_montage_shows_all_at_one_scale(tmp_path):
    values = np.random.default_rng(0).integers(0, 2, (40, 40, 40)).astype(np.uint8)
    whole, crop = tb.Image(values, "labels"), tb.Image(values[:20, :20, :20], "labels")
    sheet = montage([whole, crop], ["exemplar", "crop"], tmp_path / "both.png", side=160)
    colours = phase_colours(whole, LOOKS["bone"])
    first = sheet.values[TOP + 24 : TOP + 24 + 160, TOP : TOP + 160][::4, ::4]
    np.testing.assert_array_equal(first, colours[values[20]])
    below = TOP + 24 + 160 + 38 + TOP + 24
    np.testing.assert_array_equal(
        sheet.values[below : below + 80, TOP : TOP + 80][::4, ::4], colours[values[10, :20, :20]]
    )
    read = tb.read(tmp_path / "both.png")
    np.testing.assert_array_equal(read.values, sheet.values)
    step = read.recipe.to_json()[-1]
    assert step["verb"] == "montage" and len(step["images"]) == 2


def test_the_same_image_gives_the_same_bytes(image, tmp_path):
    first, second = tmp_path / "a.png", tmp_path / "b.png"
    slices(image, first)
    slices(image, second)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    ("limit", "length"),
    [(1, 1), (1.99, 1), (2, 2), (4.9, 2), (5, 5), (99, 50), (100, 100), (0.07, 0.05)],
)
def test_round_lengths(limit, length):
    assert round_length(limit) == pytest.approx(length)


@pytest.mark.parametrize(
    ("length", "unit", "text"),
    [
        (1, "voxel", "1 voxel"),
        (50, "voxel", "50 voxels"),
        (2000, "um", "2 mm"),
        (0.5, "mm", "0.5 mm"),
        (2000, "voxel", "2000 voxels"),
    ],
)
def test_lengths_in_words(length, unit, text):
    assert format_length(length, unit) == text


@pytest.mark.parametrize(
    ("options", "message"), [({"per_axis": 0}, "per_axis"), ({"side": 3}, "side")]
)
def test_numbers_out_of_range_are_refused(image, options, message):
    with pytest.raises(InputError, match=message):
        slices(image, **options)


def test_a_montage_needs_a_name_for_each(image):
    with pytest.raises(InputError, match="1 images, 2 names"):
        montage([image], ["a", "b"])


def test_an_unknown_look_suggests_the_nearest(image):
    with pytest.raises(UnknownNameError, match="did you mean 'bread'"):
        slices(image, look="braed")

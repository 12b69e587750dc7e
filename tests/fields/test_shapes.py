"""Drawn fields, other grids and other ranges."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.errors import InputError, UnknownNameError


@pytest.mark.parametrize("axis", ["z", "y", "x", 0, -1])
def test_a_ramp_runs_along_its_axis_alone(axis):
    field = fields.ramp((5, 6, 7), axis=axis, start=0.8, end=0.2).values
    along = "zyx".index(axis) if isinstance(axis, str) else axis % 3
    line = np.moveaxis(field, along, 0)
    assert np.all(line == line[:, :1, :1])
    assert np.allclose(line[:, 0, 0], np.linspace(0.8, 0.2, field.shape[along]))


def test_distances_count_in_the_unit():
    fine = fields.radial((1, 20, 40), inside=0, outside=1, radius=10, spacing=(1, 1.0, 0.5))
    z, y, x = np.indices((1, 20, 40))
    far = np.hypot(np.hypot(y + 0.5 - 10, (x + 0.5) * 0.5 - 10), z)
    assert np.allclose(fine.values, np.minimum(far / 10, 1), atol=1e-6)


def test_a_cylinder_is_the_same_all_along():
    field = fields.radial((6, 9, 9), inside=0.1, outside=0.9, axis="z").values
    assert (
        np.all(field == field[:1])
        and field[0, 4, 4] == pytest.approx(0.1)
        and field[0, 0, 0] == pytest.approx(0.9)
    )


def test_a_formula_sees_positions_and_sides():
    field = fields.formula((4, 6, 8), "z / Z + 10 * y + 100 * X", spacing=(1, 2, 3))
    z, y, _ = np.indices((4, 6, 8))
    assert np.allclose(field.values, (z + 0.5) / 4 + 10 * (2 * y + 1) + 100 * 24)
    with pytest.raises(InputError, match=r"no finite value at voxel \(0, 0\)"):
        fields.formula((3, 3), "log(y - 1)")
    with pytest.raises(UnknownNameError, match="'z'"):
        fields.formula((3, 3), "z")


@pytest.mark.parametrize("axis", ["z", "y", "x"])
def test_a_picture_is_seen_along_its_axis(axis):
    drawn = np.zeros((4, 4), np.uint8)
    drawn[:2], drawn[2:, 2:] = 255, 51
    field = fields.picture(drawn, (8, 8, 8), low=0.2, high=0.7, axis=axis).values
    face = np.moveaxis(field, "zyx".index(axis), 0)
    assert np.all(face == face[:1])
    assert (face[0, 0, 0], face[0, -1, 0], face[0, -1, -1]) == pytest.approx(
        (0.7, 0.2, 0.3), abs=1e-6
    )


def test_pictures_of_floats_and_colours():
    ends = {"low": 0.0, "high": 1.0}
    assert np.allclose(
        fields.picture(np.array([[3.0, 5.0, 7.0]]), (1, 3), **ends).values, [[0, 0.5, 1]]
    )
    colour = tb.Image(np.full((2, 2, 3), (0, 255, 0), np.uint8), "colour")
    assert np.allclose(fields.picture(colour, (2, 2), **ends).values, 1 / 3)
    with pytest.raises(InputError, match="one slice"):
        fields.picture(np.zeros((2, 2, 2)), (2, 2, 2), **ends)


def test_resampling_keeps_planes_and_the_box():
    field = fields.formula((8, 6, 10), "0.1 * z + 0.2 * y - 0.3 * x")
    finer = fields.resample(field, (32, 24, 20))
    assert finer.spacing == (0.25, 0.25, 0.5)
    expected = fields.formula((32, 24, 20), "0.1 * z + 0.2 * y - 0.3 * x", spacing=finer.spacing)
    inside = (slice(2, -2), slice(2, -2), slice(1, -1))
    assert np.allclose(finer.values[inside], expected.values[inside], atol=1e-5)
    assert finer.values.min() >= field.values.min() and finer.values.max() <= field.values.max()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: fields.ramp((3, 3, 3, 3), start=0, end=1), "has 4 numbers"),
        (lambda: fields.ramp(3, axis="w", start=0, end=1), "give one of z, y, x"),
        (lambda: fields.ramp(3, start=np.nan, end=1), "start=nan is outside"),
        (lambda: fields.ramp(3, start="0", end=1), "should be a number"),
        (lambda: fields.radial(3, inside=0, outside=1, radius=0), "radius"),
        (lambda: fields.radial(3, inside=0, outside=1, centre=(1, 1)), "give 3"),
        (lambda: fields.rescale(np.zeros((3, 3)), low=0, high=1), "grey Image"),
        (lambda: fields.rescale(fields.ramp(3, start=0, end=1), low=2, high=1), "exchange"),
        (lambda: fields.resample(fields.ramp(3, start=0, end=1), (2, 2)), "give one"),
    ],
)
def test_what_is_no_field_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_cylinder_reaches_the_nearest_side_whatever_its_length():
    short, long = (
        fields.radial((length, 21, 31), axis="z", inside=0, outside=1).values for length in (4, 50)
    )
    assert np.array_equal(short[0], long[0])
    assert short[0, 10, 15] == 0 and short[0, 0, 15] == pytest.approx(10 / 10.5)

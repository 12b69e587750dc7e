"""Thicken: rods and plates of known thickness grow to the target; thick regions and their
corners stay.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.finish import OPERATIONS, thicken
from trabecula.finish.struts import balls, thin_cores
from trabecula.measure import local_thickness


def report(image):
    return image.recipe.steps[-1]["report"]


def rod(radius, axis=2, shape=(32, 32, 32), centre=15.6):
    a, b = (grid - centre for k, grid in enumerate(np.indices(shape)) if k != axis)
    return a**2 + b**2 < radius**2


@pytest.mark.parametrize("radius", [1, 1.5, 2, 2.6])
@pytest.mark.parametrize("thickness", [6, 7.5, 9])
def test_a_rod_grows_to_the_thickness_asked_for(radius, thickness):
    thick = thicken(rod(radius), thickness=thickness).values == 1
    middle = 2 * np.sqrt(thick[:, :, 16].sum() / np.pi)
    assert thickness - 0.6 <= middle <= thickness + 1.7
    assert (thick | ~rod(radius)).all()


@pytest.mark.parametrize("voxels", [1, 2, 3, 4])
@pytest.mark.parametrize("thickness", [5, 6, 8])
def test_a_plate_grows_to_within_a_voxel(voxels, thickness):
    plate = np.zeros((24, 20, 20), bool)
    plate[10 : 10 + voxels] = True
    depth = thicken(plate, thickness=thickness).values[:, 10, 10].sum()
    assert thickness - 1 <= depth <= thickness + 1


def test_thickness_is_in_the_units_of_the_image():
    wire = rod(1.5)
    fine = thicken(tb.Image(wire, "labels", spacing=0.05, unit="mm"), thickness=0.4)
    assert np.array_equal(fine.values, thicken(wire, thickness=8).values)
    flat = tb.Image(rod(2, axis=0, shape=(12, 32, 32)), "labels", spacing=(3, 1, 1))
    assert thicken(flat, thickness=8).values[6].sum() == pytest.approx(np.pi * 16, rel=0.35)
    # Across slices of 3 a rod of 9 is 3 voxels deep.
    lying = np.zeros((15, 15, 40), bool)
    lying[7, 7] = True
    deep = thicken(tb.Image(lying, "labels", spacing=(3, 1, 1)), thickness=9).values[:, :, 20]
    assert deep[:, 7].sum() == 3 and deep[7].sum() in (9, 10)


def test_thick_parts_and_their_corners_stay():
    cube = np.zeros((34, 34, 34), bool)
    cube[7:27, 7:27, 7:27] = True
    z, y, x = np.indices((34,) * 3) - 16.5
    for part in (cube, z**2 + y**2 + x**2 < 13**2, np.abs(z) + np.abs(y) + np.abs(x) < 15):
        thick = thicken(part, thickness=7)
        assert np.count_nonzero(thick.values != part) == 0 and report(thick)["thin_before"] == 0


def test_only_the_waist_of_an_hourglass_grows():
    z, y, x = np.indices((48, 48, 49)) - 23.5
    glass = y**2 + z**2 < (2 + ((x - 0.5) / 8) ** 2) ** 2
    thick = thicken(glass, thickness=8).values
    areas, before = thick.sum(axis=(0, 1)), glass.sum(axis=(0, 1))
    assert 2 * np.sqrt(areas[24] / np.pi) == pytest.approx(8, abs=1.2)
    far = 2 * np.sqrt(before / np.pi) > 9
    assert np.array_equal(areas[far], before[far])


def test_a_strut_on_a_block_grows_and_the_block_does_not():
    part = np.zeros((30, 30, 50), bool)
    part[5:25, 5:25, 2:20] = True
    part[14:16, 14:16, 20:48] = True
    thick = thicken(part, thickness=8).values == 1
    assert np.array_equal(thick[:, :, :16], part[:, :, :16])
    assert 2 * np.sqrt(thick[:, :, 35].sum() / np.pi) == pytest.approx(8, abs=1.2)


@settings(max_examples=40)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=3, max_side=9)), st.floats(0.5, 5)
)
def test_what_always_holds(solid, thickness):
    if not solid.any() or thickness > max(solid.shape):
        return
    before = solid.copy()
    part = thicken(solid, thickness=thickness)
    told = report(part)
    assert np.array_equal(solid, before) and np.all(part.values >= solid)
    assert part.values.sum() == solid.sum() + told["added"]
    assert 0 <= told["thin_after"] <= 1 and told["rounds"] <= 4


def test_less_than_a_voxel_changes_nothing():
    noise = np.random.default_rng(0).random((12, 12, 12)) < 0.4
    assert np.array_equal(thicken(noise, thickness=1).values, noise)


def test_labels_and_closed_phases():
    values = np.zeros((20, 20, 40), np.uint8)
    values[9:11, 9:11, :20], values[9:11, 9:11, 20:] = 1, 2
    values[12:] = 3
    image = tb.Image(values, "labels", phases=("void", "a", "b", "wall"))
    part = thicken(image, thickness=7, phase="a").values
    assert np.array_equal(part[12:], values[12:]) and np.array_equal(part == 2, values == 2)
    assert (part == 1)[:, :, 10].sum() > 20
    joint = thicken(
        tb.Image(np.where(values == 3, 0, values), "labels", phases=("void", "a", "b")), thickness=7
    ).values
    assert set(np.unique(joint[:, :, :19])) == {0, 1} and set(np.unique(joint[:, :, 21:])) == {0, 2}


def test_two_dimensions():
    line = np.zeros((30, 30), bool)
    line[15] = True
    assert thicken(line, thickness=5).values[:, 15].sum() == 5


def test_balls_are_the_voxels_within_the_radius():
    rng = np.random.default_rng(0)
    places, radius = rng.integers(0, 12, (5, 3)), rng.random(5) * 5
    grid = np.indices((12, 12, 12)).reshape(3, -1).T * (2, 1, 0.5)
    expected = np.zeros(12**3, bool)
    for place, reach in zip(places * (2, 1, 0.5), radius, strict=True):
        expected |= np.linalg.norm(grid - place, axis=1) <= reach
    found = balls(places, radius, (12, 12, 12), (2, 1, 0.5))
    assert np.array_equal(found.ravel(), expected)
    with tb.threads(3):
        assert np.array_equal(balls(places, radius, (12, 12, 12), (2, 1, 0.5)), found)


def test_the_share_of_thin_struts_is_known():
    """Thicken rods of 4 and of 12 voxels to 8: all of the first is thin, nothing of the other."""
    slim, stout = rod(2, shape=(32, 64, 32)), np.roll(rod(6, shape=(32, 64, 32)), 32, axis=1)
    cores = thin_cores(slim | stout, (1.0,) * 3, 8.0)
    assert cores.share == pytest.approx(slim.sum() / (slim | stout).sum(), rel=1e-9)
    assert cores.thinnest == pytest.approx(4, abs=0.75)
    assert thin_cores(stout, (1.0,) * 3, 8.0).share == 0


@pytest.mark.parametrize("level", [0.47, 0.53])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (2.0, 1.0, 1.5)])
@pytest.mark.parametrize("thickness", [3.0, 5.5, 9.0])
def test_cores_are_those_of_the_local_thickness(level, spacing, thickness):
    """Compare both branches of the search, for mostly thick and for mostly thin phases."""
    rough = ndimage.gaussian_filter(np.random.default_rng(0).random((24, 26, 28)), 2, mode="wrap")
    solid = rough > np.quantile(rough, level)
    image = tb.Image(solid, "labels", spacing=spacing)
    diameter = local_thickness(image)
    depth = ndimage.distance_transform_edt(solid, sampling=spacing)
    thin = solid & (diameter < thickness - 0.502) & (depth >= 0.75 * (diameter + 0.5) / 2)
    found = thin_cores(solid, spacing, thickness)
    assert np.array_equal(found.places, np.argwhere(thin))
    np.testing.assert_allclose(found.depth, depth[thin], rtol=1e-6)
    np.testing.assert_allclose(found.aside, ((diameter + 0.5) / 2 - depth)[thin], atol=1e-5)


def test_the_recipe_replays():
    part = thicken(rod(1.5), thickness=6)
    step = part.recipe.steps[-1]
    assert OPERATIONS[step["operation"]](rod(1.5), **step["settings"]).recipe.steps[-1] == step


@pytest.mark.parametrize("thickness", [0, -1, 33, float("nan"), "thick"])
def test_lengths_that_make_no_sense_are_refused(thickness):
    with pytest.raises(InputError, match="thickness"):
        thicken(rod(2), thickness=thickness)


def test_an_empty_phase_is_refused():
    with pytest.raises(InputError, match="nothing to thicken"):
        thicken(np.zeros((4, 4, 4), int), thickness=2)


def test_real_bone(data):
    import tifffile

    bone = tifffile.imread(data / "trabecular_bone_a.tif")[:60, :60, :60] > 0
    image = tb.finish.connect(tb.Image(bone, "labels", spacing=0.05, unit="mm"))
    part = thicken(image, thickness=0.25)
    assert report(part)["thin_before"] > 0.5 and report(part)["thin_after"] < 0.02
    thin = np.percentile(local_thickness(part)[part.values == 1], 5)
    assert thin > 0.19 > np.percentile(local_thickness(image)[image.values == 1], 20)

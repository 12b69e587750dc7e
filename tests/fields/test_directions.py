"""Fields of directions: what is refused, where poles and jumps are, and how they are averaged."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.core.directions import Directions, find_jumps
from trabecula.core.errors import InputError
from trabecula.core.request import Request

SHAPE = (6, 7, 8)


def radial(shape=SHAPE):
    """Directions away from the z axis through the middle, where there is none."""
    places = np.indices(shape) - (np.array(shape) // 2)[:, None, None, None]
    places[0] = 0
    return np.moveaxis(places, 0, -1).astype(np.float32)


def test_lengths_and_signs_do_not_matter_and_unit_vectors_stay_bit_for_bit():
    request = Request(SHAPE, target={"orientation": (0, 3, 4)})
    assert request.target["orientation"].tolist() == pytest.approx([0, 0.6, 0.8])
    once = Directions(np.random.default_rng(1).normal(size=(*SHAPE, 3)))
    assert np.array_equal(Directions(once.values).values, once.values)
    np.testing.assert_allclose(np.linalg.norm(once.values, axis=-1), 1, rtol=1e-6)


def test_nan_is_named_with_its_place():
    values = np.ones((*SHAPE, 3))
    values[2, 3, 4, 1] = np.nan
    with pytest.raises(InputError, match=r"NaN or infinite at 1 of 336 places .*z y x 2 3 4"):
        Request(SHAPE, target={"orientation": values})


def test_poles_are_counted_inside_the_mask_alone():
    with pytest.raises(InputError, match=r"no direction at 6 of 336 voxels .*z y x 0 3 4"):
        Request(SHAPE, target={"orientation": radial()})
    mask = np.ones(SHAPE, bool)
    mask[:, 3, 4] = False
    assert Request(SHAPE, target={"orientation": radial()}, mask=mask).is_tied


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((0, 0, 0), "0 along every axis"),
        ((1, 0), "2 numbers: give 3"),
        (np.ones((3, 3, 3, 3)), r"shape \(3, 3, 3, 3\)"),
        ("up", "no field of vectors"),
        (tb.Image(np.ones(SHAPE, np.float32), "grey"), "is an image"),
    ],
)
def test_what_is_no_direction_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        Request(SHAPE, target={"orientation": given})


@pytest.mark.parametrize("size", [0.0, -1.0, 9.0])
def test_a_size_is_above_nought(size):
    with pytest.raises(InputError, match="target size"):
        Request(SHAPE, target={"size": size})


def test_one_direction_is_written_into_the_recipe_and_ties_nothing():
    request = Request(SHAPE, target={"orientation": (0, 0, 2), "size": 1.5})
    assert request.to_json()["target"] == {"orientation": [0.0, 0.0, 1.0], "size": 1.5}
    assert not request.is_tied and not request.origins


def test_jumps_are_where_the_direction_turns():
    values = np.zeros((*SHAPE, 3))
    values[:3, ..., 0], values[3:, ..., 2] = 1, 1
    values[0] *= -1  # the sign is free
    jumps = find_jumps(values, None, degrees=45)
    assert jumps[2].all() and np.count_nonzero(jumps) == 56


def test_a_field_is_continued_into_its_poles():
    found = fields.continue_directions(radial())
    assert found.values[:, 3, 4].any(axis=-1).all()
    known = radial().any(axis=-1)
    np.testing.assert_allclose(
        np.abs((found.values * Directions(radial()).values).sum(-1))[known], 1, rtol=1e-5
    )


def test_opposite_directions_average_to_themselves():
    values = np.zeros((8, 8, 8, 3))
    values[..., 1] = np.where(np.indices((8, 8, 8)).sum(0) % 2, 1, -1)
    for found in (
        fields.smooth_directions(values, sigma=2),
        fields.resample_directions(values, (4, 5, 6)),
    ):
        np.testing.assert_allclose(np.abs(found.values[..., 1]), 1, rtol=1e-5)


def test_weights_decide_between_directions():
    values = np.zeros((4, 4, 8, 3))
    values[:, :, :4, 0] = values[:, :, 4:, 2] = 1
    heavy = np.where(np.arange(8) < 4, 100.0, 1.0) * np.ones((4, 4, 8))
    found = fields.smooth_directions(values, sigma=3, weights=heavy).values
    assert (np.abs(found[:, :, 4, 0]) > 0.9).all()


def test_rods_have_the_fabric_of_their_axis(tmp_path):
    rods = np.zeros((24, 24, 24), np.uint8)
    rods[::6, :, ::6] = rods[1::6, :, 1::6] = 1
    found, degree = fields.fabric_directions(rods, size=12)
    assert found.shape == (2, 2, 2, 3) and (np.abs(found[..., 1]) > 0.99).all()
    assert (degree > 0.9).all()
    off = fields.direction_errors(rods, (0, 1, 1), size=12)
    np.testing.assert_allclose(off, 45, atol=3)
    ways = fields.direction_formula((24, 24, 24), ("0", "1", "0"))
    np.save(tmp_path / "ways.npy", ways.values)
    again = fields.read_directions(tmp_path / "ways.npy")
    assert again.recipe.steps[-1]["verb"] == "read_directions"
    assert fields.direction_errors(rods, again, size=12).max() < 3

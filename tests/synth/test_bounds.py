"""How far known voxels are taken to be from an interface."""

import numpy as np
import pytest

from trabecula.synth.shared.content.bounds import distance_bounds

SHAPE = (1, 1, 24)


def bounds(values, known, *, thin=False, least=0.7):
    shaped = np.reshape(values, SHAPE), np.reshape(known, SHAPE)
    low, high = distance_bounds(*shaped, [1], (1.0,) * 3, thin=thin, least=least)
    return low[0, 0, 0], high[0, 0, 0]


@pytest.fixture(scope="module")
def line():
    """Solid from voxel 4 to the end, known up to voxel 15."""
    place = np.arange(SHAPE[2])
    return (place >= 4).astype(np.uint8), place < 16


def test_far_from_what_is_unknown_a_distance_is_exact(line):
    low, high = bounds(*line)
    np.testing.assert_allclose(low[4:10], np.arange(6) + 0.5)
    np.testing.assert_allclose(high[4:10], np.arange(6) + 0.5)


def test_beside_unknown_voxels_it_is_at_least_seven_tenths_of_the_farthest(line):
    low, high = bounds(*line)
    np.testing.assert_allclose(high[12:16], np.arange(8, 12) + 0.5)
    np.testing.assert_allclose(low[14:16], 0.7 * high[14:16])
    assert (low[10:16] >= 0.7 * high[10:16] - 1e-6).all()


def test_without_a_least_the_nearest_unknown_voxel_bounds_it(line):
    low, _ = bounds(*line, least=0.0)
    np.testing.assert_allclose(low[10:16], [5.5, 4.5, 3.5, 2.5, 1.5, 0.5])


def test_the_other_side_is_bounded_alike(line):
    values, known = line
    low, high = bounds(1 - values, known)
    np.testing.assert_allclose(-high[4:16], bounds(values, known)[0][4:16])
    np.testing.assert_allclose(-low[4:16], bounds(values, known)[1][4:16])


def test_unknown_voxels_have_no_bounds(line):
    low, high = bounds(*line)
    assert (low[16:] == -1e4).all() and (high[16:] == 1e4).all()


def test_thin_slices_are_bounded_by_the_farthest_alone(line):
    low, high = bounds(*line, thin=True)
    np.testing.assert_allclose(low[5:16], 0.5 * high[5:16])

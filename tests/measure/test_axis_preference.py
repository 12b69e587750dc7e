"""Lines along the axes against lines along the diagonals."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import axis_preference, covariance_form, two_point


def balls(seed, side=64, *, count=60, radius=6):
    """Draw overlapping balls: isotropic but for voxels and chance."""
    rng, values = np.random.default_rng(seed), np.zeros((side,) * 3, np.uint8)
    grid = np.indices(values.shape)
    for centre in rng.uniform(0, side, (count, 3)):
        values |= ((grid - centre[:, None, None, None]) ** 2).sum(axis=0) < radius**2
    return values


def rods(seed, side=64, *, count=40):
    """Draw bars along the three axes, and nothing oblique."""
    rng, values = np.random.default_rng(seed), np.zeros((side,) * 3, np.uint8)
    for n in range(count):
        size = np.full(3, 6)
        size[n % 3] = 48
        first = rng.integers(-10, side, 3)
        values[tuple(slice(max(0, a), a + s) for a, s in zip(first, size, strict=True))] = 1
    return values


def test_rods_along_the_axes_raise_it_and_balls_do_not():
    assert axis_preference(balls(0)) < 0.15 < 0.5 < axis_preference(rods(0))
    middle = balls(1)[32]
    assert axis_preference(middle) < 0.5 * axis_preference(
        np.indices((64, 64)).sum(axis=0) // 4 % 2
    )


def test_it_is_the_norm_that_it_says():
    values = balls(2, 28)[:20, :, :24]
    axial = np.mean([two_point(values, r_max=10, axis=axis) for axis in range(3)], axis=0)
    ways = [(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)]
    diagonal = covariance_form(
        np.mean([two_point(values, r_max=7, direction=way) for way in ways], axis=0)
    )
    there = np.interp(np.arange(8) * np.sqrt(2), np.arange(11), covariance_form(axial))
    expected = np.linalg.norm((there - diagonal)[1:]) / np.linalg.norm((there + diagonal)[1:] / 2)
    assert (
        axis_preference(values, r_max=10)
        == axis_preference(values, r_max=99)
        == pytest.approx(expected)
    )


def test_turning_and_mirroring_do_not_matter():
    values = rods(3, 30)
    found = axis_preference(values, r_max=12)
    for other in (values.transpose(2, 0, 1), values[::-1], values[:, ::-1, ::-1]):
        assert axis_preference(other, r_max=12) == pytest.approx(found)
    assert axis_preference(1 - values, r_max=12) == pytest.approx(found, rel=0.1), (
        "but for what faces cut"
    )


@pytest.mark.parametrize(
    ("image", "r_max", "words"),
    [
        (tb.Image(np.eye(9, dtype=int), "labels", spacing=(1, 2)), 4, "differ"),
        (np.eye(3, dtype=int), 4, "at least 4"),
        (np.eye(9, dtype=int), 1, "outside 2"),
        (tb.Image(np.eye(9), "grey"), 4, "labels are needed|grey"),
    ],
)
def test_what_cannot_be_compared_is_refused(image, r_max, words):
    with pytest.raises(InputError, match=words):
        axis_preference(image, r_max=r_max)

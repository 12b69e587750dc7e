"""Streamlines: straight ones in a slit, walls that none crosses, the same along every axis."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.measure import streamlines


def test_lines_in_a_slit_are_straight_and_as_fast_as_the_parabola():
    slit = np.pad(np.zeros((12, 8, 6), np.uint8), ((0, 0), (2, 2), (0, 0)), constant_values=1)
    lines = streamlines(slit, axis=0, count=40, tolerance=1e-6)
    assert len(lines) == 40
    for line in lines:
        np.testing.assert_allclose(line[:, 1:3], np.tile(line[0, 1:3], (len(line), 1)), atol=1e-3)
        assert line[0, 0] == pytest.approx(0, abs=0.01) and line[-1, 0] == pytest.approx(12, abs=1)
        row = np.floor(line[0, 1]) - 2 + 0.5
        # y (8 - y) + 1 / 4 solves the scheme on 8 rows; its mean over them is 11
        assert line[:, 3] == pytest.approx((row * (8 - row) + 0.25) / 11, rel=1e-3)


@pytest.mark.whole
def test_lines_stay_in_the_pores_and_go_from_face_to_face():
    image = tb.crop(tb.sample("bone"), 20)
    lines = streamlines(image, axis=1, count=25, phase="void")
    assert len(lines) == 25
    for line in lines:
        voxels = np.clip(np.floor(line[:, :3]).astype(int), 0, 19)
        assert (image.values[tuple(voxels.T)] == 0).all()
        assert line[0, 1] < 0.1 and line[-1, 1] > 19
        assert np.linalg.norm(np.diff(line[:, :3], axis=0), axis=1).max() < 1.1


def test_lines_turn_with_the_image():
    values = (np.random.default_rng(4).random((9, 8, 7)) < 0.25).astype(np.uint8)
    own = streamlines(values, axis=2, count=6, tolerance=1e-6)
    turned = streamlines(np.moveaxis(values, 2, 0), axis=0, count=6, tolerance=1e-6)
    for one, other in zip(own, turned, strict=True):
        np.testing.assert_allclose(one, other[:, [1, 2, 0, 3]], atol=1e-4)


def test_what_lets_nothing_through_has_no_lines():
    values = np.zeros((6, 6, 6), np.uint8)
    values[3] = 1
    assert streamlines(values, axis=0) == []
    with pytest.raises(InputError, match="fills the image"):
        streamlines(np.zeros((6, 6, 6), np.uint8), axis=0)
    with pytest.raises(InputError, match="of volumes"):
        streamlines(values[0], axis=0)
    with pytest.raises(InputError, match="count"):
        streamlines(values, axis=0, count=0)

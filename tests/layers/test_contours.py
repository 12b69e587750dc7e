"""Contours close, turn the right way, and hold the area."""

import numpy as np
import pytest

from trabecula.layers.contours import find_contours, signed_area


def test_a_ring_has_an_outline_and_a_hole():
    y, x = np.indices((40, 40)) - 19.5
    ring = ((y**2 + x**2 < 15**2) & (y**2 + x**2 > 6**2)).astype(np.float32)
    lines = find_contours(ring)
    areas = sorted(signed_area(line) for line in lines)
    assert len(lines) == 2 and areas[0] < 0 < areas[1]
    assert abs(sum(areas) / ring.sum() - 1) < 0.01


def test_solid_on_a_diagonal_is_separated_and_a_full_layer_has_its_border():
    assert len(find_contours(np.eye(2, dtype=np.float32))) == 2
    (line,) = find_contours(np.ones((3, 4), np.float32))
    assert line.min(axis=0).tolist() == [0, 0] and line.max(axis=0).tolist() == [4, 3]


def test_no_contours_of_nothing():
    assert find_contours(np.zeros((3, 4), np.float32)) == []


def test_shares_place_the_line_between_pixels():
    (line,) = find_contours(np.array([[0.75]], np.float32))
    # a third of the way from the centre of a pixel of .75 to that of one of 0
    assert line[:, 0].max() - 0.5 == pytest.approx(1 / 3)


def test_random_layers_close_everywhere():
    layer = (np.random.default_rng(0).random((30, 31)) < 0.5).astype(np.float32)
    lines = find_contours(layer)
    for line in lines:
        steps = np.abs(np.diff(np.concatenate([line, line[:1]]), axis=0))
        assert steps.max() <= 1 and (steps.sum(axis=1) > 0).all()
    # an even number of crossings on every row of pixel centres
    assert abs(sum(signed_area(line) for line in lines) - layer.sum()) < 0.05 * layer.size

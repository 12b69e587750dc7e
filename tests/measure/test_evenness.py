"""Local figures and trends: known truths, symmetry, and the same cells from slabs as from the
whole.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure import evenness
from trabecula.measure.evenness import depth_of, trends, window_means, windows_for
from trabecula.measure.streaming.cells import CellSums, cells_of


def noise(shape, share=0.3, seed=0):
    return (np.random.default_rng(seed).random(shape) < share).astype(np.uint8)


def test_white_noise_has_the_variance_of_its_windows():
    """Compare with independent voxels: the mean over n of them has variance phi (1 - phi) / n."""
    found = evenness(noise((96, 96, 96)), windows=[8, 16, 24])
    for spread, n in zip(found.fraction, (8, 16, 24), strict=True):
        assert spread.edge == n and spread.mean == pytest.approx(0.3, abs=0.003)
        assert spread.deviation == pytest.approx(np.sqrt(0.21 / n**3), rel=0.15)
        assert spread.kurtosis == pytest.approx(3, abs=0.8)
    assert all(abs(change) < 0.01 for change in found.trend.values())


def test_window_means_are_the_literal_means():
    values = np.random.default_rng(1).random((5, 6, 7))
    found = window_means(values, (2, 3, 4))
    assert found.shape == (4, 4, 4)
    literal = [
        [[values[z : z + 2, y : y + 3, x : x + 4].mean() for x in range(4)] for y in range(4)]
        for z in range(4)
    ]
    assert np.allclose(found, literal)


def test_a_ramp_is_a_trend_along_its_axis_and_a_hollow_one_to_the_centre():
    place = (np.arange(64) + 0.5) / 64
    ramp = np.random.default_rng(2).random((64, 64, 64)) < (0.2 + 0.4 * place)[:, None, None]
    found = evenness(ramp.astype(np.uint8)).trend
    assert found["z"] == pytest.approx(0.4, abs=0.01)
    assert all(abs(found[axis]) < 0.02 for axis in ("y", "x", "centre"))
    hollow = np.random.default_rng(3).random((64, 64, 64)) < 0.5 - 0.4 * depth_of((64, 64, 64))
    found = evenness(hollow.astype(np.uint8)).trend
    assert found["centre"] == pytest.approx(-0.4, abs=0.02)
    assert all(abs(found[axis]) < 0.02 for axis in "zyx")


def test_turning_the_image_turns_the_trends_and_nothing_else():
    image = noise((48, 56, 64)) * (np.arange(48) % 2 == 0)[:, None, None].astype(np.uint8)
    image[:24] = 0
    found = evenness(image, windows=[8, 16])
    turned = evenness(np.ascontiguousarray(image.transpose(2, 0, 1)), windows=[8, 16])
    assert [turned.trend[axis] for axis in "zyx"] == pytest.approx(
        [found.trend[axis] for axis in "xzy"]
    )
    for name in ("fraction", "surface", "direction"):
        here, there = (
            [(s.deviation, s.lowest, s.highest) for s in getattr(e, name)] for e in (found, turned)
        )
        assert np.allclose(here, there)


def test_plates_face_one_axis_and_half_of_them_turned_spread_in_direction():
    plates = np.zeros((64, 64, 64), np.uint8)
    plates[::2] = 1
    found = evenness(plates, windows=[16])
    assert found.direction[0].deviation == 0 and found.direction[0].highest == 1
    mixed = plates.copy()
    mixed[32:] = np.swapaxes(plates, 0, 2)[32:]
    assert evenness(mixed, windows=[16]).direction[0].deviation > 0.5
    assert evenness(mixed, windows=[16]).fraction[0].deviation < 1e-9


def test_cells_do_not_depend_on_slabs():
    image = tb.Image(noise((50, 41, 45)), "labels", spacing=(1.0, 2.0, 3.0), unit="um")
    whole = cells_of(image)
    for depth in (1, 3, 7, 50):
        sums = CellSums(image.shape, image.spacing, 2)
        for first in range(0, 50, depth):
            sums.add(
                tb.Image(image.values[first : first + depth], "labels", phases=("void", "solid"))
            )
        found = sums.result()
        assert np.array_equal(found.shares, whole.shares) and np.array_equal(
            found.faces, whole.faces
        )
    assert whole.shape == (12, 10, 11) and whole.extents == (48.0, 80.0, 132.0)


def test_a_checkerboard_has_all_its_faces():
    z, y, x = np.indices((16, 16, 16))
    board = tb.Image(((z + y + x) % 2).astype(np.uint8), "labels", spacing=0.5)
    cells = cells_of(board)
    assert np.allclose(cells.faces, 2.0) and np.allclose(cells.shares, 0.5)


def test_grey_and_colour_by_their_values():
    values = noise((64, 64, 64)) * 100
    grey = evenness(tb.Image(values.astype(np.uint8), "grey"), windows=[16])
    labels = evenness(noise((64, 64, 64)), windows=[16])
    assert grey.fraction[0].deviation == pytest.approx(100 * labels.fraction[0].deviation)
    assert grey.surface[0].deviation == pytest.approx(labels.surface[0].deviation)
    colour = tb.Image(np.stack([values[0]] * 3, -1).astype(np.uint8), "colour")
    assert set(evenness(colour, windows=[16]).trend) == {"y", "x", "centre"}


def test_windows_follow_the_correlation_length_and_the_shortest_side():
    fine, coarse = noise((96, 96, 96)), np.kron(noise((16, 16, 16)), np.ones((6, 6, 6), np.uint8))
    small, large = (windows_for(tb.Image(each, "labels", spacing=2.0)) for each in (fine, coarse))
    assert (
        len(small) == len(large) == 3
        and small[0] < large[0]
        and large[-1] == pytest.approx(0.4 * 96 * 2)
    )
    assert max(windows_for(tb.Image(coarse, "labels", spacing=2.0), shortest=100)) == pytest.approx(
        40
    )


def test_trends_of_a_plane_have_two_axes():
    assert set(trends(np.random.default_rng(0).random((1, 8, 9)))) == {"y", "x", "centre"}


def test_what_is_too_small_is_refused():
    with pytest.raises(tb.errors.InputError, match="at least 8"):
        evenness(np.zeros((4, 20, 20), np.uint8))
    with pytest.raises(tb.errors.InputError, match="does not fit"):
        evenness(noise((20, 20, 20)), windows=[40])

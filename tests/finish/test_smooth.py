"""Smooth: the same volume, less roughness, other phases unchanged."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.finish import OPERATIONS, smooth
from trabecula.measure import specific_surface


def report(image):
    return image.recipe.steps[-1]["report"]


def ball(radius=12, side=32):
    z, y, x = np.indices((side,) * 3) - (side - 1) / 2
    return z**2 + y**2 + x**2 < radius**2


def test_a_rough_ball_becomes_a_ball_again():
    rough = ball() ^ ((np.random.default_rng(0).random((32,) * 3) < 0.15) & ball(14) & ~ball(10))
    even = smooth(rough, sigma=2)
    assert even.values.sum() == pytest.approx(rough.sum(), abs=8)
    ideal = ball((rough.sum() * 3 / (4 * np.pi)) ** (1 / 3))
    assert np.count_nonzero(even.values != ideal) < 0.25 * np.count_nonzero(rough != ideal)
    assert specific_surface(even) < 0.8 * specific_surface(rough)


@pytest.mark.parametrize("spacing", [(1, 1, 1), (2, 1, 0.5)])
def test_it_is_the_gaussian_of_the_field_cut_at_its_volume(spacing):
    solid = ndimage.gaussian_filter(np.random.default_rng(1).random((20, 24, 40)), 1.5) > 0.5
    part = smooth(tb.Image(solid, "labels", spacing=spacing, unit="um"), sigma=1.5)
    level = ndimage.gaussian_filter(
        solid.astype(float), [1.5 / edge for edge in spacing], mode="nearest", truncate=6
    )
    expected = level >= np.sort(level.ravel())[-solid.sum()]
    # The kernel is cut at 3.5 sigma: voxels at the very level may fall either way.
    assert np.count_nonzero(expected != part.values) < 0.002 * solid.size
    assert part.values.sum() == solid.sum() and part.unit == "um"


@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=8)), st.floats(0.3, 2)
)
def test_what_always_holds(solid, sigma):
    if not solid.any():
        return
    before = solid.copy()
    part = smooth(solid, sigma=sigma)
    told = report(part)
    assert np.array_equal(solid, before)
    assert part.values.sum() == solid.sum() + told["added"] - told["removed"]
    assert told["added"] == np.count_nonzero((part.values == 1) & ~solid)
    flipped = smooth(solid[::-1], sigma=sigma)
    assert np.array_equal(flipped.values, part.values[::-1])
    if solid.all():
        assert np.array_equal(part.values, solid)


def test_voxels_of_one_level_come_and_go_together():
    cross = np.zeros((9, 9), bool)
    cross[4, 1:8] = cross[1:8, 4] = True
    part = smooth(cross, sigma=1.5).values
    for turn in range(4):
        assert np.array_equal(np.rot90(part, turn), part)
    assert 1 <= part.sum() <= cross.sum() + 8


def test_new_voxels_take_the_nearest_label_and_closed_phases_stay():
    values = np.zeros((12, 24), np.uint8)
    values[4:8, :12], values[4:8, 12:] = 1, 2
    values[8, 3], values[3, 20], values[4, 8], values[7, 16] = 1, 2, 0, 0
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    both = smooth(image, sigma=1).values
    assert (both[4:8, :12] == 1).all() and (both[4:8, 12:] == 2).all() and both[8, 3] == 0
    alone = smooth(image, sigma=1, phase="a")
    assert np.array_equal(alone.values == 2, values == 2) and alone.values[4, 8] == 1


def test_the_recipe_replays():
    part = smooth(ball(6, 16), sigma=1.25)
    step = part.recipe.steps[-1]
    assert OPERATIONS[step["operation"]](ball(6, 16), **step["settings"]).recipe.steps[-1] == step


@pytest.mark.parametrize("sigma", [0, -1, 17, float("nan"), "wide"])
def test_lengths_that_make_no_sense_are_refused(sigma):
    with pytest.raises(InputError, match="sigma"):
        smooth(ball(6, 16), sigma=sigma)


def test_refusals():
    with pytest.raises(InputError, match="nothing to smooth"):
        smooth(np.zeros((4, 4, 4), int), sigma=1)
    with pytest.raises(InputError, match="open which phase"):
        smooth(
            tb.Image(np.eye(4, dtype=int), "labels", phases=("void", "a", "b")),
            sigma=1,
            phase="void",
        )


def test_smoothing_a_phase_takes_nothing_of_another():
    """Binder lies deep in the solid, where the smoothed solid is far above its level."""
    values = np.zeros((12, 16, 16), np.uint8)
    values[:6], values[3, 8, 8] = 1, 2
    image = tb.Image(values, "labels", phases=("void", "solid", "binder"))
    made = smooth(image, sigma=1.5, phase="solid").values
    assert np.array_equal(made == 2, values == 2)

"""The Euler number from parallel sections."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import disector_along, disector_euler_density, euler_density


def coarse(seed: int, side: int = 40, *, grain: int = 4) -> np.ndarray:
    """Return cubes of `grain` voxels, half of them solid."""
    few = np.random.default_rng(seed).integers(0, 2, (side // grain,) * 3, np.uint8)
    for axis in range(3):
        few = few.repeat(grain, axis)
    return few


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("phase", ["solid", "void"])
def test_neighbouring_slices_say_the_euler_number_itself(axis, phase):
    """By the Euler number of a union, layer by layer, against cubes of eight voxels."""
    values = np.random.default_rng(axis).integers(0, 2, (9, 11, 13), np.uint8)
    image = tb.Image(values, "labels", spacing=(2.0, 2.0, 2.0), unit="um")
    found = disector_along(image, gap=1, axis=axis, phase=phase)
    assert found == pytest.approx(euler_density(image, phase=phase))


def test_sections_further_apart_say_the_same_as_long_as_bodies_are_thicker():
    image = tb.Image(coarse(3, 80), "labels")
    truth = euler_density(image)
    for gap in (2, 3):
        found = np.mean([disector_along(image, gap=gap, axis=axis) for axis in range(3)])
        assert found == pytest.approx(truth, rel=0.35), "cubes of 4 lie on a grid"
    assert disector_along(image, gap=8) != pytest.approx(truth, rel=0.35)


def test_a_ball_begins_and_ends():
    z, y, x = np.ogrid[:40, :40, :40]
    ball = ((z - 20) ** 2 + (y - 20) ** 2 + (x - 20) ** 2 < 50).astype(np.uint8)
    for gap in (1, 2, 5):
        found = disector_along(ball, gap=gap)
        pairs, area = 40 - gap, 39 * 39
        assert found * pairs * gap * area == pytest.approx(gap)


def test_a_list_of_sections_is_pairs_of_neighbours():
    values = coarse(5)
    sections = [tb.Image(values[z], "labels", spacing=(0.5, 0.5)) for z in (4, 7, 10)]
    pairs = [disector_euler_density(sections[n : n + 2], gap=3) for n in (0, 1)]
    assert disector_euler_density(sections, gap=3) == pytest.approx(np.mean(pairs))
    voxels = disector_euler_density([section.values for section in sections], gap=3)
    assert disector_euler_density(sections, gap=3) == pytest.approx(voxels / 0.5**3)


def test_sections_that_do_not_fit_each_other_are_refused():
    one = tb.Image(coarse(1)[0], "labels")
    with pytest.raises(InputError, match="two or more"):
        disector_euler_density([one], gap=3)
    with pytest.raises(InputError, match="gap=0"):
        disector_euler_density([one, one], gap=0)
    with pytest.raises(InputError, match="register and crop"):
        disector_euler_density([one, tb.crop(one, (30, 40))], gap=3)
    with pytest.raises(InputError, match="nearer to each other"):
        disector_euler_density([one, one], gap=40)
    wide = tb.Image(one.values, "labels", spacing=(1.0, 2.0))
    with pytest.raises(InputError, match="squares"):
        disector_euler_density([wide, wide], gap=3)
    with pytest.raises(InputError, match="got a volume"):
        disector_euler_density([coarse(1), coarse(1)], gap=2)
    with pytest.raises(InputError, match="one spacing"):
        disector_euler_density([one, tb.Image(one.values, "labels", spacing=2.0)], gap=2)
    with pytest.raises(InputError, match="one spacing"):
        disector_euler_density([one, tb.Image(one.values, "labels", unit="um")], gap=2)
    with pytest.raises(InputError, match="more than 50 slices"):
        disector_along(coarse(1), gap=50)

"""What speaks against parallel sections of a material that is alike from all sides."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.exemplar.sections import sections_apart


def cloud(seed: int, *, widths=(4, 4, 4)) -> np.ndarray:
    """Return a Gaussian field of 24 x 96 x 96."""
    sides = (24, 96, 96)
    waves = np.meshgrid(*map(np.fft.fftfreq, sides), indexing="ij")
    damped = np.exp(
        -sum((np.pi * width * wave) ** 2 for width, wave in zip(widths, waves, strict=True))
    )
    noise = np.fft.fftn(np.random.default_rng(seed).standard_normal(sides))
    return np.fft.ifftn(noise * damped).real


def labels(values: np.ndarray) -> list[tb.Image]:
    return [tb.Image((each > 0).astype(np.uint8), "labels") for each in values]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gap", [1, 2, 3])
def test_nothing_speaks_against_sections_of_an_isotropic_material(seed, gap):
    field = cloud(seed)
    assert sections_apart(labels(field[3 : 4 + 2 * gap : gap]), gap) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_gap_is_named_with_the_one_that_fits(seed):
    found = sections_apart(labels(cloud(seed)[[3, 8]]), 2)
    assert any(f"that of {lag} pixels" in found for lag in (4, 5, 6))
    assert "2 pixels apart" in found and "check the gap" in found


def test_sections_that_are_not_registered_and_directions_show():
    field = cloud(0)
    lower, upper = field[3], np.roll(field[5], 6, axis=1)
    assert "registered" in sections_apart(labels(np.stack([lower, upper])), 2)
    long = cloud(1, widths=(10, 3, 3))
    assert "alike" in sections_apart(labels(long[[3, 6]]), 3)


def test_grey_values_and_three_phases():
    field = cloud(2)
    spread = (field - field.min()) / np.ptp(field)
    grey = [tb.Image((255 * each).astype(np.uint8), "grey") for each in spread]
    assert sections_apart([grey[3], grey[5]], 2) is None
    assert sections_apart([grey[3], grey[9]], 2) is not None
    phases = ("void", "a", "b")
    three = [
        tb.Image(np.digitize(each, (0.4, 0.6)).astype(np.uint8), "labels", phases=phases)
        for each in spread
    ]
    assert sections_apart([three[3], three[5]], 2) is None
    assert sections_apart([three[3], three[9]], 2) is not None


def test_a_phase_alone_says_nothing():
    one = tb.Image(np.ones((30, 30), np.uint8), "labels")
    assert sections_apart([one, one], 3) is None

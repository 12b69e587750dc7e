"""What speaks against parallel sections of a material that is alike from all sides."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.exemplar.sections import gap_contradiction


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
    assert gap_contradiction(labels(field[3 : 4 + 2 * gap : gap]), gap) is None


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_gap_is_named_with_the_one_that_fits(seed):
    found = gap_contradiction(labels(cloud(seed)[[3, 8]]), 2)
    assert any(f"that of {lag} px" in found for lag in (4, 5, 6))
    assert found.startswith("points 2 px apart")


def test_sections_that_are_not_registered_and_directions_show():
    field = cloud(0)
    lower, upper = field[3], np.roll(field[5], 40, axis=1)
    found = gap_contradiction(labels(np.stack([lower, upper])), 2)
    assert found is not None and "that of" not in found, "at no distance in particular"
    same = gap_contradiction(labels(field[[3, 3]]), 2)
    assert "1.00 is that of 0 px" in same
    long = cloud(1, widths=(10, 3, 3))
    assert gap_contradiction(labels(long[[3, 6]]), 3) is not None
    assert gap_contradiction(labels(long[3:7:3].swapaxes(1, 2)), 3) is not None


def test_small_sections_of_coarse_material_are_given_the_doubt():
    """40 pixels hold few bodies: by chance alone they correlate more from section to section."""
    small = [labels(cloud(seed, widths=(6, 6, 6))[[4, 6], :40, :40]) for seed in range(12)]
    assert sum(gap_contradiction(each, 2) is not None for each in small) <= 1
    assert gap_contradiction(labels(cloud(0, widths=(6, 6, 6))[[4, 12]]), 2) is not None


def test_phases_go_by_their_names():
    one, other = labels(cloud(3)[[4, 6]])
    swapped = tb.Image(1 - other.values, "labels", phases=other.phases[::-1])
    assert gap_contradiction([one, swapped], 2) is None


def test_grey_values_and_three_phases():
    field = cloud(2)
    spread = (field - field.min()) / np.ptp(field)
    grey = [tb.Image((255 * each).astype(np.uint8), "grey") for each in spread]
    assert gap_contradiction([grey[3], grey[5]], 2) is None
    assert gap_contradiction([grey[3], grey[9]], 2) is not None
    phases = ("void", "a", "b")
    three = [
        tb.Image(np.digitize(each, (0.4, 0.6)).astype(np.uint8), "labels", phases=phases)
        for each in spread
    ]
    assert gap_contradiction([three[3], three[5]], 2) is None
    assert gap_contradiction([three[3], three[9]], 2) is not None


def test_a_phase_alone_says_nothing():
    one = tb.Image(np.ones((30, 30), np.uint8), "labels")
    assert gap_contradiction([one, one], 3) is None

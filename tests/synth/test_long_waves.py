"""Long waves: known spreads, waves that are put in and taken out, and results as even as their
exemplar.
"""

import pickle

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine import memmap
from trabecula.measure.evenness import evenness
from trabecula.synth.shared.content.fields import FULL, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import match_votes
from trabecula.synth.shared.statistics.long_waves import (
    LongWaves,
    adjust_long_waves,
    long_waves_of,
    wave_stages,
)
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.two_point import correlations_of
from trabecula.synth.shared.statistics.two_point_steps import two_point_step
from trabecula.testing.peak import peak_bytes

AROUND = (True, True, True)
SOFTNESS = 50.0
SIDE = 48


def smooth(shape, seed):
    """A wrapping random field in int8, smooth over a few voxels."""
    field = np.random.default_rng(seed).standard_normal((1, *shape))
    for axis in (1, 2, 3, 1, 2, 3):
        field = field + np.roll(field, 1, axis) + np.roll(field, -1, axis)
    return np.clip(np.rint(field / field.std() * 50), -FULL, FULL).astype(np.int8)


def window_means(field, width):
    """Means of the soft indicator over all windows of a field that wraps, shift by shift."""
    values = np.clip(field[0] / SOFTNESS + 0.5, 0, 1)
    for axis in range(3):
        values = np.mean(
            [np.roll(values, k, axis) for k in range(-(width // 2), width - width // 2)], axis=0
        )
    return values


def deviation(field, width=17):
    return window_means(field, width).std()


def match(field):
    """What makes a field of votes, with the histogram of `field`."""
    histograms, region = (Histogram.of(field),), Region(field.shape[1:], AROUND)
    return lambda votes: match_votes(region, votes, histograms)


EVEN = smooth((SIDE,) * 3, 1)
WAVE = np.rint(30 * np.sin(2 * np.pi * np.arange(SIDE) / SIDE)).astype(np.int8)[:, None, None]
HOLLOW = np.clip(EVEN.astype(int) + WAVE, -FULL, FULL).astype(np.int8)


def spread_of(field, widths=(9, 17)):
    """The spread of a field that wraps, as a target."""
    means = [window_means(field, width) for width in widths]
    bands = [(means[0] - means[1]).var(), means[1].var()]
    return LongWaves(widths, np.array([[m.var() for m in means]]), np.array([bands]), SOFTNESS)


def adjusted(field, target):
    votes = votes_of(field)
    adjust_long_waves(votes, target, match(field))
    return votes


def test_the_spread_of_noise_is_known():
    """Independent voxels: p (1 - p) over the window's volume; and a window twice as wide has an
    eighth.
    """
    noise = np.where(np.random.default_rng(0).random((1, 60, 60, 60)) < 0.3, FULL, -FULL).astype(
        np.int8
    )
    waves = long_waves_of([noise], 0, softness=1.0)
    assert waves.widths == (11, 21)
    assert waves.variances[0, 0] == pytest.approx(0.21 / 11**3, rel=0.25)
    wider = waves.extend(200)
    assert wider.widths == (11, 21, 43, 87)
    assert np.all(wider.variances[0, 1:] <= wider.variances[0, :-1] / 4)
    assert np.allclose(wider.bands.sum(), wider.variances[0, 0], rtol=0.3), (
        "bands add up to the smallest window's"
    )


def test_a_long_wave_is_taken_out_and_the_rest_stays():
    even, hollow = deviation(EVEN), deviation(HOLLOW)
    assert hollow > 2.5 * even
    left = match(HOLLOW)(adjusted(HOLLOW, spread_of(EVEN)))
    assert 0.8 * even < deviation(left) < 1.25 * even, "neither hollow nor flattened"
    before, after = (np.corrcoef(field.ravel(), EVEN.ravel())[0, 1] for field in (HOLLOW, left))
    assert after > max(before, 0.93)


def test_a_wave_of_the_exemplars_own_is_put_in():
    """An exemplar that is uneven is not evened."""
    left = match(EVEN)(adjusted(EVEN, spread_of(HOLLOW)))
    assert deviation(left) > 1.5 * deviation(EVEN)


@pytest.mark.parametrize("field", [EVEN, HOLLOW])
def test_a_spread_within_the_band_is_left_alone(field):
    target = spread_of(field)
    just_above = LongWaves(target.widths, 1.1 * target.variances, 1.1 * target.bands, SOFTNESS)
    assert np.array_equal(adjusted(field, just_above), votes_of(field))


def test_windows_that_do_not_fit_are_not_looked_at():
    small = HOLLOW[:, :16, :16, :16]
    votes = votes_of(small)
    adjust_long_waves(votes, spread_of(EVEN, widths=(9, 17)), match(small))
    assert np.array_equal(votes, votes_of(small))


def test_the_fraction_stays_where_it_is():
    votes = adjusted(HOLLOW, spread_of(EVEN))
    made = match(HOLLOW)(votes)
    assert abs((made > 0).mean() - (HOLLOW > 0).mean()) < 2e-3


def test_threads_change_nothing():
    made = []
    for count in (1, 2, 3):
        with tb.threads(count):
            made.append(adjusted(HOLLOW, spread_of(EVEN)))
    assert all(np.array_equal(votes, made[0]) for votes in made[1:])


def test_scratch_files_change_nothing(tmp_path):
    whole = adjusted(HOLLOW, spread_of(EVEN))
    with memmap.map_large_arrays(tmp_path, memory=1 << 16, thickest=5):
        assert np.array_equal(adjusted(HOLLOW, spread_of(EVEN)), whole)


def test_memory_is_what_was_forecast():
    field = smooth((88, 80, 84), 2)
    votes, matched, target = votes_of(field), match(field), spread_of(EVEN)
    adjust_long_waves(votes.copy(), target, matched)
    most = peak_bytes(lambda: adjust_long_waves(votes, target, matched))
    forecast = max(stage.peak for stage in wave_stages(field.shape))
    tables = 3 << 19  # counts of ranks, and what they are mapped to
    assert forecast / 1.5 < most < forecast + tables


@pytest.mark.parametrize("period", [48, 24, 8])
def test_a_convolution_without_long_waves(period):
    """What is left of a wave: 1 less the squared mean of a box over it, sin(pi w / l) / (w sin(pi /
    l)).
    """
    wave = np.sin(2 * np.pi * np.arange(SIDE) / period)[:, None, None] * np.ones((SIDE,) * 3)
    pairs = Pairs((SIDE,) * 3, 2, AROUND)
    spectrum, weights = pairs.forward(wave.astype(np.float32)), np.array([1.0] + [0.0] * 8)
    left = (
        pairs.convolve(spectrum, weights, shorter_than=17).std()
        / pairs.convolve(spectrum, weights).std()
    )
    box = np.sin(np.pi * 17 / period) / (17 * np.sin(np.pi / period))
    assert left == pytest.approx(1 - box**2, abs=1e-4)


@pytest.mark.whole
def test_a_step_with_long_waves_of_its_own_raises_them_less():
    """Asked for more at all long distances, a step lifts the longest wave; it leaves alone what is
    longer than twice a window.
    """
    target = correlations_of([EVEN], softness=SOFTNESS, r_max=12)
    r = np.arange(target.curves.shape[1]) % 13
    lifted = np.where(r >= 8, 2e-3, 0.0)
    found = {}
    spread = spread_of(EVEN)
    for name, waves in (("without", None), ("with", spread.extend(2 * spread.widths[0]))):
        aim = type(target)(
            target.curves + lifted, target.softness, target.edges, target.held, waves
        )
        field = EVEN
        for _ in range(2):
            field = match(EVEN)(two_point_step(field, aim, periodic=AROUND))
        found[name] = deviation(field)
    even = deviation(EVEN)
    assert found["with"] - even < 0.75 * (found["without"] - even)


@pytest.mark.whole
@pytest.mark.slow
def test_results_are_as_even_as_bone():
    """Over windows of 20 voxels; without long waves held seed 1 is at 2.2 times the exemplar's
    spread, seed 2 at 1.45.
    """
    bone = tb.crop(tb.sample("bone"), 48)
    own = evenness(bone, windows=[20 * bone.spacing[0]]).fraction[0].deviation
    model = tb.method("texture").fit(bone)
    for seed in (1, 2):
        made = (
            evenness(model.generate(96, seed=seed), windows=[20 * bone.spacing[0]])
            .fraction[0]
            .deviation
        )
        assert 0.7 * own < made < 1.4 * own


def test_targets_survive_pickling():
    target = spread_of(EVEN)
    assert np.array_equal(pickle.loads(pickle.dumps(target)).bands, target.bands)

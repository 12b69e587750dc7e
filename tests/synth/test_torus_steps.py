"""Steps on a torus in one direction: against direct sums, the pairs of `two_point_steps`, and what
is known.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.statistics.pairs import DIAGONAL, LINES, Pairs
from trabecula.synth.shared.statistics.torus_steps import (
    Doubled,
    TorusPairs,
    torus_step,
    torus_step_stages,
)
from trabecula.synth.shared.statistics.two_point import BlockMeans, correlations_of
from trabecula.synth.shared.statistics.two_point_steps import (
    accumulate_debt,
    misfit,
    two_point_step,
)
from trabecula.testing.peak import peak_bytes

AROUND = (True, True, True)


def smooth(shape, seed, *, channels=1, radius=2):
    """A wrapping random field in int8, smooth over a few voxels."""
    noise = np.random.default_rng(seed).standard_normal((channels, *shape))
    for axis in (1, 2, 3):
        for _ in range(radius):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, -1, axis)
    return np.clip(np.rint(noise / noise.std() * 50), -FULL, FULL).astype(np.int8)


def rounded(votes):
    return np.clip(np.rint(votes / UNIT), -FULL, FULL).astype(np.int8)


def test_the_slope_is_the_weighted_sum_around_in_every_direction():
    values = np.random.default_rng(1).random((9, 10, 11)).astype(np.float32)
    pairs = TorusPairs(values.shape, 2, AROUND, directions=DIAGONAL)
    weights = np.random.default_rng(2).normal(size=pairs.bins)
    bins = {}  # the two offsets of a pair have one bin
    for (z, y, x), place in np.ndenumerate(pairs.places):
        offset = np.array((z, y - pairs.reach[1], x - pairs.reach[2]))
        bins[tuple(offset)] = bins[tuple(-offset)] = place
    wanted = np.zeros(values.shape)
    for offset, place in bins.items():
        if place < pairs.bins:
            wanted += weights[place] * np.roll(values - values.mean(), offset, (0, 1, 2))
    found = pairs.slope(pairs.forward(values), weights, shorter_than=0)
    assert np.allclose(found, wanted, atol=1e-4)


@pytest.mark.parametrize("shape", [(16, 18, 20), (15, 16, 13)])
def test_curves_are_those_of_all_pairs_around(shape):
    one, other = np.random.default_rng(3).random((2, *shape)).astype(np.float32)
    oracle = Pairs(shape, 6, AROUND, directions=DIAGONAL)
    pairs = TorusPairs(shape, 6, AROUND, directions=DIAGONAL)
    spectra = [oracle.forward(values) for values in (one, other)]
    assert np.allclose(pairs.curve(*spectra), oracle.curve(*spectra), atol=1e-5)


def test_steps_bring_the_two_point_function_to_the_exemplars():
    exemplar, field = smooth((28, 28, 28), 12, radius=2), smooth((30, 32, 36), 13, radius=3)
    target = correlations_of([exemplar], softness=120, r_max=8, directions=DIAGONAL)
    size = [np.linalg.norm(misfit(field, target, periodic=AROUND))]
    for _ in range(4):
        field = rounded(torus_step(field, target)[0])
        size.append(np.linalg.norm(misfit(field, target, periodic=AROUND)))
    assert size[1] < 0.65 * size[0]
    assert size[-1] < 0.35 * size[0]


def diagonal(shape, sign, seed):
    """A wrapping field whose ridges run along z = sign * x."""
    noise = np.random.default_rng(seed).standard_normal((1, *shape))
    for step in (1, 2, 4):
        noise = noise + np.roll(noise, (step, sign * step), (1, 3))
    return np.clip(np.rint(noise / noise.std() * 50), -FULL, FULL).astype(np.int8)


def squares(curves):
    """The sum of squares of the two-point function in every direction, (13,)."""
    return (curves.reshape(DIAGONAL, -1)[:, 1:] ** 2).sum(axis=1)


ONE, OTHER = LINES.index((1, 0, 1)), LINES.index((1, 0, -1))


@pytest.mark.parametrize("step", [two_point_step, torus_step], ids=["open", "torus"])
def test_one_of_two_mirrored_diagonals_is_pushed_alone(step):
    """A field with ridges along one diagonal, and a target with ridges along the other."""
    field = diagonal((24, 24, 24), 1, 1)
    target = correlations_of(
        [diagonal((24, 24, 24), -1, 2)], softness=120, r_max=5, directions=DIAGONAL
    )
    before = squares(misfit(field, target, periodic=AROUND))
    for _ in range(3):
        if step is torus_step:
            field = rounded(torus_step(field, target)[0])
        else:
            field = rounded(two_point_step(field, target, periodic=AROUND))
    after = squares(misfit(field, target, periodic=AROUND))
    assert after[ONE] < 0.7 * before[ONE]
    assert after[OTHER] < 0.7 * before[OTHER]


def test_a_convolution_is_the_gradient_of_the_pairs_that_it_weighs():
    """Against finite differences, with weights of their own for every direction."""
    rng = np.random.default_rng(3)
    pairs = Pairs((8, 9, 10), 3, AROUND, directions=DIAGONAL)
    weights = rng.normal(size=pairs.bins)
    values, way = rng.random((2, *pairs.shape)).astype(np.float32)

    def weighed(values):
        spectrum = pairs.forward(values)
        return float(pairs.curve(spectrum, spectrum) * pairs.fits @ weights)

    slope = 2 * pairs.convolve(pairs.forward(values), weights)
    there, back = weighed(values + 0.05 * way), weighed(values - 0.05 * way)
    assert (there - back) / 0.1 == pytest.approx(float((slope * way).sum()), rel=1e-3)


def test_blocks_are_means_and_their_fields_double_back():
    values = np.random.default_rng(4).random((6, 5, 8)).astype(np.float32)
    blocks = BlockMeans(lambda a, b: values[a:b], values.shape)
    made = np.concatenate([blocks(0, 1), blocks(1, 3)])
    whole = np.pad(values, ((0, 0), (0, 1), (0, 0)), mode="edge")
    assert np.allclose(made, whole.reshape(3, 2, 3, 2, 4, 2).mean(axis=(1, 3, 5)))
    level = Doubled(np.full((3, 3, 4), 0.5, np.float32), values.shape)
    assert level[0:6].shape == (6, 5, 8) and np.all(level[0:6] == 0.5)
    ramp = Doubled(np.arange(8, dtype=np.float32).reshape(8, 1, 1), (16, 2, 2))
    assert ramp[2:8][:, 0, 0].tolist() == [0.75, 1.25, 1.75, 2.25, 2.75, 3.25]


@pytest.mark.parametrize("shape", [(28, 32, 36), (27, 31, 36)])
def test_steps_in_blocks_bring_the_two_point_function_to_the_exemplars(shape):
    exemplar, field = smooth((28, 28, 28), 12, radius=2), smooth(shape, 13, radius=3)
    target = correlations_of([exemplar], softness=120, r_max=4, directions=DIAGONAL, blocks=2)
    aim = correlations_of([exemplar], softness=120, r_max=8, directions=DIAGONAL)
    size = [np.linalg.norm(misfit(field, aim, periodic=AROUND))]
    for _ in range(4):
        field = rounded(torus_step(field, target)[0])
        size.append(np.linalg.norm(misfit(field, aim, periodic=AROUND)))
    assert size[-1] < 0.4 * size[0]


def test_a_field_of_one_phase_stays():
    full = np.full((1, 16, 16, 16), FULL, np.int8)
    target = correlations_of([smooth((16, 16, 16), 4)], softness=60, r_max=6)
    assert np.array_equal(torus_step(full, target)[0], full.astype(np.int16) * UNIT)


def test_the_debt_of_a_vote_is_that_of_all_pairs_around():
    field = smooth((16, 18, 20), 5, channels=2)
    target = correlations_of([smooth((20, 20, 20), 6, channels=2)], softness=60, r_max=6)
    before = np.random.default_rng(7).normal(size=target.curves.shape) * 1e-3
    _, renewed = torus_step(field, target, debt=before, renew=True)
    assert np.allclose(renewed, accumulate_debt(before, field, target, periodic=AROUND), atol=1e-6)
    _, same = torus_step(field, target, debt=before)
    assert np.array_equal(same, before)
    assert torus_step(field, target)[1] is None


def test_debt_moves_the_target():
    field = smooth((20, 20, 20), 14)
    target = correlations_of([field], softness=60, r_max=6)
    debt = np.zeros((3, 7))
    debt[:, 1:4] = 2e-3
    at_rest = misfit(rounded(torus_step(field, target)[0]), target, periodic=AROUND)
    moved = rounded(torus_step(field, target, debt=debt.reshape(1, -1))[0])
    change = misfit(moved, target, periodic=AROUND) - at_rest
    assert np.all(change.reshape(3, 7)[:, 1:4] < -5e-4), "below the target by about the debt"


def test_no_place_is_special():
    field, exemplar = smooth((18, 20, 24), 15), smooth((20, 20, 20), 16, radius=1)
    target = correlations_of([exemplar], softness=60, r_max=6)
    there = torus_step(np.roll(field, (5, 11, 17), (1, 2, 3)), target)[0]
    here = np.roll(torus_step(field, target)[0], (5, 11, 17), (1, 2, 3))
    assert np.abs(there.astype(int) - here).max() <= 2


@pytest.mark.whole
def test_the_forecast_of_a_step_holds():
    field = smooth((64, 60, 72), 4)
    target = correlations_of([smooth((32, 32, 32), 5)], softness=60, r_max=10)
    torus_step(field, target)
    with tb.threads(1):
        peak = peak_bytes(lambda: torus_step(field, target)) - 2 * field.size
    forecast = max(stage.peak for stage in torus_step_stages(field.shape[1:], target))
    assert peak <= forecast <= 1.3 * peak

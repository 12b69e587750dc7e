"""Targets of denser and sparser material, from an exemplar's dense and sparse places."""

import numpy as np
import pytest

from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.statistics.density_slopes import (
    density_slopes,
    density_weights,
    weight_for,
)
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.slices import slice_target
from trabecula.synth.shared.statistics.two_point import correlations_of

SOFT = 20.0


def two_halves() -> np.ndarray:
    """Below, single voxels of the phase, a quarter of all; above, cubes of 4, a half of all."""
    random = np.random.default_rng(3)
    fine = random.random((16, 48, 48)) < 0.25
    coarse = np.kron(random.random((4, 12, 12)) < 0.5, np.ones((4, 4, 4), bool))
    field = np.where(np.concatenate([fine, coarse]), 100, -100)
    return field.astype(np.int8)[None]


@pytest.fixture(scope="module")
def halves():
    field = two_halves()
    own = correlations_of([field], softness=SOFT, r_max=6)
    return field, own, density_slopes([field], own, width=12)


def test_weights_have_no_mean_and_follow_the_local_fraction():
    field = two_halves()
    (g,) = density_weights([field], 12)
    assert abs(g.mean()) < 1e-6
    assert g[24:].mean() > 0.08 and g[:8].mean() < -0.08


def test_the_fraction_moves_as_asked(halves):
    field, _, slopes = halves
    t = weight_for([slopes], 0.03)
    own = Histogram.of(field[0])
    moved = slopes.histogram(own, 0, t)
    before, after = (float(h.shares[h.values > 0].sum()) for h in (own, moved))
    assert after - before == pytest.approx(0.03, abs=1e-5)


def test_denser_material_is_made_of_the_coarser_half(halves):
    """At equal fraction single voxels have more surface: S2 falls less from 0 to 1 per fraction."""
    _, own, slopes = halves

    def surface(correlations):
        curve = correlations.curves[0]
        return (curve[0] - curve[1]) / curve[0]

    t = weight_for([slopes], 0.05)
    assert surface(slopes.correlations(own, t)) < surface(own) - 0.02
    assert surface(slopes.correlations(own, -t)) > surface(own) + 0.02


def test_weighing_is_the_mean_over_places_for_the_ends_of_short_pairs(halves):
    """The literal sum: pairs weigh the mean of their ends, where both lie in one window."""
    field, own, slopes = halves
    t = weight_for([slopes], 0.02)
    (g,) = density_weights([field], 12)
    inside = (field[0] > 0).astype(np.float64)
    weight = 1 + t * g.astype(np.float64)
    found = slopes.correlations(own, t).curves[0]
    assert found[0] == pytest.approx((weight * inside).mean(), abs=2e-4)
    pair = (weight[:, :, 1:] + weight[:, :, :-1]) / 2
    expected = (pair * inside[:, :, 1:] * inside[:, :, :-1]).sum() / pair.sum()
    along_x = found[2 * 7 + 1]
    assert along_x == pytest.approx(expected, abs=4e-4)


def test_far_apart_both_ends_are_denser():
    """Beyond the windows pairs are those of places that have nothing to do with each other."""
    random = np.random.default_rng(5)
    field = np.where(random.random((40, 40, 40)) < 0.3, 100, -100).astype(np.int8)[None]
    own = correlations_of([field], softness=SOFT, r_max=16)
    slopes = density_slopes([field], own, width=4)
    t = weight_for([slopes], 0.05)
    found = slopes.correlations(own, t).curves[0] - own.curves[0]
    pairs = Pairs(field.shape[1:], own.r_max, edges=own.edges, directions=own.directions)
    mean, (_, y, x) = float((field > 0).mean()), pairs.reach
    change = t * slopes.fraction
    assert change > 0.005
    for far in (8, 11, 14):
        at = pairs.places[far, y, x]
        assert found[at] == pytest.approx((mean + change) ** 2 - mean**2, rel=0.1)


def test_no_weight_falls_below_nothing(halves):
    field, _, slopes = halves
    (g,) = density_weights([field], 12)
    for change in (-0.9, 0.9):
        t = weight_for([slopes], change)
        assert (1 + t * g).min() == pytest.approx(0, abs=1e-5)
        assert abs(t * slopes.fraction) < 0.9
    even = np.tile(np.int8([100, -100]), (1, 24, 24, 12))
    flat = density_slopes([even], correlations_of([even], softness=SOFT, r_max=4), width=2)
    assert weight_for([flat], 0.0) == 0


def test_neighbourhoods_count_as_often_as_their_place_weighs():
    field = two_halves()
    above = np.zeros(field.shape[1:])
    above[16:] = 1
    plain = slice_target([field], width=4)
    coarse = slice_target([field], width=4, weights=[above])
    assert len(coarse.features) == len(plain.features)
    # the first component is the mean of a neighbourhood: denser, and of whole cubes
    spread = [float(one.features[:, 0].std()) for one in (plain, coarse)]
    assert spread[1] > 1.1 * spread[0]

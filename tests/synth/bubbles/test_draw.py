"""Nucleation: number, places and speeds of bubbles, repulsion and absorption."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial import cKDTree

import trabecula as tb
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.growth_law import ABSORBED, counts_of, distance_of, law_of
from trabecula.synth.bubbles.nucleation import repel


def nuclei(side, *, seed=1, ndim=3, periodic=False, **settings):
    """Return places, brakes and names of the bubbles that start in a cube."""
    model = tb.method("bubbles", **{"roughness": 0.0, **settings}).fit()
    shape = (side,) * ndim
    growth = model._growth(tb.Request(shape, seed=seed, periodic=periodic))
    _, places, brakes, _, names = growth.world(
        tuple((0, length) for length in (1,) * (3 - ndim) + shape)
    )[1]
    inside = ((places >= 0) & (places < side)).all(1)
    return places[inside][:, 3 - ndim :], brakes[inside], names[inside]


@pytest.mark.parametrize("mean", [0.3, 1.0, 2.7])
def test_counts_are_poissons(mean):
    thresholds = counts_of(mean, 0.0).astype(float) / 2**32
    assert np.allclose(thresholds, stats.poisson(mean).cdf(np.arange(len(thresholds))), atol=1e-9)


def test_the_most_regular_counts_keep_the_mean():
    thresholds = counts_of(1.3, 1.0).astype(float) / 2**32
    assert np.allclose(thresholds, [0, 0.7, 1.0])


@pytest.mark.parametrize(("ndim", "side"), [(3, 110), (2, 500)])
@pytest.mark.parametrize("regularity", [0.0, 1.0])
def test_there_are_as_many_bubbles_as_the_density_says(ndim, side, regularity):
    """Count bubbles where none absorbs another."""
    places, _, _ = nuclei(
        side, ndim=ndim, distance=10.0, spread=0.0, regularity=regularity, separation=0.0
    )
    expected = (side / 10) ** ndim
    assert abs(len(places) - expected) < 3.5 * np.sqrt(expected)
    assert stats.kstest(places.ravel() / side, "uniform").pvalue > 0.001


def test_regular_bubbles_are_farther_from_their_nearest():
    nearest = {}
    for regularity in (0.0, 0.5, 1.0):
        places, _, _ = nuclei(100, distance=10.0, spread=0.0, separation=0.0, regularity=regularity)
        nearest[regularity] = cKDTree(places).query(places, 2)[0][:, 1]
    # Of a Poisson process: Gamma(4/3) / (4 pi / 3)^(1/3) = 0.554 L (Hertz 1909).
    assert nearest[0.0].mean() == pytest.approx(5.54, rel=0.05)
    assert nearest[0.0].mean() < nearest[0.5].mean() < nearest[1.0].mean()
    assert nearest[1.0].min() > 2 * nearest[0.0].min()


def test_sizes_follow_the_law():
    for ndim in (2, 3):
        speeds = 1 / law_of(BubblesConfig(spread=0.4), 1.0, ndim).brakes
        assert np.mean(speeds**ndim) == pytest.approx(1, abs=1e-4)
        # A normal law cut off at 2.5 standard deviations has 0.9550 of its spread.
        assert np.log(speeds).std() == pytest.approx(
            0.4 * stats.truncnorm(-2.5, 2.5).std(), rel=1e-3
        )
    _, brakes, names = nuclei(150, distance=10.0, spread=0.4, separation=0.0)
    assert 0.28 < np.log(brakes).std() < 0.382, (
        "of those that are left: slow ones are absorbed first"
    )
    assert len(np.unique(names)) > 0.999 * len(names)


def test_slow_bubbles_in_front_of_fast_ones_are_absorbed():
    """Check the rule pair by pair on the rest; all others broke it."""
    all_of_them = nuclei(120, distance=10.0, spread=0.0, separation=0.0, regularity=0.0)[0]
    places, brakes, _ = nuclei(120, distance=10.0, spread=0.5, separation=0.0, regularity=0.0)
    assert 0.7 * len(all_of_them) < len(places) < 0.95 * len(all_of_them)
    for i, j in cKDTree(places).query_pairs(9.0):
        ratio = max(brakes[i], brakes[j]) / min(brakes[i], brakes[j])
        if ratio > 1:
            off = np.linalg.norm(places[i] - places[j])
            assert off * ratio / (ratio**2 - 1) >= ABSORBED * 10 - 0.01


def test_the_same_bubbles_on_any_grid():
    model = {
        s: tb.method("bubbles", density=1e-3, regularity=0.5).fit(spacing=s) for s in (1.0, 0.4)
    }
    found = []
    for spacing, side in ((1.0, 40), (0.4, 100)):
        growth = model[spacing]._growth(tb.Request((side,) * 3, seed=7))
        _, places, _, _, names = growth.world(((0, side),) * 3)[1]
        found.append(
            {int(name): place * spacing for name, place in zip(names, places, strict=True)}
        )
    common = set(found[0]) & set(found[1])
    assert len(common) > 64
    assert max(np.abs(found[0][name] - found[1][name]).max() for name in common) < 0.02


def test_the_density_is_of_the_plane_in_a_picture():
    for ndim, apart in ((2, 10.0), (3, 5.0)):
        assert distance_of(BubblesConfig(density=apart**-ndim), 1.0, ndim) == pytest.approx(apart)
        assert distance_of(BubblesConfig(density=apart**-ndim), 0.5, ndim) == pytest.approx(
            2 * apart
        )


@pytest.mark.parametrize(("off", "moves"), [(150, False), (50, True)])
def test_bubbles_push_those_alone_that_are_nearer_than_the_distance(off, moves):
    places = np.array([[0, 0, 0], [0, 0, off]], np.int64)
    moved, one = np.empty_like(places), np.ones(3, np.int64)
    repel(moved, places, np.array([0, 2]), one, 0 * one, 100.0, 40.0)
    assert (np.diff(moved[:, 2])[0] > off) == moves and np.array_equal(moved, places) != moves

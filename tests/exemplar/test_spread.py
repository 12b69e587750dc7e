"""Distributions of the phases' fractions over samples."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.exemplar.spread import FractionSpread, fraction_spread


def coins(seed: int, *, share: float = 0.3, side: int = 48, grain: int = 4) -> tb.Image:
    """Cubes of `grain` voxels, solid with a probability."""
    cells = np.random.default_rng(seed).random((side // grain,) * 3) < share
    return tb.labels(np.kron(cells, np.ones((grain,) * 3)).astype(np.uint8))


def test_the_spread_of_independent_cubes_is_binomial():
    found = fraction_spread([coins(1)], (32, 32, 32))
    assert found.mean.sum() == pytest.approx(1)
    # 8 cubes a side, whose faces lie anywhere: 512 independent parts
    expected = np.sqrt(0.3 * 0.7 / 8**3)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(expected, rel=0.25)
    assert found.covariance[0, 1] == pytest.approx(-found.covariance[0, 0])


def test_draws_have_the_mean_and_the_covariance():
    covariance = np.array([[9.0, -6.0, -3.0], [-6.0, 5.0, 1.0], [-3.0, 1.0, 2.0]]) * 1e-4
    spread = FractionSpread(("void", "a", "b"), np.array([0.5, 0.3, 0.2]), covariance)
    drawn = np.array([list(each.values()) for each in spread.draw(range(4000))])
    assert drawn.min() > 0
    np.testing.assert_allclose(drawn.sum(axis=1), 1)
    np.testing.assert_allclose(drawn.mean(axis=0), spread.mean, atol=2e-3)
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=5e-5)
    halved = np.array([list(each.values()) for each in spread.draw(range(4000), scale=0.5)])
    assert halved.std(axis=0) == pytest.approx(drawn.std(axis=0) / 2, rel=0.02)


def test_a_draw_depends_on_its_seed_alone_and_no_scale_gives_the_mean():
    spread = fraction_spread([coins(1)], (16, 16, 16))
    assert spread.draw([5, 9, 2])[1] == spread.draw([9])[0]
    assert list(spread.draw([3], scale=0)[0].values()) == pytest.approx(spread.mean)


def test_a_phase_that_is_absent_stays_so():
    image = tb.Image(coins(2).values, "labels", phases=("void", "solid", "binder"))
    drawn = fraction_spread([image], (16, 16, 16)).draw([1])[0]
    assert drawn["binder"] == 0 and sum(drawn.values()) == pytest.approx(1)


def test_exemplars_that_differ_more_than_their_sizes_say_widen_the_spread():
    one = fraction_spread([coins(1)], (32,) * 3).covariance[0, 0]
    alike = fraction_spread([coins(n) for n in range(4)], (32,) * 3).covariance[0, 0]
    apart = [coins(n, share=share) for n, share in enumerate((0.2, 0.3, 0.4, 0.5))]
    between = np.var([1 - image.values.mean() for image in apart], ddof=1)
    wide = fraction_spread(apart, (32,) * 3).covariance[0, 0]
    assert alike == pytest.approx(one, rel=0.5)
    assert wide == pytest.approx(one + between, rel=0.15)


def test_what_has_no_phases_or_other_axes_is_refused():
    grey = tb.Image(np.random.default_rng(0).random((24, 24, 24)), "grey")
    with pytest.raises(InputError, match="needs phases"):
        fraction_spread([grey], (24,) * 3)
    with pytest.raises(InputError, match="3 axes"):
        fraction_spread([coins(1)], (24, 24))

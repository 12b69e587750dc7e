"""A low-resolution scan and a picture: blocks, change of support, the whole method."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.errors import RequestError
from trabecula.measure.smooth import gaussian
from trabecula.synth.kopf.back_projection import _nth_least, back_project, settle
from trabecula.synth.kopf.change_of_support import (
    block_majority,
    block_variance,
    equivalent_side,
    refine,
    variance_share,
)
from trabecula.synth.kopf.coarse_scan import check_scan, grey_fractions, label_fractions
from trabecula.synth.kopf.sharpening import _detail
from trabecula.synth.shared.block_bounds import BlockBounds


def blocks(values, sides):
    """Return the mean of every block (z, y, x)."""
    z, y, x = (n // s for n, s in zip(values.shape, sides, strict=True))
    parts = values.reshape(z, sides[0], y, sides[1], x, sides[2])
    return parts.mean(axis=(1, 3, 5))


def bubbles(shape, sigma, seed):
    """A smooth random material: a Gaussian field cut at its upper quarter."""
    smooth = gaussian(np.random.default_rng(seed).normal(size=shape), sigma)
    return smooth > np.quantile(smooth, 0.75)


def majority_bounds(coarse, sides):
    size = int(np.prod(sides))
    least, most = np.where(coarse, size // 2 + 1, 0), np.where(coarse, size, (size - 1) // 2)
    return BlockBounds(least.astype(np.int32), most.astype(np.int32), sides)


def test_the_nth_least_is_that_of_a_sort():
    random = np.random.default_rng(4)
    for size in (1, 2, 7, 64):
        values = random.integers(-3, 4, size).astype(np.int16)
        values[0] = -32768 if size % 2 else 32767
        found = [_nth_least(values, place) for place in range(size)]
        assert found == sorted(values.tolist())


def test_back_projection_reaches_the_bounds_and_leaves_a_field_that_keeps_them():
    truth, sides = bubbles((24, 18, 20), 2.5, 0), (4, 3, 2)
    bounds = majority_bounds(blocks(truth, sides) > 0.5, sides)
    votes = np.random.default_rng(1).normal(0, 300, (24, 18, 20)).astype(np.int16)
    before = blocks(votes > 0, sides)
    moved = back_project(votes.copy(), bounds, rounds=40, margin=50)
    share = blocks(moved > 0, sides) * 24
    wrong = (share < bounds.least) | (share > bounds.most)
    assert wrong.mean() < 0.02 < np.mean((before > 0.5) != (bounds.least > 0))
    values = moved > 0
    assert settle(values, moved, bounds) <= 24 * wrong.sum()
    share = blocks(values, sides) * 24
    assert ((share >= bounds.least) & (share <= bounds.most)).all()
    own = np.where(values, 500, -500).astype(np.int16)
    np.testing.assert_array_equal(back_project(own.copy(), bounds, rounds=3, margin=50), own)


def test_settling_changes_the_voxels_nearest_to_the_interface():
    votes = np.arange(-32, 32, dtype=np.int16).reshape(4, 4, 4)
    values = votes > 8
    bounds = BlockBounds(*(np.full((1, 1, 1), n, np.int32) for n in (30, 40)), (4, 4, 4))
    assert settle(values, votes, bounds) == 7
    np.testing.assert_array_equal(values, votes > 1)
    high = BlockBounds(*(np.full((1, 1, 1), n, np.int32) for n in (0, 10)), (4, 4, 4))
    assert settle(values, votes, high) == 20
    np.testing.assert_array_equal(values, votes > 21)


def test_the_variance_of_block_means_is_that_of_known_covariances():
    assert block_variance(np.array([0.25, 0, 0, 0]), (3, 3)) == pytest.approx(0.25 / 9)
    assert block_variance(np.full(9, 0.2), (4, 4, 4)) == pytest.approx(0.2)
    # of lines: the mean over pairs in a segment of 2
    assert block_variance(np.array([1.0, 0.5]), (2,)) == pytest.approx(0.75)


def test_squares_are_larger_than_cubes_of_the_same_variance():
    picture = bubbles((1, 90, 90), (0, 2, 2), 3)[0]
    assert equivalent_side(picture, (1, 1, 1)) == 1
    assert 4 < equivalent_side(picture, (4, 4, 4)) <= 6
    majority = block_majority(picture, 3)
    assert majority.shape == (88, 88)
    assert majority[5, 7] == (picture[5:8, 7:10].sum() > 4)


def test_what_a_majority_loses_is_estimated_from_a_picture():
    truth = bubbles((64, 64, 64), 1.6, 5)
    coarse = blocks(truth, (4, 4, 4)) > 0.5
    other = bubbles((1, 160, 160), (0, 1.6, 1.6), 6)[0]
    found = refine(coarse, [other], (4, 4, 4), None)
    share = np.mean([np.mean(np.diff(truth, axis=axis)) for axis in range(3)])
    assert abs(coarse.mean() - truth.mean()) > 0.04
    assert found.fraction == pytest.approx(truth.mean(), abs=0.02)
    assert found.interface == pytest.approx(share, rel=0.1)
    told = refine(coarse, [other], (4, 4, 4), 0.3)
    assert told.fraction == 0.3 and told.interface > found.interface


@pytest.mark.parametrize(("radius", "dark"), [(3, True), (3, False), (1.6, True), (1.6, False)])
def test_grey_values_are_partial_volumes(radius, dark):
    """With and without voxels that hold the rarer phase alone, which is the brighter or not."""
    rng = np.random.default_rng(0)
    truth, sides = bubbles((64, 64, 64), radius, 1) != dark, (4, 4, 4)
    share = blocks(truth, sides)
    picture = bubbles((1, 200, 200), (0, radius, radius), 2)[0] != dark
    grey = np.rint(40 + 150 * share + rng.normal(0, 3, share.shape)).astype(np.uint8)
    found, error = grey_fractions(grey, variance_share([picture], sides), 0.4)
    assert found.mean() == pytest.approx(share.mean(), abs=0.025)
    assert np.abs(found - share).mean() < 0.04 and 0.01 < error < 0.03


def test_labels_are_all_or_nothing():
    labels = tb.Image(np.arange(3, dtype=np.uint8).reshape(1, 1, 3), "labels")
    np.testing.assert_array_equal(label_fractions(labels, (0, 1, 2)), [[[0, 1, 0]]])
    with pytest.raises(RequestError, match=r"holds the phase .*, which the picture lacks"):
        label_fractions(labels, (0, 1))


def test_detail_does_not_depend_on_slabs(monkeypatch):
    votes = np.random.default_rng(0).integers(-9000, 9000, (30, 8, 9)).astype(np.int16)
    whole = _detail(votes)
    monkeypatch.setattr("trabecula.synth.shared.slabs.AT_ONCE", 72)
    np.testing.assert_array_equal(_detail(votes), whole)
    assert not _detail(np.full((9, 9, 9), 77, np.int16)).any()


@pytest.fixture(scope="module")
def material():
    """A truth, its coarse scan and a picture of another part."""
    truth = bubbles((40, 40, 40), 2.2, 8)
    picture = tb.Image(bubbles((1, 64, 64), (0, 2.2, 2.2), 9)[0].astype(np.uint8), "labels")
    coarse = tb.Image((blocks(truth, (4, 4, 4)) > 0.5).astype(np.uint8), "labels")
    return truth, coarse, picture


QUICK = {"first_rounds": 2, "rounds": (2, 2), "sweeps": (1,), "levels": 3}


@pytest.fixture(scope="module")
def model(material):
    return tb.method("kopf", **QUICK).fit(material[2])


@pytest.mark.whole
def test_every_coarse_voxel_comes_out(material, model):
    truth, coarse, _ = material
    made = model.generate(truth.shape, seed=3, coarse=coarse)
    assert np.array_equal(blocks(made.values, (4, 4, 4)) > 0.5, coarse.values > 0)
    report = made.recipe.steps[-1]["report"]["coarse"]
    assert report["fraction"]["result"] == pytest.approx(made.values.mean())
    assert report["fraction"]["result"] == pytest.approx(truth.mean(), abs=0.03)
    assert report["interface"]["result"] == pytest.approx(report["interface"]["estimate"], rel=0.1)
    step = made.recipe.to_json()[-1]
    assert step["request"]["coarse"][-1]["sha256"]


@pytest.mark.whole
def test_voxels_flip_towards_the_picture(material, model):
    """And none do where no rounds are asked for."""
    truth, coarse, picture = material
    plain = tb.method("kopf", **QUICK, interface_rounds=0).fit(picture)
    before = plain.generate(truth.shape, seed=3, coarse=coarse)
    made = model.generate(truth.shape, seed=3, coarse=coarse)
    assert "patterns" not in before.recipe.steps[-1]["report"]
    report = made.recipe.steps[-1]["report"]["patterns"]
    assert 0 < report["off_after"] < 0.9 * report["off_before"]
    assert 500 < report["changed"] < 8000
    with tb.threads(2):
        again = model.generate(truth.shape, seed=3, coarse=coarse)
    assert np.array_equal(again.values, made.values)


@pytest.mark.whole
@pytest.mark.parametrize("sides", [(3, 3, 3), (2, 4, 5)])
def test_any_whole_multiple(material, model, sides):
    z, y, x = (40 // side * side for side in sides)
    truth = material[0][:z, :y, :x]
    share = blocks(truth, sides)
    coarse = tb.Image((share > 0.5).astype(np.uint8), "labels")
    made = model.generate(truth.shape, coarse=coarse)
    decided = np.abs(share - 0.5) > 1 / np.prod(sides)
    assert np.array_equal((blocks(made.values, sides) > 0.5)[decided], (share > 0.5)[decided])


@pytest.mark.whole
def test_partial_volumes_come_out_of_a_grey_scan(material, model):
    truth, _, _ = material
    share = blocks(truth, (4, 4, 4))
    grey = tb.Image(np.rint(30 + 180 * share).astype(np.uint8), "grey")
    made = model.generate(truth.shape, coarse=grey)
    assert np.abs(blocks(made.values, (4, 4, 4)) - share).mean() < 0.02


def refused(model, **parts):
    with pytest.raises(RequestError) as error:
        model.plan(tb.Request(40, **parts))
    return str(error.value)


def test_another_material_is_refused_with_its_figures(material, model):
    _, coarse, _ = material
    turned = tb.Image(1 - coarse.values, "labels")
    words = refused(model, coarse=turned)
    assert "volume fraction of solid is 0." in words and "the picture's 0." in words
    assert "slices of the scan differ by" in words


def test_phases_and_voxels_have_to_agree(material):
    _, coarse, picture = material
    named = tb.Image(coarse.values, "labels", phases=("pore", "grain"))
    model = tb.method("kopf", **QUICK).fit(
        tb.Image(picture.values, "labels", spacing=2.0, unit="um")
    )
    assert "of pore, grain, the exemplar of void, solid" in refused(model, coarse=named)
    small = tb.Image(coarse.values, "labels", spacing=6.0, unit="um")
    assert "make it (8.0, 8.0, 8.0)" in refused(model, coarse=small)
    right = tb.Image(coarse.values, "labels", spacing=8.0, unit="um")
    assert model.plan(tb.Request(40, coarse=right)).peak > 0


def test_a_somewhat_different_fraction_is_reported(material):
    _, coarse, picture = material
    values = coarse.values.copy()
    values[:, ::4] = 0
    request = tb.Request(40, coarse=tb.Image(values, "labels"))
    line = check_scan(request, [picture], (0, 1))
    assert line.endswith("is it the same material?") == bool(line)
    assert not check_scan(tb.Request(40, coarse=coarse), [picture], (0, 1))


@pytest.mark.slow
def test_berea_is_refined_four_times(data):
    """Surface, diffusivity and coarse voxels of a rock, from a slice of another part."""
    rock = tb.read(data / "berea_sandstone_a.tif")
    truth = rock.values[:64, :64, :64] > 0
    coarse = tb.Image((blocks(truth, (4,) * 3) >= 0.5).astype(np.uint8), "labels")
    picture = tb.Image(np.ascontiguousarray(rock.values[150]), "labels", phases=rock.phases)
    with listen(lambda label, fraction: None):
        made = tb.method("kopf").fit(picture).generate(64, coarse=coarse, seed=1)
    real = tb.Image(truth.astype(np.uint8), "labels")
    assert np.mean((blocks(made.values, (4,) * 3) > 0.5) == (coarse.values > 0)) >= 0.995

    def ratio(measure):
        return measure(made) / measure(real)

    assert ratio(tb.measure.specific_surface) == pytest.approx(1, abs=0.1)
    solid = [
        np.mean([tb.measure.diffusivity(one, axis=axis, phase="solid").value for axis in range(3)])
        for one in (made, real)
    ]
    assert solid[0] == pytest.approx(solid[1], rel=0.1)

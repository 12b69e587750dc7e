"""`mrf`, its density: against equations 3 to 9 written out, and the tables that stand for logarithm
and exponential.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.engine.compile import kernel
from trabecula.synth.mrf import site_update, slice_planes
from trabecula.synth.mrf.candidates import (
    _weigh_by_products,
    extract_neighbourhoods,
    prepare_candidates,
    weigh_candidates,
)
from trabecula.synth.mrf.density import (
    LOGS,
    NEAREST_WEIGHT,
    POWERS,
    STEPS,
    UNIT,
    gaussian_table,
    log_of,
    optimal_bandwidth,
    parzen_densities,
    power_of,
    table_shift,
)
from trabecula.synth.mrf.lattice import SiteLattice, marks_or_all
from trabecula.synth.mrf.picture_levels import largest_feature, number_levels
from trabecula.synth.mrf.slice_planes import (
    gather_confidence,
    gather_levels,
    gather_places,
    plane_across,
)

WIDTH = 5


def picture(kind, rng, side=24):
    if kind == "colour":
        return tb.Image(rng.integers(0, 256, (side, side + 3, 3)).astype(np.uint8), "colour")
    if kind == "grey":
        return tb.Image(rng.integers(3, 200, (side, side + 3)).astype(np.uint8), "grey")
    return tb.Image(rng.integers(0, int(kind[-1]), (side, side + 3)), "labels")


def equation_7(found, weight, neighbourhoods, features, h):
    """Sum the share of every level (S, L) literally."""
    features = features.astype(float)
    x, y, centre = (
        features[found],
        features[neighbourhoods.around],
        features[neighbourhoods.centres],
    )
    apart = (((x[:, None] - y[None]) ** 2).sum(-1) * weight[:, None]).sum(-1)  # (S, n)
    apart -= apart.min(1, keepdims=True)
    total = np.stack(
        [
            np.exp(-(apart + ((level - centre) ** 2).sum(1)) / (2 * h * h)).sum(1)
            for level in features
        ],
        axis=1,
    )
    return total / total.sum(1, keepdims=True)


def learn_picture(kind, rng, *, steps, products):
    content = number_levels([picture(kind, rng)], full=40, levels=256, colours=60)
    neighbourhoods = extract_neighbourhoods(content.pictures[0], scale=0, width=WIDTH, every=True)
    candidates = prepare_candidates(
        neighbourhoods, content, most=10**6, bandwidth=0.9, steps=steps, products=products, bins=5
    )
    return content, neighbourhoods, candidates


def neighbours(lattice, axis):
    sites = np.arange(lattice.levels.size)
    offsets = plane_across(axis).offsets(WIDTH)
    places = np.empty((len(sites), len(offsets)), np.int64)
    gather_places(sites, offsets, lattice.shape, marks_or_all(lattice.domain), places)
    found, weight = np.empty(places.shape, np.uint8), np.empty(places.shape, np.uint8)
    gather_levels(places, lattice.levels, found, weight)
    return places, found, weight


def add_expected_levels(candidates, content, found, weight, steps):
    bins = np.empty((len(found), 1, len(content.features)), np.int64)
    scratch = np.empty((len(found), len(candidates.centres)), np.float32)
    weigh_candidates(found, weight, steps, candidates, content.features, 0, bins, scratch)
    share, log = np.empty(bins.shape), np.empty(bins.shape, np.int64)
    parzen_densities(bins, candidates.blur[None], LOGS, share, log)
    return share[:, 0], log[:, 0]


@pytest.mark.parametrize("kind", ["labels2", "labels3", "labels6", "grey", "colour"])
@pytest.mark.parametrize("way", ["bits or plain", "products", "confidence"])
def test_the_density_is_equation_7(kind, way):
    """Check every level; missing neighbours are left out; equation 9 where there is confidence."""
    rng = np.random.default_rng(4)
    steps = STEPS if way == "confidence" else 1
    content, neighbourhoods, candidates = learn_picture(
        kind, rng, steps=steps, products=way != "bits or plain"
    )
    levels = rng.integers(0, len(content.features), (5, 6, 7)).astype(np.uint8)
    domain = rng.random(levels.shape) < 0.9
    lattice = SiteLattice(levels, domain=domain)
    places, found, weight = neighbours(lattice, 1)
    confidence = weight.astype(float)
    if way == "confidence":
        temperature = rng.random(levels.shape).astype(np.float32)
        gather_confidence(places, temperature, STEPS, weight)
        confidence = np.where(
            places >= 0,
            np.floor(STEPS * (1 - temperature.ravel()[places].astype(float)) ** 2 + 0.5),
            0,
        )
        confidence /= STEPS
    share, log = add_expected_levels(candidates, content, found, weight, steps)
    wanted = equation_7(found, confidence, neighbourhoods, content.features, candidates.bandwidth)
    # A table of 8000 entries, and a floor of 2^-40.
    assert np.allclose(share, wanted, rtol=4e-3, atol=1e-6)
    likely = wanted > 1e-4
    assert np.allclose(log[likely] / UNIT, np.log2(wanted[likely]), atol=0.02)


def test_interior_sites_need_no_weights_and_agree():
    rng = np.random.default_rng(5)
    content, _, candidates = learn_picture("grey", rng, steps=1, products=True)
    levels = rng.integers(0, len(content.features), (6, 6, 6)).astype(np.uint8)
    _, found, weight = neighbours(SiteLattice(levels), 0)
    assert weight.all()
    whole = add_expected_levels(candidates, content, found, weight, 1)[0]
    # One site in a batch lacks a neighbour: that one goes by the weighted product.
    found, weight = np.concatenate([found, found[:1]]), np.concatenate([weight, weight[:1]])
    weight[-1, 0] = 0
    mixed = add_expected_levels(candidates, content, found, weight, 1)[0]
    assert np.array_equal(mixed[:-1], whole)
    assert not np.array_equal(mixed[-1], whole[0])
    # And where all do, the others' weights are the same.
    bins = np.empty((2, len(found), 1, len(content.features)), np.int64)
    scratch = np.empty((len(found), len(candidates.centres)), np.float32)
    for part, plain in zip(bins, (True, False), strict=True):
        _weigh_by_products(
            found, weight, 1, candidates, content.features, 0, part, scratch, plain=plain
        )
    assert np.array_equal(bins[0, :-1], bins[1, :-1])
    assert not np.array_equal(bins[0, -1], bins[1, -1])


@pytest.mark.parametrize(
    ("kind", "relaxation"),
    [("grey", "gibbs"), ("colour", "gibbs"), ("grey", "icm"), ("colour", "icm")],
)
@pytest.mark.parametrize("width", [7, 11, 15])
def test_products_are_exact_in_float32(kind, relaxation, width):
    """Check that the largest sum of sizes in a product is below 2^24."""
    config = tb.method("mrf", relaxation=relaxation, neighbourhood=width).config
    full = largest_feature(kind, config)
    weight = STEPS if relaxation == "icm" else 1
    assert full >= 20, "features this coarse would not tell grey values apart"
    assert 3 * weight * full**2 * (3 if kind == "colour" else 1) * (width**2 - 1) < 2**24


def test_equal_neighbourhoods_are_one_candidate():
    content = number_levels(
        [tb.Image(np.tile(np.eye(4, dtype=np.uint8), (5, 5)), "labels")],
        full=40,
        levels=9,
        colours=9,
    )
    neighbourhoods = extract_neighbourhoods(content.pictures[0], scale=0, width=3, every=True)
    candidates = prepare_candidates(
        neighbourhoods, content, most=4096, bandwidth=1, steps=1, products=False, bins=3
    )
    assert np.count_nonzero(candidates.centres < 255) == 4  # the period's four diagonals
    assert candidates.times.sum() == 18 * 18


def test_patches_are_those_of_the_decimated_pictures():
    rng = np.random.default_rng(6)
    image = rng.integers(0, 9, (17, 22)).astype(np.uint8)
    found = extract_neighbourhoods(image, scale=1, width=3, every=True)
    wanted = []
    for corner in [(0, 0), (0, 1), (1, 0), (1, 1)]:
        part = image[corner[0] :: 2, corner[1] :: 2]
        for y in range(part.shape[0] - 2):
            for x in range(part.shape[1] - 2):
                wanted.append(part[y : y + 3, x : x + 3].ravel())
    wanted = np.array(wanted)
    assert np.array_equal(found.centres, wanted[:, 4])
    assert np.array_equal(found.around, np.delete(wanted, 4, axis=1))
    first = extract_neighbourhoods(image, scale=1, width=3, every=False)
    assert np.array_equal(first.centres, wanted[: 7 * 9, 4])


def test_the_bandwidth_is_equation_6():
    assert optimal_bandwidth(4.0, 100, 9) == pytest.approx(2 * (4 / (100 * 11)) ** (1 / 13))


@given(twice=st.floats(0.05, 1e7))
def test_the_table_is_the_gaussian(twice):
    shift = table_shift(twice)
    table = gaussian_table(twice, shift=shift)
    apart = np.arange(len(table) - 1) * 2.0**shift
    assert len(table) <= 8200
    assert np.abs(table[:-1] / NEAREST_WEIGHT - np.exp(-apart / twice)).max() < 2e-3
    assert table[-1] == 0
    assert table[-2] <= max(1, NEAREST_WEIGHT * np.exp(-apart[-1] / twice) + 1)


@kernel
def _logs(values, logs, out):
    bits = values.view(np.int64)
    for i in range(len(values)):
        out[i] = log_of(bits[i], logs)


@kernel
def _powers(units, powers, out):
    for i in range(len(units)):
        out[i] = power_of(units[i], powers)


@given(st.lists(st.floats(1e-12, 1e12), min_size=1, max_size=20))
def test_logarithm_and_power_undo_each_other(values):
    array = np.array(values)
    out = np.empty(len(array), np.int64)
    _logs(array, LOGS, out)
    assert np.abs(out / UNIT - np.log2(array)).max() < 3e-4
    fall = -np.abs(out)
    back = np.empty(len(array), np.int64)
    _powers(fall, POWERS, back)
    assert np.abs(back / 2.0**31 - 2.0 ** (fall / UNIT)).max() < 3e-4


def units(shares):
    return np.rint(np.log2(np.array(shares, float)) * UNIT).astype(np.int64)


def test_the_heuristics_on_densities_made_by_hand():
    """Check equations 12 to 15: three views, four levels of grey 0, 10, 20, 100."""
    shares = [[[0.1, 0.2, 0.1, 0.6], [0.5, 0.2, 0.1, 0.2], [0.3, 0.25, 0.25, 0.2]]]
    log, features = units(shares), np.array([[0], [10], [20], [100]], np.int16)
    nothing, chosen = np.zeros(4, np.int64), np.empty(1, np.uint8)
    slice_planes.level_of_views(log, features, False, chosen)
    assert chosen[0] == 0  # the third view is the least certain: .3 for level 0
    slice_planes.level_of_views(log, features, True, chosen)
    assert chosen[0] == 2  # the mean of 100, 0 and 0 is 33, nearest to 20
    score = np.empty((1, 4), np.int64)
    slice_planes.least_of_views(log, np.zeros((1, 4), np.int64), score)
    site_update.most_probable_levels(score, chosen)
    assert chosen[0] == 1  # least densities .1, .2, .1, .2: the first of the equals
    slice_planes.product_of_views(log, nothing, np.zeros((1, 4), np.int64), score)
    site_update.most_probable_levels(score, chosen)
    assert chosen[0] == 3  # products .015, .01, .0025, .024
    assert 2.0 ** (score[0] / UNIT) == pytest.approx([0.015, 0.01, 0.0025, 0.024], rel=1e-3)


def test_the_correction_takes_the_marginal_off():
    log, prior = units([[[0.4, 0.6], [0.3, 0.7], [0.5, 0.5]]]), 2 * units([0.2, 0.8])
    score = np.empty((1, 2), np.int64)
    slice_planes.product_of_views(log, prior, np.zeros((1, 2), np.int64), score)
    assert 2.0 ** (score[0] / UNIT) == pytest.approx([0.06 / 0.04, 0.21 / 0.64], rel=1e-3)


@pytest.mark.parametrize("heat", [1.0, 2.0, 0.5])
def test_draws_have_the_density_to_a_power(heat):
    shares = np.array([0.1, 0.3, 0.05, 0.55])
    count = 40_000
    score = np.tile(units(shares), (count, 1))
    chosen = np.empty(count, np.uint8)
    site_update.draw_levels(
        score, site_update.coldness(heat), POWERS, np.arange(count), np.uint64(7), 0, chosen
    )
    wanted = shares ** (1 / heat)
    wanted /= wanted.sum()
    seen = np.bincount(chosen, minlength=4) / count
    assert np.abs(seen - wanted).max() < 4 * np.sqrt(0.25 / count)


def test_proposals_are_accepted_as_the_paper_draws_them():
    """Check two levels with ratio p: half of the visits propose the other; from the better level it
    is accepted with p t, otherwise always.
    """
    count, ratio, heat = 40_000, 0.4, 0.5
    score = np.tile(units([1.0, ratio]), (count, 1))
    for present, wanted in ((0, 0.5 * ratio * heat), (1, 0.5)):
        chosen = np.empty(count, np.uint8)
        site_update.propose_levels(
            score,
            round(65536 * heat),
            POWERS,
            np.full(count, present, np.uint8),
            1,
            np.arange(count),
            np.uint64(3),
            5,
            chosen,
        )
        assert np.mean(chosen != present) == pytest.approx(wanted, abs=4 * np.sqrt(0.25 / count))

"""`mrf`, what it learns on the way: shares of classes, couplings of pairs, and planes that are
turned.
"""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mrf_lattice import empty_lattice

import trabecula as tb
from trabecula.measure.describe import autocorrelation_lines
from trabecula.measure.grey import autocorrelation
from trabecula.synth.mrf import fraction_control
from trabecula.synth.mrf.candidates import extract_neighbourhoods, pixels_along
from trabecula.synth.mrf.density import LOGS, POWERS, UNIT
from trabecula.synth.mrf.fraction_control import (
    SITE,
    add_expected_levels,
    count_expected,
    group_scores,
    level_shifts,
    score_leads,
)
from trabecula.synth.mrf.lattice import SiteClasses, SiteLattice
from trabecula.synth.mrf.relaxation import start_relaxation
from trabecula.synth.mrf.site_update import COLD, COLDEST, coldness, draw_levels
from trabecula.synth.mrf.slice_planes import ViewPlane, oblique_planes, plane_across, union_offsets
from trabecula.synth.mrf.statistics_feedback import PairCouplings

HEATS = (4.0, 1.0, 0.3, 1 / 64)


def blobs(side=48, sigma=(2.0, 2.0), share=0.4, seed=1):
    """Return a thresholded smooth field of two phases."""
    fy, fx = np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side), indexing="ij")
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal((side, side)))
    smooth = np.fft.ifft2(
        noise * np.exp(-2 * np.pi**2 * ((sigma[0] * fy) ** 2 + (sigma[1] * fx) ** 2))
    ).real
    return (smooth > np.quantile(smooth, 1 - share)).astype(np.uint8)


# Shares


def energies(score, groups, cold):
    """Return scores of the groups."""
    count, energy = len(score), np.empty((len(score), int(groups.max()) + 1), np.int64)
    nothing = np.zeros(len(groups), np.int64)
    group_scores(score, np.ones(count, bool), nothing, groups, cold, LOGS, POWERS, energy)
    return energy


def group_shifts(score, groups, wanted, *, coldness, start):
    """Return shifts for levels' scores."""
    energy = np.full((len(score), len(wanted)), -(1 << 40), np.int64)  # what has no level
    found = energies(score, groups, coldness)
    energy[:, : found.shape[1]] = found
    lead = np.empty(len(energy), np.int64)
    return fraction_control.group_shifts(
        energy, np.asarray(wanted), lead, coldness=coldness, start=start
    )


def softmax_shares(score, groups, shift, cold):
    """Return expected shares of the groups, in float64."""
    bits = (score + np.asarray(shift)[groups]) / UNIT * cold / COLD
    weight = np.exp2(bits - bits.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    return np.bincount(groups, weight.mean(0))


def bisect_shift(score, wanted, cold):
    """Return the shift of level 1 over level 0 that gives it its share, in float64."""
    low, high = -1e12, 1e12
    while high - low > 1:
        middle = (low + high) / 2
        below = softmax_shares(score, np.array([0, 1]), [0, middle], cold)[1] < wanted
        low, high = (middle, high) if below else (low, middle)
    return low


def scale_iteratively(score, groups, wanted, cold, rounds=4000):
    """Return shifts of several groups by iterative scaling, in float64, the largest 0."""
    shift = np.zeros(len(wanted))
    for _ in range(rounds):
        shift += np.log2(wanted / softmax_shares(score, groups, shift, cold)) * UNIT * COLD / cold
    return shift - shift.max()


def scores(spread, levels, seed=3, count=1500):
    """Draw normal scores of sites, `spread` bits wide, levels one below the other."""
    rng = np.random.default_rng(seed)
    bits = rng.normal(0, spread, (count, levels)) - spread * np.arange(levels) / 2
    return np.rint(bits * UNIT).astype(np.int32)


@pytest.mark.parametrize("spread", [0.5, 6, 400])
@pytest.mark.parametrize("heat", HEATS)
def test_two_groups_are_shifted_as_far_as_a_bisection_says(spread, heat):
    score, groups, cold = scores(spread, 2), np.array([0, 1], np.uint8), coldness(heat)
    for share in (0.03, 0.5, 0.8):
        wanted = np.array([1 - share, share])
        shift = group_shifts(score, groups, wanted, coldness=cold, start=np.zeros(2, np.int64))
        assert shift.max() == 0
        assert softmax_shares(score, groups, shift, cold)[1] == pytest.approx(share, abs=1e-3)
        if heat >= 0.3 and spread < 100:  # else the share is a staircase, and many shifts do
            assert shift[1] - shift[0] == pytest.approx(bisect_shift(score, share, cold), abs=400)


def test_two_groups_are_settled_at_once_from_any_start():
    score, groups = scores(6, 2), np.array([0, 1], np.uint8)
    found = [
        group_shifts(
            score, groups, np.array([0.3, 0.7]), coldness=COLD, start=np.array(start, np.int64)
        )
        for start in ([0, 0], [0, -(10**8)], [-(10**8), 0], [7 * UNIT, 0])
    ]
    assert np.ptp([shift[1] - shift[0] for shift in found]) <= 512


@pytest.mark.whole
@pytest.mark.parametrize("spread", [0.5, 6, 300])
@pytest.mark.parametrize("heat", [2.0, 1.0, 0.4])
def test_several_groups_come_to_the_shifts_of_iterative_scaling(spread, heat):
    """Check shifts from class to class: each begins at those of the class before."""
    score, cold = scores(spread, 6, count=600), coldness(heat)
    groups, wanted = np.array([0, 0, 1, 2, 2, 3], np.uint8), np.array([0.2, 0.1, 0.3, 0.4])
    shift = np.zeros(4, np.int64)
    for _ in range(12):
        shift = group_shifts(score, groups, wanted, coldness=cold, start=shift)
    assert softmax_shares(score, groups, shift, cold) == pytest.approx(wanted, abs=4e-3)
    if spread < 100:
        assert shift == pytest.approx(
            scale_iteratively(score, groups, wanted, cold), abs=0.03 * UNIT
        )


@pytest.mark.parametrize("spread", [3, 500])
@pytest.mark.parametrize("levels", [2, 5])
def test_at_the_coldest_the_mode_has_the_wanted_shares(levels, spread):
    score, groups = scores(spread, levels, count=4000), np.arange(levels, dtype=np.uint8)
    wanted = np.arange(1, levels + 1) / np.arange(1, levels + 1).sum()
    shift = np.zeros(levels, np.int64)
    for _ in range(1 if levels == 2 else 12):
        shift = group_shifts(score, groups, wanted, coldness=COLDEST, start=shift)
    chosen = (score + shift).argmax(1)
    assert np.bincount(chosen, minlength=levels) / len(chosen) == pytest.approx(wanted, abs=4e-3)


def test_two_heaps_hundreds_of_bits_apart_are_divided_anywhere():
    """Check nine sites in ten that are sure of 0 and one of 1: the target falls in one heap or in
    the other.
    """
    rng = np.random.default_rng(0)
    lead = np.where(np.arange(2000) < 200, 350, -420) + rng.normal(0, 2, 2000)
    score = np.rint(np.stack([np.zeros(2000), lead * UNIT], axis=1)).astype(np.int32)
    groups = np.array([0, 1], np.uint8)
    for share in (0.02, 0.3, 0.97):
        shift = group_shifts(
            score, groups, np.array([1 - share, share]), coldness=COLD, start=np.zeros(2, np.int64)
        )
        assert softmax_shares(score, groups, shift, COLD)[1] == pytest.approx(share, abs=1e-3)
        assert (shift[1] - shift[0] > 0) == (share > 0.1)


@pytest.mark.parametrize("wanted", [(0.0, 1.0), (1.0, 0.0), (0.5, 0.0, 0.5), (0.0, 1.0, 0.0)])
@pytest.mark.parametrize("cold", [COLD, COLDEST])
def test_what_is_not_wanted_never_comes(wanted, cold):
    score, groups = scores(300, len(wanted)), np.arange(len(wanted), dtype=np.uint8)
    shift = np.zeros(len(wanted), np.int64)
    for _ in range(8):
        shift = group_shifts(score, groups, np.array(wanted), coldness=cold, start=shift)
        both = score.astype(np.int64) + shift
        assert np.array_equal(both, score + shift.astype(np.int32)), (
            "they have to fit into the scores' type"
        )
    assert softmax_shares(score, groups, shift, cold) == pytest.approx(np.array(wanted), abs=4e-3)
    assert not (softmax_shares(score, groups, shift, cold)[np.array(wanted) == 0] > 1e-9).any()


def test_a_group_that_has_no_level_takes_nothing():
    score, groups = scores(5, 3), np.array([0, 2, 2], np.uint8)
    wanted, shift = np.array([0.3, 0.0, 0.7]), np.zeros(3, np.int64)
    for _ in range(6):
        shift = group_shifts(score, groups, wanted, coldness=COLDEST, start=shift)
    assert softmax_shares(score, groups, shift, COLDEST) == pytest.approx(wanted, abs=4e-3)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6), spread=st.sampled_from([1, 20, 300]), heat=st.sampled_from(HEATS)
)
def test_scores_of_groups_leads_and_expectations_are_numpys(seed, spread, heat):
    score, cold = scores(spread, 5, seed=seed, count=40), coldness(heat)
    groups, beta = np.array([1, 0, 2, 0, 1], np.uint8), coldness(heat) / COLD
    near = 1e-3 + 1e-3 / beta
    energy = energies(score, groups, cold)
    literal = [
        np.logaddexp2.reduce(beta * score[:, groups == g] / UNIT, axis=1) / beta for g in range(3)
    ]
    assert energy / UNIT == pytest.approx(np.transpose(literal), abs=near)
    shift = np.random.default_rng(seed).integers(-9 * UNIT, 9 * UNIT, 3)
    lead = np.empty(40, np.int64)
    for group in range(3):
        score_leads(energy, shift, group, cold, LOGS, POWERS, lead)
        others = np.delete((energy + shift) / UNIT, group, axis=1)
        above = energy[:, group] / UNIT - np.logaddexp2.reduce(beta * others, axis=1) / beta
        assert lead / UNIT == pytest.approx(above, abs=near)
        added = int(shift[0])
        odds = np.exp2(-np.clip((lead + added) / UNIT * beta, -900, 900))
        assert count_expected(lead, added, cold, POWERS) / SITE == pytest.approx(
            np.sum(1 / (1 + odds)), abs=0.01
        )


@pytest.mark.parametrize("heat", [1e-3, 1e-9, 1e-320])
def test_next_to_no_heat_is_the_mode_and_holds_the_shares(heat):
    """Check a heat that is not too cold for whole numbers of 64 bits."""
    score, groups, wanted = scores(400, 2), np.array([0, 1], np.uint8), np.array([0.7, 0.3])
    shift = group_shifts(
        score, groups, wanted, coldness=coldness(heat), start=np.zeros(2, np.int64)
    )
    shifted = score + shift.astype(np.int32)
    sites, chosen = np.arange(len(score)), np.empty(len(score), np.uint8)
    draw_levels(shifted, coldness(heat), POWERS, sites, np.uint64(7), 0, chosen)
    assert chosen.mean() == pytest.approx(0.3, abs=2e-3)
    apart = np.abs(np.diff(shifted, axis=1)[:, 0]) > UNIT // 2
    assert np.array_equal(chosen[apart], shifted.argmax(1)[apart])


# Couplings


def couplings_of(
    pictures, shape, *, features=((0,), (1,)), edges=(1.0, 1.0, 1.0), reach=4, rate=1.0
):
    return PairCouplings(
        pictures, np.array(features, np.int16), shape, edges=edges, reach=reach, rate=rate
    )


def bins_by_offset(far, edges, shape):
    """Yield every offset of a torus up to `far` away, and its bin."""
    found = {}
    sides = [range(-((side - 1) // 2), (side + 1) // 2) for side in shape]
    for offset in itertools.product(*sides):
        step = np.array(offset) * edges
        distance = int(np.sqrt((step**2).sum()) + 0.5)
        if distance <= far:
            found[offset] = sort_of(step) * (far + 1) + distance
    return found


def sort_of(step):
    """Return the axis nearest to a step, plus 3 where it is not within 22.5 degrees of it."""
    sideways = np.abs(step).max() < np.cos(np.pi / 8) * np.linalg.norm(step)
    return int(np.argmax(np.abs(step))) + 3 * int(sideways)


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (2.0, 1.0, 1.5)])
def test_the_field_is_the_sum_over_offsets_written_out(edges):
    shape, rng = (10, 11, 13), np.random.default_rng(2)
    coupled = couplings_of([(0, blobs(30)), (1, blobs(26, seed=4))], shape, edges=edges)
    levels, domain = rng.integers(0, 2, shape, np.uint8), rng.random(shape) < 0.9
    coupled.strength = rng.normal(0, 2, coupled.strength.shape)
    coupled.update_field(levels, domain)
    mean = np.average([blobs(30).mean(), blobs(26, seed=4).mean()], weights=[900, 676])
    values = (np.arange(2) - mean) / np.sqrt(mean * (1 - mean))
    spread = np.where(domain, values[levels], 0)
    bins = bins_by_offset(4, np.array(edges), shape)
    many = np.bincount(list(bins.values()), minlength=30)
    field = np.zeros(shape)
    for offset, place in bins.items():
        field += (
            coupled.strength[0, place]
            / many[place]
            * np.roll(spread, [-step for step in offset], (0, 1, 2))
        )
    sites = np.array([0, 5, 77, 700, field.size - 1])
    pulled = np.full((len(sites), 2), 9, np.int64)
    coupled.add_to_scores(sites, pulled)
    # the logarithm to base 2 of a density
    literal = np.clip(field.ravel()[sites, None] / np.log(2), -30, 30) * values
    assert np.abs(literal).max() > 1, "nothing is coupled"
    assert (pulled - 9) / UNIT == pytest.approx(literal, abs=4e-3)


def test_no_pair_counts_that_is_near_or_that_no_picture_holds():
    """Check one picture seen across z: pairs along z are in no picture, and next neighbours are
    left to the densities.
    """
    coupled = couplings_of([(0, blobs(30))], (12, 12, 12), reach=5)
    levels = np.random.default_rng(1).integers(0, 2, (12, 12, 12), np.uint8)
    coupled.learn(levels, np.ones(levels.shape, bool))
    strength = coupled.strength.reshape(6, 6)
    assert not strength[[0, 3]].any() and not strength[:, :2].any()
    assert strength[1:3, 2:].all() and strength[4, 2:].all()
    # In a plane none that is nearest to x, beyond 22.5 degrees of it, is 3 long when rounded: (2,
    # 2) counts to y.
    assert (strength[5] != 0).tolist() == [False, False, True, False, True, True]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_targets_are_the_autocorrelation_of_the_picture(axis):
    """Compare offset by offset with `measure`, of each phase where there are three: the mean over
    the pairs of a bin.
    """
    picture = blobs(40, sigma=(4, 1.5)) + blobs(40, seed=5, share=0.2)
    rows, columns = (other for other in range(3) if other != axis)
    coupled = couplings_of([(axis, picture)], (16, 16, 16), features=np.eye(3), reach=6)
    for phase in range(3):
        rho = autocorrelation(tb.Image((picture == phase).astype(np.uint8), "labels"), lags=6)
        sums, pairs = np.zeros(42), np.zeros(42)
        for down, along in itertools.product(range(-6, 7), repeat=2):
            distance = int(np.hypot(down, along) + 0.5)
            if distance > 6:
                continue
            step = np.zeros(3)
            step[rows], step[columns] = down, along
            place = sort_of(step) * 7 + distance
            count = (40 - abs(down)) * (40 - abs(along))
            sums[place] += count * rho[down + 6, along + 6]
            pairs[place] += count
        assert coupled._wanted[phase] == pytest.approx(sums / np.maximum(pairs, 1), abs=1e-4)


def test_the_misfit_is_of_pairs_that_are_there():
    """Compare with the definition: root mean square over the bins of the picture's autocorrelation
    less the output's.
    """
    shape, rng = (12, 13, 11), np.random.default_rng(6)
    pictures = [(axis, blobs(30, seed=axis)) for axis in range(3)]
    coupled = couplings_of(pictures, shape, rate=0.5)
    levels = blobs(13, sigma=(1, 1))[None, :, :11].repeat(12, 0)
    share = np.mean([picture.mean() for _, picture in pictures])
    values = (levels - share) / np.sqrt(share * (1 - share))
    bins = bins_by_offset(4, np.ones(3), shape)
    for domain in (np.ones(shape, bool), rng.random(shape) < 0.5):
        sums, pairs = np.zeros(30), np.zeros(30)
        for offset, place in bins.items():
            both = domain & np.roll(domain, offset, (0, 1, 2))
            sums[place] += (values * np.roll(values, offset, (0, 1, 2)))[both].sum()
            pairs[place] += np.count_nonzero(both)
        now = sums / np.maximum(pairs, 1)
        held = (np.arange(30) % 5 >= 2) & (np.arange(30) != 5 * 5 + 3)  # (2, 2) counts to y
        apart = (coupled._wanted[0] - now / now[0])[held]
        before = coupled.strength.copy()
        coupled.learn(levels, domain)
        assert coupled.misfit == pytest.approx(np.sqrt(np.mean(apart**2)), abs=1e-4)
        assert (coupled.strength - before)[0, held] == pytest.approx(0.5 * apart, abs=1e-4)


def test_strengths_go_to_a_finer_scale_at_twice_the_distance():
    """Check that strength at distance r is found at 2 r, half as strong, and interpolated
    between.
    """
    pictures = [(axis, blobs(48)) for axis in range(3)]
    fine = couplings_of(pictures, (24, 24, 24), reach=8)
    coarse = couplings_of(
        [(axis, picture[::2, ::2]) for axis, picture in pictures], (12, 12, 12), reach=4
    )
    coarse.strength = np.random.default_rng(3).normal(size=coarse.strength.shape)
    levels = np.zeros((24, 24, 24), np.uint8)
    fine.start(coarse.strength, levels, np.ones(levels.shape, bool))
    known, found = coarse.strength.reshape(6, 5), fine.strength.reshape(6, 9)
    assert found[:, 2::2] == pytest.approx(known[:, 1:] / 2)
    between = (known[:, 1:4] + known[:, 2:5]) / 4
    between[5, 0] = 0  # of which no picture holds any
    assert found[:, 3::2] == pytest.approx(between)
    assert not found[:, :2].any()
    pulled = np.zeros((1, 2), np.int64)
    fine.add_to_scores(np.array([0]), pulled)
    assert pulled.any(), "they count from the first sweep on"


@pytest.mark.whole
def test_learning_drives_a_field_of_pairs_alone_to_the_pictures_autocorrelation():
    """Check spins with nothing but their couplings, drawn a third at a time by their
    conditional.
    """
    picture, side, rng = blobs(64, sigma=(2, 2), share=0.5), 16, np.random.default_rng(4)
    coupled = couplings_of([(axis, picture) for axis in range(3)], (side,) * 3, reach=7, rate=2.0)
    levels, domain = rng.integers(0, 2, (side,) * 3, np.uint8), np.ones((side,) * 3, bool)
    misfits = []
    for _ in range(60):
        coupled.learn(levels, domain)
        misfits.append(coupled.misfit)
        for part in np.array_split(rng.permutation(levels.size), 3):
            pulled = np.zeros((len(part), 2), np.int64)
            coupled.add_to_scores(part, pulled)
            odds = np.exp2((pulled[:, 0] - pulled[:, 1]) / UNIT)
            levels.reshape(-1)[part] = rng.random(len(part)) < 1 / (1 + odds)
            coupled.update_field(levels, domain)
    assert misfits[0] > 0.15
    assert np.mean(misfits[-10:]) < 0.4 * misfits[0]


# Planes


@pytest.mark.parametrize("plane", [plane_across(0), plane_across(2), *oblique_planes(1)])
def test_a_plane_seen_from_behind_has_its_columns_the_other_way(plane):
    straight, behind = (each.offsets(5).reshape(-1, 3) for each in (plane, plane.mirror_image))
    grid = np.insert(straight, 12, 0, axis=0).reshape(5, 5, 3)
    assert np.array_equal(np.insert(behind, 12, 0, axis=0).reshape(5, 5, 3), grid[:, ::-1])
    assert plane.mirror_image.mirror_image == plane


@pytest.mark.whole
def test_oblique_planes_see_the_picture_from_behind_in_every_other_round():
    """Check that other sweeps never do: their picture may lean one way."""
    seen: list[bool] = []
    for oblique, wanted in ((True, [False] * 4 + [True] * 4), (False, [False] * 8)):
        model = tb.method(
            "mrf", neighbourhood=3, scales=1, sweeps=8, polish=0, oblique=oblique
        ).fit(tb.Image(blobs(40), "labels"))
        lattice = empty_lattice(model, tb.Request(12))
        relaxation = start_relaxation(
            lattice,
            None,
            model._view_sets(model.candidate_sets[0]),
            model.content,
            model.config,
            seed=1,
            scale=0,
            wanted=model._target_shares(None),
            couplings=None,
        )
        for view_set in relaxation._view_sets:
            honest = view_set.log_densities
            view_set.log_densities = lambda *a, mirrored, honest=honest: (
                seen.append(mirrored),
                honest(*a, mirrored=mirrored),
            )[1]
        for step, mirrored in zip(relaxation._steps(), wanted, strict=True):
            seen.clear()
            relaxation.sweep(step)
            assert set(seen) == {mirrored}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turned_planes_are_orthogonal_and_hold_diagonals(axis):
    planes = oblique_planes(axis)
    normals = [np.cross(plane.rows, plane.columns) for plane in planes]
    for plane in planes:
        assert np.dot(plane.rows, plane.columns) == 0
    for first, second in itertools.combinations(normals, 2):
        assert np.dot(first, second) == 0
    assert [plane.diagonal for plane in planes] == [(True, True), (False, True), (False, True)]
    # The first lies in the plane across the axis; the others contain the axis, 45 degrees from the
    # two others.
    assert np.flatnonzero(normals[0]).tolist() == [axis]
    for plane, normal in zip(planes[1:], normals[1:], strict=True):
        assert (
            np.flatnonzero(plane.rows).tolist() == [axis]
            and normal[axis] == 0
            and np.abs(normal).sum() == 2
        )


@pytest.mark.parametrize("plane", [plane_across(1), *oblique_planes(0), *oblique_planes(2)])
@pytest.mark.parametrize("width", [3, 7])
def test_neighbours_and_the_pictures_pixels_are_equally_far(plane, width):
    """Check in the order of offsets: a neighbour stands for the pixel at its own distance along
    rows and columns, rounded.
    """
    rows, columns = (pixels_along(width, wide) for wide in plane.diagonal)
    pixels = np.delete(
        np.stack(np.meshgrid(rows, columns, indexing="ij"), -1).reshape(-1, 2),
        width**2 // 2,
        axis=0,
    )
    units = np.stack(
        [np.divide(step, np.linalg.norm(step)) for step in (plane.rows, plane.columns)]
    )
    along = plane.offsets(width) @ units.T
    assert np.abs(along - pixels).max() <= 0.5
    assert np.all(np.sign(np.rint(along)) == np.sign(pixels))


@pytest.mark.parametrize("diagonal", list(itertools.product([False, True], repeat=2)))
@pytest.mark.parametrize("scale", [0, 1])
def test_neighbourhoods_take_the_pixels_of_their_plane(diagonal, scale):
    """Check a picture whose pixels all differ, so that each neighbour shows its pixel."""
    picture = np.arange(16 * 15, dtype=np.uint8).reshape(16, 15)
    neighbourhoods = extract_neighbourhoods(
        picture, scale=scale, width=5, every=True, diagonal=diagonal
    )
    steps = [[-3, -1, 0, 1, 3] if wide else [-2, -1, 0, 1, 2] for wide in diagonal]
    stride = 2**scale
    reach = [stride * steps[0][-1], stride * steps[1][-1]]
    wanted = {}
    for r, c in itertools.product(range(reach[0], 16 - reach[0]), range(reach[1], 15 - reach[1])):
        near = [
            picture[r + stride * dr, c + stride * dc]
            for dr in steps[0]
            for dc in steps[1]
            if dr or dc
        ]
        wanted[picture[r, c]] = near
    assert sorted(neighbourhoods.centres) == sorted(wanted)
    for centre, around in zip(neighbourhoods.centres, neighbourhoods.around, strict=True):
        assert np.array_equal(around, wanted[centre])


@settings(max_examples=20)
@given(shape=st.tuples(*[st.integers(5, 13)] * 3), width=st.sampled_from([3, 5]))
def test_sites_of_a_class_for_turned_planes_do_not_see_each_other(shape, width):
    classes = SiteClasses(SiteLattice(np.zeros(shape, np.uint8)), width, oblique=True)
    offsets = union_offsets([plane for axis in range(3) for plane in oblique_planes(axis)], width)
    flat, seen = np.arange(np.prod(shape)), []
    for name in classes.names:
        sites = classes.sites(name, 0, shape[0])
        near = (np.stack(np.unravel_index(sites, shape), -1)[:, None] + offsets) % shape
        assert not np.isin(
            np.ravel_multi_index(tuple(np.moveaxis(near, -1, 0)), shape), sites
        ).any()
        seen.append(sites)
    assert np.array_equal(np.sort(np.concatenate(seen)), flat)


def test_an_oblique_sweep_of_width_7_needs_128_classes():
    """Check planes of two diagonals, which reach 6 voxels along an axis: sites 4 apart are in
    different classes.
    """
    assert (
        len(SiteClasses(SiteLattice(np.zeros((16, 16, 16), np.uint8)), 7, oblique=True).names)
        == 128
    )
    assert [0, 6, 0] in union_offsets(oblique_planes(0), 7).tolist()


# As a whole


def made(picture, shape=20, **config):
    model = tb.method("mrf", **{"neighbourhood": 5, "scales": 1, "sweeps": (8,), **config}).fit(
        tb.Image(picture, "labels")
    )
    return model.generate((shape,) * 3, seed=1, periodic=True)


def report(image):
    return image.recipe.steps[-1]["report"]


@pytest.mark.whole
def test_an_isotropic_picture_goes_by_turned_planes_and_a_striped_one_does_not():
    assert report(made(blobs(48), 10))["oblique"] is True
    assert report(made(blobs(48, sigma=(8, 1)), 10))["oblique"] is False
    assert report(made(blobs(48), 10, views=("yx", "zx")))["oblique"] is False, (
        "two planes are not all directions"
    )
    assert report(made(blobs(48), 10, oblique=False))["oblique"] is False


def test_oblique_planes_learn_the_diagonals():
    """Check the views of a sweep: three along the axes, then three about each axis, each learning
    from its own pixels.
    """
    model = tb.method("mrf", neighbourhood=5, scales=1).fit(tb.Image(blobs(48), "labels"))
    view_sets = model._view_sets(model.candidate_sets[0])
    assert [{slice_view.plane for slice_view in slice_views} for slice_views in view_sets[1:]] == [
        set(oblique_planes(axis)) for axis in range(3)
    ]
    for slice_view in itertools.chain(*view_sets):
        neighbourhoods = extract_neighbourhoods(
            model.content.pictures[0],
            scale=0,
            width=5,
            every=True,
            diagonal=slice_view.plane.diagonal,
        )
        assert np.array_equal(slice_view.candidates.marginal, np.bincount(neighbourhoods.centres))
        assert slice_view.candidates is model.candidate_sets[0][slice_view.learner]
    assert ViewPlane((0, 1, 1), (0, 1, -1)) in {slice_view.plane for slice_view in view_sets[1]}


@pytest.mark.parametrize("oblique", [False, True])
def test_strong_couplings_do_not_turn_everything_over_at_every_sweep(oblique):
    """Check pairs far apart that repel: with the field of the sweep before, domains would flip for
    ever.
    """
    noise = (np.random.default_rng(1).random((40, 40)) < 0.5).astype(np.uint8)
    model = tb.method(
        "mrf", neighbourhood=3, scales=1, coupling=1e-6, feedback=0, reach=6, oblique=oblique
    ).fit(tb.Image(noise, "labels"))
    lattice = empty_lattice(model, tb.Request((18, 18, 18), seed=1, periodic=True))
    couplings = model._start_couplings(0, lattice)
    couplings.strength = np.where(couplings._held, -0.5, 0.0)[None].reshape(
        couplings.strength.shape
    )
    view_sets = model._view_sets(model.candidate_sets[0])
    relaxation = start_relaxation(
        lattice,
        None,
        view_sets,
        model.content,
        model.config,
        seed=1,
        scale=0,
        wanted=model._target_shares(None),
        couplings=couplings,
    )
    lattice.levels[:9] = 1  # half full: what is to be broken up
    lattice.levels[9:] = 0
    couplings.update_field(lattice.levels, lattice.domain)
    overlaps = []
    for step in relaxation._steps()[:6]:
        before = lattice.levels - lattice.levels.mean()
        relaxation.sweep(step)
        couplings.learn(lattice.levels, lattice.domain)
        overlaps.append(
            np.mean(before * (lattice.levels - lattice.levels.mean()))
            / before.std()
            / lattice.levels.std()
        )
    assert np.mean(overlaps[2:]) > -0.5, overlaps


@pytest.mark.slow
def test_couplings_bring_the_autocorrelation_nearer_to_the_pictures():
    """Check against a run without them, in which domains grow from sweep to sweep."""
    picture = blobs(64, sigma=(2.5, 2.5))
    wanted = np.mean(
        list(autocorrelation_lines(tb.Image(picture, "labels"), lags=9).values()), axis=0
    )
    apart = []
    for coupling in (0.0, 1.5):
        result = made(picture, 28, coupling=coupling, reach=10, scales=2, sweeps=(8, 12))
        lines = autocorrelation_lines(result, lags=9)
        apart.append(np.sqrt(np.mean((np.mean(list(lines.values()), axis=0) - wanted) ** 2)))
    assert apart[1] < 0.5 * apart[0], apart


@pytest.mark.whole
def test_a_picture_with_a_large_plateau_is_made_with_its_shares():
    """Check grey where one level is half of the picture: groups of levels beside it are empty."""
    values = np.maximum(blobs(48).astype(np.float64) + np.linspace(-1, 1, 48), 0.6) * 100
    picture = tb.Image(values.astype(np.uint8), "grey")
    lowest = picture.values.min()
    assert np.mean(picture.values == lowest) > 0.4
    model = tb.method("mrf", sweeps=(2,), scales=2, neighbourhood=3, candidates=256).fit(picture)
    assert len(np.unique(model.content.groups)) <= model.content.groups.max()
    made = model.generate(16, seed=1).values
    assert np.mean(made == lowest) == pytest.approx(np.mean(picture.values == lowest), abs=0.03)


def test_levels_of_a_group_come_to_their_shares_class_by_class():
    """Check grey: groups are solved at once, the levels within them over a few classes; none is
    lost for good.
    """
    groups = np.repeat(np.arange(3, dtype=np.uint8), 4)
    wanted = np.random.default_rng(3).dirichlet(np.full(12, 2.0))
    by_group, coarse, fine = (
        np.bincount(groups, wanted),
        np.zeros(3, np.int64),
        np.zeros(12, np.int64),
    )
    for seed in range(40):
        bias = np.linspace(-4, 4, 12) * UNIT  # a density that likes the last levels alone
        score = np.rint(np.random.default_rng(seed).normal(0, 2 * UNIT, (600, 12)) + bias).astype(
            np.int32
        )
        with_fine = score + fine.astype(np.int32)
        coarse = group_shifts(with_fine, groups, by_group, coldness=COLD, start=coarse)
        shift, total = coarse[groups] + fine, np.zeros(12)
        shifted = score + shift
        add_expected_levels(score, np.ones(600, bool), shift, COLD, POWERS, total)
        fine = level_shifts(total, groups, wanted, count=600, coldness=COLD, shift=fine)
    assert total.sum() == pytest.approx(600)
    assert total / 600 == pytest.approx(wanted, abs=0.02)
    literal = np.exp2(shifted / UNIT - (shifted / UNIT).max(1, keepdims=True))
    assert total / 600 == pytest.approx((literal / literal.sum(1, keepdims=True)).mean(0), abs=1e-3)

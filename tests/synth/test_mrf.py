"""`mrf` as a whole: exact conditionals, the paper's relaxations against literal loops, and every
part of a request.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mrf_lattice import empty_lattice

import trabecula as tb
from trabecula.core.seeds import generator, key
from trabecula.engine import checkpoint
from trabecula.engine.random import philox
from trabecula.errors import InputError, RequestError
from trabecula.synth.api.registry import recorded_method
from trabecula.synth.mrf.candidates import extract_neighbourhoods, reweight_by_porosity
from trabecula.synth.mrf.density import STEPS
from trabecula.synth.mrf.lattice import (
    SiteClasses,
    SiteLattice,
    coarsen_any,
    coarsen_known,
    dilate_box,
    half_shape,
)
from trabecula.synth.mrf.picture_levels import median_cut_palette, number_levels
from trabecula.synth.mrf.random_order import draw_turns
from trabecula.synth.mrf.relaxation import Relaxation, start_relaxation
from trabecula.synth.mrf.slice_planes import SliceView, plane_across, union_offsets
from trabecula.synth.mrf.statistics_feedback import JointHistogram, bias_change, joint_histogram

NONE = {"feedback": 0.0, "coupling": 0.0, "shares": False, "oblique": False, "final_heat": (1.0,)}


def stripes(side=40, period=8):
    """Return blobs of two phases with a length of their own."""
    rng = np.random.default_rng(1)
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=(side, side))) * _band(side, period)).real
    return tb.Image((noise > np.quantile(noise, 0.6)).astype(np.uint8), "labels")


def _band(side, period):
    k = np.fft.fftfreq(side)
    return np.exp(-(((np.hypot(k[:, None], k[None]) - 1 / period) * 3 * period) ** 2))


@pytest.fixture(scope="module")
def picture():
    return stripes()


def neighbours_of(site, axes, width, shape):
    """Return all places in the neighbourhood of a site in any plane of a torus, as a set."""
    return {
        tuple(int(p) for p in (np.array(site) + offset) % shape)
        for offset in union_offsets([plane_across(axis) for axis in axes], width)
    }


@pytest.mark.whole
@settings(max_examples=25)
@given(
    shape=st.tuples(*[st.integers(5, 13)] * 3),
    width=st.sampled_from([3, 5]),
)
def test_sites_of_a_class_do_not_see_each_other_and_classes_hold_all(shape, width):
    classes = SiteClasses(SiteLattice(np.zeros(shape, np.uint8)), width)
    seen = []
    for name in classes.names:
        sites = classes.sites(name, 0, shape[0])
        parts = [
            classes.sites(name, first, min(first + 2, shape[0])) for first in range(0, shape[0], 2)
        ]
        assert np.array_equal(np.concatenate(parts), sites)
        seen.append(sites)
        site_class = {
            tuple(int(c) for c in place) for place in np.array(np.unravel_index(sites, shape)).T
        }
        for site in list(site_class)[:4]:
            assert not site_class & neighbours_of(site, (0, 1, 2), width, shape)
    assert np.array_equal(np.sort(np.concatenate(seen)), np.arange(np.prod(shape)))


def test_a_sweep_of_width_7_needs_16_classes():
    assert len(SiteClasses(SiteLattice(np.zeros((16, 16, 16), np.uint8)), 7).names) == 16


def test_offsets_follow_the_pictures_rows_and_columns():
    assert plane_across(0).offsets(3).tolist()[:4] == [
        [0, -1, -1],
        [0, -1, 0],
        [0, -1, 1],
        [0, 0, -1],
    ]
    assert plane_across(1).offsets(3).tolist()[:2] == [[-1, 0, -1], [-1, 0, 0]]
    assert plane_across(2).offsets(3).tolist()[:2] == [[-1, -1, 0], [-1, 0, 0]]
    assert (
        len(union_offsets([plane_across(axis) for axis in range(3)], 7)) == 3 * 36 + 18
    )  # three planes without their lines, and three lines


def test_only_free_sites_are_asked():
    free = np.random.default_rng(1).random((9, 10, 11)) < 0.4
    classes = SiteClasses(SiteLattice(np.zeros(free.shape, np.uint8), free=free), 5)
    found = np.concatenate([classes.sites(name, 0, 9) for name in classes.names])
    assert np.array_equal(np.sort(found), np.flatnonzero(free))


@given(shape=st.tuples(*[st.integers(5, 9)] * 3), seed=st.integers(0, 99), reach=st.integers(1, 3))
@settings(max_examples=20)
def test_a_form_grows_by_a_box_around_every_voxel(shape, seed, reach):
    rng = np.random.default_rng(seed)
    form = rng.random([rng.integers(3, side + 1) for side in shape]) < 0.03
    literal = np.zeros(shape, bool)
    for place in np.argwhere(form):
        literal[
            np.ix_(
                *[
                    (np.arange(p - reach, p + reach + 1)) % side
                    for p, side in zip(place, shape, strict=True)
                ]
            )
        ] = 1
    assert np.array_equal(dilate_box(form, shape, reach), literal)


@pytest.mark.parametrize("shaped", [False, True])
def test_what_is_asked_and_known_is_counted(shaped):
    rng = np.random.default_rng(2)
    levels, free = rng.integers(0, 3, (9, 8, 7)).astype(np.uint8), rng.random((9, 8, 7)) < 0.6
    asked = np.zeros(levels.shape, bool)
    form = rng.random((6, 8, 5)) < 0.5 if shaped else None
    asked[:6, :, :5] = True if form is None else form
    lattice = SiteLattice(levels, free=free, box=(6, 8, 5), form=form)
    assert np.array_equal(lattice.in_result(np.arange(levels.size)), asked.ravel())
    assert np.array_equal(lattice.result_mask(4, 9), asked[4:])
    left, held = lattice.count_known(3)
    assert left == np.count_nonzero(asked & free)
    assert held.tolist() == np.bincount(levels[asked & ~free], minlength=3).tolist()
    lattice.free = None
    assert lattice.count_known(3)[0] == asked.sum() and not lattice.count_known(3)[1].any()


@pytest.mark.parametrize("shape", [(4, 6, 8), (5, 7, 3)])
def test_a_cell_is_marked_where_any_of_its_eight_is(shape):
    marks = np.random.default_rng(3).random(shape) < 0.1
    found = coarsen_any(marks)
    assert found.shape == half_shape(shape)
    for z, y, x in np.ndindex(found.shape):
        assert (
            found[z, y, x] == marks[2 * z : 2 * z + 2, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2].any()
        )


def start_finest(model, lattice, coarse, slice_views, seed=1):
    """Start the finest scale, without couplings."""
    return start_relaxation(
        lattice,
        coarse,
        [slice_views],
        model.content,
        model.config,
        seed=seed,
        scale=0,
        wanted=model._target_shares(None),
        couplings=None,
    )


def relaxation_of(image, shape, config, *, seed=1):
    """Return one scale of three views at its start, and its model."""
    model = tb.method("mrf", **config).fit(image)
    request = tb.Request(shape, seed=seed, periodic=True)
    lattice = empty_lattice(model, request)
    slice_views = [
        SliceView(plane_across(axis), model.candidate_sets[0][0], 0) for axis in range(3)
    ]
    return model, start_finest(model, lattice, None, slice_views, seed)


def literal_density(model, levels, site, weights, views=(0, 1, 2)):
    """Compute equations 3 to 9 at one site: the views' shares (V, L). `weights` (Z, Y, X) float64
    of the neighbours.
    """
    config, content = model.config, model.content
    neighbourhoods = extract_neighbourhoods(
        content.pictures[0], scale=0, width=config.neighbourhood, every=config.every
    )
    features = content.features.astype(float)
    h = model.candidate_sets[0][0].bandwidth
    shares = []
    for axis in views:
        apart = np.zeros(len(neighbourhoods.centres))
        for k, offset in enumerate(plane_across(axis).offsets(config.neighbourhood)):
            place = tuple((np.array(site) + offset) % levels.shape)
            difference = features[levels[place]] - features[neighbourhoods.around[:, k]]
            apart += weights[place] * (difference**2).sum(1)
        centre = ((features[:, None] - features[neighbourhoods.centres][None]) ** 2).sum(2)
        share = np.exp(-(apart[None] - apart.min() + centre) / (2 * h * h)).sum(1)
        shares.append(share / share.sum())
    return np.array(shares)


def test_gibbs_draws_from_the_exact_conditional():
    """Check sites far apart in a known surrounding, all alike: their levels are draws from one
    conditional.
    """
    image = tb.Image((np.random.default_rng(2).random((30, 30)) < 0.4).astype(np.uint8), "labels")
    model, relaxation = relaxation_of(
        image,
        (30, 30, 30),
        {"neighbourhood": 3, "scales": 1, "correction": 1.0, "sweeps": (6,), "polish": 0, **NONE},
    )
    tile = np.random.default_rng(3).integers(0, 2, (3, 3, 3)).astype(np.uint8)
    relaxation.lattice.levels[:] = np.tile(tile, (10, 10, 10))
    relaxation.lattice.free = np.zeros((30, 30, 30), bool)
    relaxation.lattice.free[1::3, 1::3, 1::3] = True
    shares = literal_density(model, relaxation.lattice.levels, (4, 4, 4), np.ones((30,) * 3))
    marginal = np.bincount(image.values[1:-1, 1:-1].ravel()) / 28**2
    wanted = shares.prod(0) / marginal**2
    drawn = []
    for step in relaxation._steps():
        relaxation.sweep(step)
        drawn.append(relaxation.lattice.levels[1::3, 1::3, 1::3].mean())
    assert np.mean(drawn) == pytest.approx(wanted[1] / wanted.sum(), abs=4 * np.sqrt(0.25 / 6000))
    assert 0.05 < np.mean(drawn) < 0.95, (
        "the surrounding decides everything: it says nothing of the draw"
    )


def literal_order(order, lattice, width, sweep):
    """Return the sites of a sweep of scale 0, one after the other."""
    if order == "random":
        word = key(1, "mrf/0/turns")
        priority = [
            int(philox(word, site, site >> 32, sweep, 0)[0]) for site in range(lattice.levels.size)
        ]
        found = sorted(range(len(priority)), key=lambda site: (-priority[site], site))
        return [site for site in found if lattice.free.flat[site]]
    classes = SiteClasses(lattice, width)
    names = generator(1, "mrf/0/order", sweep).permutation(len(classes.names))
    return [
        site for place in names for site in classes.sites(classes.names[place], 0, lattice.shape[0])
    ]


@pytest.mark.whole
@pytest.mark.parametrize("order", ["random", "classes"])
@pytest.mark.parametrize("kind", ["labels", "grey"])
def test_icm_is_the_literal_loop(kind, order):
    """Check figure 1, left: arg max with (1 - t)^2, then equation 8; sweeps of a small lattice, one
    site after the other, each seeing what the one before has become.
    """
    rng = np.random.default_rng(5)
    values = (
        rng.integers(0, 2, (14, 14))
        if kind == "labels"
        else rng.integers(0, 6, (14, 14)).astype(np.uint8) * 40
    )
    shape = (6, 5, 7)
    settings = {
        **{"preset": "paper", "neighbourhood": 3, "scales": 1, "stop": 1.0},
        **{"xi": -3.0, "start": 1.0 if kind == "labels" else 0.8, "bandwidth": 1.0, "order": order},
    }
    model, relaxation = relaxation_of(tb.Image(values, kind), shape, settings)
    relaxation.lattice.domain = np.ones(shape, bool)
    relaxation.lattice.domain[2, 1, 3] = relaxation.lattice.domain[4, 4, 0] = False
    relaxation.lattice.free = relaxation.lattice.domain.copy()
    levels, domain = relaxation.lattice.levels.copy(), relaxation.lattice.domain
    temperature = np.full(shape, relaxation.start, np.float32)
    moves = []
    for step in relaxation._steps()[:6]:
        changed = relaxation.sweep(step)
        before = levels.copy()
        for place in literal_order(order, relaxation.lattice, 3, step.number):
            site = np.unravel_index(place, shape)
            if temperature[site] <= 0:
                continue
            weights = domain * np.floor(STEPS * (1 - temperature.astype(float)) ** 2 + 0.5) / STEPS
            product = literal_density(model, levels, site, weights).prod(0)
            best = np.sort(product)[::-1]
            if best[0] > 1.01 * best[1]:
                levels[site] = product.argmax()
            else:  # too close for the tables: follow
                levels[site] = relaxation.lattice.levels[site]
            near = [place for place in neighbours_of(site, (0, 1, 2), 3, shape) if domain[place]]
            temperature[site] = max(
                0.0, (-3 + sum(float(temperature[place]) for place in near)) / len(near)
            )
        assert np.array_equal(levels, relaxation.lattice.levels)
        assert np.allclose(temperature[domain], relaxation.temperature[domain], atol=1e-6)
        assert changed == np.count_nonzero(before != levels)
        moves.append(changed)
    assert moves[0] > 0 < sum(moves[1:]), "the later sweeps say nothing"


def drawn_turns(lattice, width, sweep=0, temperature=None, held=None):
    """Return the turns of a sweep of a lattice, and their number by site (0: not visited)."""
    offsets = union_offsets([plane_across(axis) for axis in range(3)], width)
    turns = draw_turns(
        lattice,
        offsets,
        np.zeros((0, 0, 0), np.float32) if temperature is None else temperature,
        np.zeros((0, 0, 0), bool) if held is None else held,
        key=key(7, "turns"),
        sweep=sweep,
        turn=np.empty(lattice.shape, np.uint16),
        priority=np.empty(lattice.shape, np.uint32),
    )
    number = np.zeros(lattice.levels.size, int)
    for name in turns.names:
        sites = turns.sites(name, 0, lattice.shape[0])
        assert len(sites) and not number[sites].any()
        number[sites] = name[0]
    return turns, number.reshape(lattice.shape)


@pytest.mark.whole
@settings(max_examples=10)
@given(shape=st.tuples(*[st.integers(5, 9)] * 3), width=st.sampled_from([3, 5]))
def test_turns_are_the_random_order(shape, width):
    """A site's turn is the one after the last of its neighbours of higher priority: so no two sites
    of a turn are neighbours, and turn by turn is site by site.
    """
    rng = np.random.default_rng(3)
    lattice = SiteLattice(np.zeros(shape, np.uint8), free=rng.random(shape) < 0.8)
    _, found = drawn_turns(lattice, width)
    word, literal = key(7, "turns"), np.zeros(shape, int)
    for site in sorted(
        np.flatnonzero(lattice.free), key=lambda s: (-int(philox(word, s, s >> 32, 0, 0)[0]), s)
    ):
        place = tuple(int(c) for c in np.unravel_index(site, shape))
        near = neighbours_of(place, (0, 1, 2), width, shape) - {place}
        literal[place] = 1 + max(literal[one] for one in near)
    assert np.array_equal(found, literal)


def test_turns_depend_on_the_sweep_and_not_on_threads():
    lattice = SiteLattice(np.zeros((24, 9, 10), np.uint8))
    _, one = drawn_turns(lattice, 7)
    with tb.threads(3):
        assert np.array_equal(drawn_turns(lattice, 7)[1], one)
    assert not np.array_equal(drawn_turns(lattice, 7, sweep=1)[1], one)
    assert one.min() == 1
    turns = drawn_turns(lattice, 7)[0]
    parts = [turns.sites((3,), first, first + 4) for first in range(0, 24, 4)]
    assert np.array_equal(np.concatenate(parts), turns.sites((3,), 0, 24))


def test_cold_sites_have_no_turn_unless_they_are_held():
    rng = np.random.default_rng(4)
    lattice = SiteLattice(np.zeros((9, 10, 11), np.uint8))
    temperature = np.float32(rng.random(lattice.shape) < 0.5)
    held = rng.random(lattice.shape) < 0.1
    assert np.array_equal(drawn_turns(lattice, 5, 0, temperature)[1] > 0, temperature > 0)
    asked = drawn_turns(lattice, 5, 0, temperature, held)[1] > 0
    assert np.array_equal(asked, (temperature > 0) | held)


@pytest.mark.whole
def test_in_a_random_order_nothing_repeats_with_the_lattice_of_classes():
    """By classes and from temperature 1, where nothing of the start is seen, all sites of a class
    stay alike: the result repeats every 4 voxels.
    """
    smooth = np.fft.ifft2(
        np.fft.fft2(np.random.default_rng(9).normal(size=(24, 24))) * _band(24, 8)
    )
    values = np.clip(128 + 70 * smooth.real / smooth.real.std(), 0, 255).astype(np.uint8)
    settings = {"scales": 1, "start": 1.0, "xi": -60.0, "bandwidth": 0.1}
    found = {}
    for order in ("classes", "random"):
        made = tb.method("mrf", preset="paper", order=order, **settings)
        made = made.fit(tb.Image(values, "grey")).generate(12, seed=1, periodic=True).values
        assert made.std() > 0
        found[order] = np.mean(made == np.roll(made, (4, 4, 4), (0, 1, 2)))
    assert found["classes"] == 1
    assert found["random"] < 0.4


def test_recipes_of_before_keep_their_order():
    before = recorded_method("mrf", {"relaxation": "icm"}).config
    assert (before.order, before.start) == ("classes", (1.0,))
    assert tb.method("mrf", relaxation="icm").config.order == "random"
    assert tb.method("mrf").config.order == "classes"
    assert recorded_method("mrf", {"relaxation": "icm", "order": "random"}).config.order == "random"


@pytest.mark.slow
def test_the_papers_preset_keeps_both_phases(picture):
    """With h_opt and temperature 1 at the start, as written, one phase is left."""
    shares = []
    for changed in ({}, {"bandwidth": 1.0, "start": 1.0, "xi": -3.0, "every": False}):
        model = tb.method("mrf", preset="paper", scales=2, **changed).fit(picture)
        shares.append(model.generate(8, seed=1, periodic=False).values.mean())
    assert abs(shares[0] - picture.values.mean()) < 0.2
    assert min(shares[1], 1 - shares[1]) < 0.05


@pytest.mark.whole
def test_icm_ends_where_the_temperature_has_fallen_by_95_per_cent(picture):
    made = tb.method("mrf", preset="paper", scales=2).fit(picture).generate((14, 15, 16), seed=1)
    scales = made.recipe.steps[-1]["report"]["scales"]
    assert [scale["scale"] for scale in scales] == [1, 0]
    assert all(scale["fall"] >= 0.95 for scale in scales)
    # One in eight voxels of the finer scale begins with full confidence.
    assert len(scales[1]["changed"]) < len(scales[0]["changed"]) < 100


@pytest.mark.whole
def test_inherited_voxels_are_questioned_or_fixed(picture):
    config = {"preset": "paper", "scales": 2, "upsampling": "one"}
    coarse = np.random.default_rng(4).integers(0, 2, (6, 6, 6)).astype(np.uint8)
    kept = []
    for resynthesis in (True, False):
        model = tb.method("mrf", **config, resynthesis=resynthesis).fit(picture)
        lattice = empty_lattice(model, tb.Request((12, 12, 12), seed=1, periodic=True))
        slice_views = [
            SliceView(plane_across(axis), model.candidate_sets[0][0], 0) for axis in range(3)
        ]
        relaxation = start_finest(model, lattice, coarse, slice_views)
        assert np.array_equal(relaxation.lattice.levels[::2, ::2, ::2], coarse)
        relaxation.run()
        assert not relaxation.temperature[::2, ::2, ::2].any()
        kept.append(np.mean(relaxation.lattice.levels[::2, ::2, ::2] == coarse))
    assert kept[1] == 1 > kept[0]


def test_upsampling_gives_one_of_eight_or_all(picture):
    coarse = np.random.default_rng(4).integers(0, 2, (6, 5, 4)).astype(np.uint8)
    for way in ("one", "all"):
        model = tb.method("mrf", upsampling=way).fit(picture)
        lattice = empty_lattice(model, tb.Request((11, 10, 8), seed=1, periodic=True))
        slice_views = [
            SliceView(plane_across(axis), model.candidate_sets[0][0], 0) for axis in range(3)
        ]
        levels = start_finest(model, lattice, coarse, slice_views).lattice.levels
        assert np.array_equal(levels[::2, ::2, ::2], coarse)
        agree = np.mean(levels == coarse.repeat(2, 0).repeat(2, 1).repeat(2, 2)[:11])
        assert agree == 1 if way == "all" else agree < 0.75


@pytest.mark.slow
def test_the_feedback_holds_shares_and_target(picture):
    model = tb.method("mrf", sweeps=(6, 8)).fit(picture)
    made = model.generate((24, 26, 22), seed=2)
    assert np.mean(made.values == 0) == pytest.approx(np.mean(picture.values == 0), abs=0.02)
    asked = model.generate((24, 26, 22), seed=2, target={"porosity": 0.5})
    assert np.mean(asked.values == 0) == pytest.approx(0.5, abs=0.02)


def test_without_the_feedback_it_is_the_papers(picture):
    """Check that the bias stays 0: nothing but the views' densities."""
    _, relaxation = relaxation_of(picture, (12, 12, 12), {"scales": 1, "sweeps": (2,), **NONE})
    relaxation.run()
    assert not relaxation.shifts.by_group.any() and not relaxation.shifts.by_level.any()
    assert not any(part.any() for part in relaxation.bias_feedback.by_cell)


def test_the_local_bias_rests_where_the_statistics_agree():
    content = number_levels([stripes()], full=40, levels=2, colours=2)
    neighbourhoods = extract_neighbourhoods(content.pictures[0], scale=0, width=5, every=True)
    joint = joint_histogram(neighbourhoods, content, 6)
    assert joint.share[0].sum() == pytest.approx(1)
    count = np.rint(joint.share * 1e6).astype(np.int64)
    assert np.abs(bias_change(joint, count)).max() < 1e-3
    # Too much of group 1 in cell 2: less of it there, with nothing done to the groups as a whole.
    count[0, 2, 1] *= 4
    change = bias_change(joint, count)
    assert change[0, 2, 1] < -0.3 < 0.3 < change[0, 2, 0]
    assert np.abs((joint.share.sum(2, keepdims=True) * change).sum(1)).max() < 1e-9


def test_known_joint_of_a_checkerboard():
    content = number_levels(
        [tb.Image(np.indices((9, 9)).sum(0) % 2, "labels")], full=40, levels=2, colours=2
    )
    joint = joint_histogram(
        extract_neighbourhoods(content.pictures[0], scale=0, width=3, every=True), content, 2
    )
    # Around a 1 there are four 1s, around a 0 four as well: one cell, both groups about half.
    assert isinstance(joint, JointHistogram)
    assert joint.share[0].max(0) == pytest.approx([25 / 49, 24 / 49])


def test_tilted_patches_have_the_porosity(picture):
    neighbourhoods = extract_neighbourhoods(picture.values, scale=0, width=7, every=True)
    for wanted in (0.35, 0.6, 0.8):
        found = reweight_by_porosity(neighbourhoods, 0, wanted)
        assert len(found.centres) == len(neighbourhoods.centres)
        assert np.mean(found.centres == 0) == pytest.approx(wanted, abs=0.01)


@pytest.mark.whole
def test_fixed_voxels_stay_and_the_material_goes_on(picture):
    """Check the picture itself as the middle slice: unchanged, and the next slices agree with it
    far more than by chance.
    """
    shape = (25, 40, 40)
    known = np.zeros(shape, bool)
    known[12] = True
    fixed = tb.Image(np.broadcast_to(picture.values, shape).copy(), "labels")
    made = (
        tb.method("mrf", sweeps=(6, 8))
        .fit(picture)
        .generate(shape, seed=3, fixed=fixed, known=known)
        .values
    )
    assert np.array_equal(made[12], picture.values)
    same = np.mean(made[1:] == made[:-1], axis=(1, 2))
    chance = picture.values.mean() ** 2 + (1 - picture.values.mean()) ** 2
    middle = 0.4 * np.delete(same, [11, 12]).mean() + 0.6 * chance
    assert same[11] > middle
    assert same[12] > middle


@pytest.mark.whole
def test_outside_a_mask_is_void_and_does_not_matter(picture):
    shape = (20, 22, 24)
    mask = np.zeros(shape, bool)
    mask[3:17, 4:20, 2:20] = True
    model = tb.method("mrf", sweeps=(3, 4)).fit(picture)
    made = model.generate(shape, seed=1, mask=mask).values
    assert not made[~mask].any()
    assert made[mask].mean() == pytest.approx(picture.values.mean(), abs=0.05)


@pytest.mark.slow
def test_a_periodic_result_has_no_seam(picture):
    model = tb.method("mrf", sweeps=(6, 8)).fit(picture)
    for periodic in (True, False):
        made = model.generate(30, seed=4, periodic=periodic).values
        seen = [np.moveaxis(made, axis, 0) for axis in range(3)]
        inside = np.mean([part[1:] == part[:-1] for part in seen])
        seam = np.mean([part[0] == part[-1] for part in seen])
        assert (seam > inside - 0.06) == periodic


@pytest.mark.whole
def test_two_pictures_rule_their_own_planes():
    """Check layers across z, seen across y and x; slices across z are left to them."""
    rng = np.random.default_rng(8)
    side = tb.Image(
        np.repeat((np.arange(36) % 6 < 3).astype(np.uint8)[:, None], 36, axis=1), "labels"
    )
    model = tb.method(
        "mrf", views=("zy", "zx"), neighbourhood=7, scales=1, sweeps=(25,), **NONE
    ).fit(side)
    made = model.generate((24, 20, 20), seed=1).values
    assert np.mean(made[:, 1:] == made[:, :-1]) > 0.95
    assert np.mean(made[:, :, 1:] == made[:, :, :-1]) > 0.95
    assert np.mean(made[3:] == made[:-3]) < 0.2
    with pytest.raises(InputError, match="contradict"):
        tb.method("mrf").fit(
            [side, tb.Image((rng.random((36, 36)) < 0.9).astype(np.uint8), "labels")]
        )


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["grey", pytest.param("colour", marks=pytest.mark.slow)])
def test_grey_and_colour_take_real_values(kind):
    rng = np.random.default_rng(9)
    smooth = np.fft.ifft2(np.fft.fft2(rng.normal(size=(32, 32))) * _band(32, 8)).real
    values = np.clip(128 + 70 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    if kind == "colour":
        values = np.stack([values, 255 - values, values // 2], axis=-1)
    picture = tb.Image(values, kind)
    made = (
        tb.method("mrf", sweeps=(3, 4), levels=24, colours=24, candidates=512)
        .fit(picture)
        .generate(16, seed=1)
        .values
    )
    real = {tuple(np.atleast_1d(v)) for v in values.reshape(-1, *values.shape[2:])}
    assert {tuple(np.atleast_1d(v)) for v in made.reshape(-1, *values.shape[2:])} <= real
    assert made.mean() == pytest.approx(values.mean(), abs=25)
    # channels together: the first two are each other's complement in every voxel
    if kind == "colour":
        assert np.abs(made[..., 0].astype(int) + made[..., 1] - 255).max() <= 1


def test_few_grey_values_are_levels_as_they_are_and_many_become_quantiles():
    image = tb.Image(np.arange(64, dtype=np.uint16).reshape(8, 8) ** 2, "grey")
    content = number_levels([image], full=100, levels=64, colours=2)
    assert np.array_equal(content.values[content.pictures[0]], image.values)
    assert content.features[[0, -1], 0].tolist() == [-100, 100]
    coarse = number_levels([image], full=100, levels=16, colours=2)
    assert np.array_equal(np.bincount(coarse.pictures[0].ravel()), np.full(16, 4))
    assert np.isin(coarse.values, image.values).all()
    assert np.array_equal(content.nearest_levels(image.values), content.pictures[0])


@given(st.integers(0, 50), st.integers(1, 12))
@settings(max_examples=20)
def test_a_palette_holds_colours_of_the_picture(seed, most):
    pixels = np.random.default_rng(seed).integers(0, 256, (60, 3)).astype(np.uint8)
    colours, which = median_cut_palette(pixels, most)
    assert len(colours) == most
    assert {tuple(c) for c in colours} <= {tuple(p) for p in pixels}
    assert np.bincount(which, minlength=most).min() >= 1
    own = ((pixels.astype(int) - colours[which].astype(int)) ** 2).sum()
    total = ((pixels.astype(float) - pixels.mean(0)) ** 2).sum()
    assert own <= 1.3 * total


def test_a_palette_of_few_colours_is_exact():
    pixels = np.array([[1, 2, 3], [200, 0, 0], [1, 2, 3], [0, 90, 7]], np.uint8)
    colours, which = median_cut_palette(pixels, 200)
    assert np.array_equal(colours[which], pixels)


def test_known_voxels_are_halved_to_the_first_of_eight():
    known = np.zeros((3, 4, 4), bool)
    values = np.arange(48, dtype=np.uint8).reshape(3, 4, 4)
    known[1, 1, 2] = known[1, 0, 3] = known[2, 3, 1] = True
    half, found = coarsen_known(values, known)
    assert np.argwhere(found).tolist() == [[0, 0, 1], [1, 1, 0]]
    assert half[0, 0, 1] == values[1, 0, 3]
    assert half[1, 1, 0] == values[2, 3, 1]


@pytest.mark.whole
@pytest.mark.parametrize(
    "relaxation", ["gibbs", pytest.param("icm", marks=pytest.mark.slow), "annealing"]
)
def test_an_interrupted_run_goes_on_bit_for_bit(relaxation, picture, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    model = tb.method("mrf", relaxation=relaxation, sweeps=(3, 4), stop=0.5).fit(picture)
    whole = model.generate((14, 16, 18), seed=3)
    sweep, done = Relaxation.sweep, []

    def broken(self, step):
        done.append(step)
        if len(done) == 6:
            raise KeyboardInterrupt
        return sweep(self, step)

    monkeypatch.setattr(Relaxation, "sweep", broken)
    with pytest.raises(KeyboardInterrupt), checkpoint.kept_at(tmp_path / "a.part"):
        model.generate((14, 16, 18), seed=3)
    assert (tmp_path / "a.part").exists()
    with checkpoint.kept_at(tmp_path / "a.part"):
        again = model.generate((14, 16, 18), seed=3)
    assert np.array_equal(again.values, whole.values)
    assert again.recipe.to_json() == whole.recipe.to_json()
    total = sum(len(scale["changed"]) for scale in whole.recipe.steps[-1]["report"]["scales"])
    assert len(done) == 6 + total - 5, "what was done before is not done again"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"neighbourhood": 8}, "odd width"),
        ({"heuristic": "h1a"}, "relaxation=icm"),
        ({"sweeps": ()}, "empty"),
        ({"xi": 0.5}, "xi"),
        ({"every": 1}, "true or false"),
        ({"order": "rows"}, "order"),
        ({"start": 0.0}, "start"),
        ({"views": ("yx",)}, "two or three planes"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        tb.method("mrf", **settings)


def test_pictures_and_requests_that_cannot_be_are_refused(picture):
    method = tb.method("mrf")
    with pytest.raises(InputError, match="at least 11"):
        method.fit(tb.Image(picture.values[:10], "labels"))
    with pytest.raises(InputError, match="one value only"):
        method.fit(tb.Image(np.full((20, 20), 7, np.uint8), "grey"))
    with pytest.raises(RequestError, match="periodic with 5"):
        method.fit(picture).generate((5, 20, 20), seed=1, periodic=(True, False, False))

"""`packing` beside known voxels: bodies that the joint cuts against those that were drawn, and what
is made around them.
"""

import numpy as np
import pytest
from packing_balls import balls_in, beads, bodies_of, packed

import trabecula as tb
from trabecula.measure.partition.partition import partition
from trabecula.synth.packing.beside import Beside
from trabecula.synth.packing.giving_way import give_way
from trabecula.synth.packing.known_bodies import KnownBodies
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.packing.standing import Standing, find_standing
from trabecula.synth.shared.content.joints import surroundings
from trabecula.testing.peak import peak_bytes

CUBE, OPEN = np.ones(3), (False, False, False)
SIDE, HELD = 72, 30
NOTHING = Standing(np.empty((0, 3)), np.empty((0, 6 * 13 * 13), np.float32))


def held(side=SIDE, planes=HELD):
    known = np.zeros((side,) * 3, bool)
    known[:planes] = True
    return known


def report(made):
    return made.recipe.to_json()[-1]["report"]


def changes(values, plane):
    """Return the share of voxels that change their phase across a plane of z, over that along y and
    x beyond it.
    """
    made = values[plane + 1 :]
    within = np.mean([np.mean(np.diff(made, axis=axis) != 0) for axis in (1, 2)])
    return float(np.mean(values[plane] != values[plane + 1]) / within)


@pytest.fixture(scope="module")
def model():
    exemplar = tb.Image(beads(SIDE, seed=5)[1].astype(np.uint8), "labels")
    return tb.method("packing", phase="solid", separation=1.0, fillet=0.0).fit(exemplar)


@pytest.fixture(scope="module")
def scan():
    """Places of balls, and their voxels."""
    places, inside = beads(SIDE, seed=9)
    return places, tb.Image(inside.astype(np.uint8), "labels")


@pytest.fixture(scope="module")
def extension(model, scan):
    return model.generate(SIDE, seed=1, fixed=scan[1], known=held())


def test_voxels_that_are_not_seen_bound_no_body():
    at = np.stack(np.indices((24, 24, 24)), -1) - (12.0, 11.5, 11.5)
    ball = (at**2).sum(-1) < 64
    unseen = np.zeros(ball.shape, bool)
    unseen[12:] = True
    seen = partition(ball & ~unseen, CUBE, OPEN, smoothing=0.4, reach=4.0, unseen=unseen)
    assert seen.count == 1
    assert seen.peaks[0, 0] == 11
    assert seen.distance[11, 11, 11] > 6.5
    assert not seen.labels[unseen].any()


@pytest.mark.whole
@pytest.mark.parametrize("hole", [False, True])
def test_bodies_that_the_joint_cuts_stand_where_they_were_drawn(scan, hole):
    places, image = scan
    known = held()
    if hole:
        known[:] = True
        known[20:52, 20:52, 20:52] = False
    inside = image.values > 0
    found = find_standing(inside & known, known, CUBE, OPEN, bodies_of(6.0), 6)
    apart = np.linalg.norm(found.places[:, None] - places, axis=2)
    inner = ((found.places > 6) & (found.places < SIDE - 6)).all(axis=1)
    assert np.median(apart.min(axis=1)[inner]) < 0.3
    assert np.mean(apart.min(axis=1)[inner] < 1.0) > 0.9
    assert np.abs(found.radii[inner].mean(axis=1) - 6).mean() < 0.4
    if not hole:
        deep = places[:, 0] - HELD  # those of which the joint leaves a third at least
        cut = (np.abs(deep) < 2) & ((places > 8) & (places < SIDE - 8)).all(axis=1)
        assert cut.any()
        assert (apart.min(axis=0)[cut] < 1.0).all()


def test_a_cap_is_completed_to_a_body_as_large_as_bodies_are():
    draw, known, off = np.random.default_rng(0), held(40, 20), []
    for height in (1.5, 2.0, 2.5, 3.0):
        place = np.array([20 - height + 6, 20, 20]) + np.append(0, draw.uniform(-0.5, 0.5, 2))
        inside = balls_in(40, [place], 6.0) & known
        found = find_standing(inside, known, CUBE, OPEN, bodies_of(6.0), 4)
        off.append(np.linalg.norm(found.places[0] - place))
        assert found.radii.mean() == pytest.approx(6, abs=0.5)
    assert max(off) < 0.8


def test_discs_that_touch_in_one_slice_are_a_body_each():
    places = np.array([[20.0, 12.0, 14.0], [21.0, 21.0, 24.0]])
    inside, known = balls_in(40, places, 7.0), np.zeros((40,) * 3, bool)
    known[20] = True
    found = find_standing(inside & known, known, CUBE, OPEN, bodies_of(7.0), 4)
    assert len(found.places) == 2
    order = np.argsort(found.places[:, 1])
    np.testing.assert_allclose(found.places[order], places, atol=1.5)


@pytest.mark.whole
def test_bodies_of_a_known_part_stand_alike_wherever_a_period_begins(scan):
    inside, known = scan[1].values > 0, np.zeros((SIDE,) * 3, bool)
    known[10:40] = True
    wraps = (False, True, True)
    one = find_standing(inside & known, known, CUBE, wraps, bodies_of(6.0), 4)
    moved = np.roll(inside & known, 25, axis=1)
    two = find_standing(moved, known, CUBE, wraps, bodies_of(6.0), 4)
    assert len(one.places) == len(two.places) > 20
    shifted = np.mod(one.places + np.array([0, 25, 0]), SIDE)
    off = shifted[:, None] - two.places
    off -= SIDE * np.rint(off / SIDE)
    assert np.linalg.norm(off, axis=2).min(axis=1).max() < 1e-6


def beside(clear, room=None, sides=None):
    room = np.maximum(clear, 0) if room is None else room
    sides = np.array(clear.shape, float) if sides is None else np.array(sides, float)
    return Beside(clear.astype(np.float32), room.astype(np.float32), CUBE, sides, NOTHING)


def test_places_are_dropped_in_the_free_part_and_beyond_its_faces_alone():
    clear = np.full((10, 10, 10), 5.0)
    clear[:4] = -1
    around = beside(clear, sides=(14, 10, 10))
    assert around.volume == pytest.approx(6 * 100 + 2 * 100)
    places = around.drop(np.ones(4000), np.random.default_rng(0))
    assert ((places[:, 0] >= 4) & (places[:, 0] < 12)).all()  # 2 beyond the last face of z
    assert np.histogram(places[:, 0], 4, (4, 12))[0] == pytest.approx([1000] * 4, rel=0.15)
    assert (places < around.sides).all()
    places = beside(clear[::-1], sides=(14, 10, 10)).drop(np.ones(4000), np.random.default_rng(0))
    assert ((places[:, 0] < 6) | (places[:, 0] >= 12)).all()  # 2 before the first face
    assert np.mean(places[:, 0] >= 12) == pytest.approx(0.25, abs=0.03)


def test_a_body_is_dropped_where_it_has_room():
    clear = np.full((10, 10, 10), 5.0)
    room = np.zeros_like(clear)
    room[:, :, 5:] = 5
    places = beside(clear, room).drop(np.full(500, 4.0), np.random.default_rng(0))
    assert np.mean(places[:, 2] >= 5) > 0.99


def test_a_body_is_pushed_out_of_a_known_pore_until_it_only_touches_it():
    clear = np.broadcast_to((np.arange(20.0) - 7.5)[:, None, None], (20, 9, 9))
    around, radii = beside(np.ascontiguousarray(clear)), np.full((1, 6 * 169), 5, np.float32)
    places = np.array([[10.5, 4.5, 4.5], [5.5, 4.5, 4.5], [15.5, 4.5, 4.5]])
    turns = np.broadcast_to(np.eye(3), (3, 3, 3))
    moves, lacks = around.push(places, np.zeros(3, np.int64), turns, radii)
    np.testing.assert_allclose(lacks, [2.5, 7.5, 0])
    np.testing.assert_allclose(moves, [[1.75, 0, 0], [5.25, 0, 0], [0, 0, 0]], atol=1e-6)


def around_standing(places, clear=50.0):
    """Return a free box of 40^3 with balls of radius 6 that stand in it."""
    radii = np.full((len(places), 6 * 169), 6, np.float32)
    free = np.full((40, 40, 40), clear, np.float32)
    covered = balls_in(40, np.array(places, float), 6.0)
    standing = Standing(np.array(places, float), radii)
    return Beside(free, np.where(covered, 0, free), CUBE, np.full(3, 40.0), standing)


def test_bodies_that_stand_do_not_move():
    places = [[20.0, 20.0, 20.0], [20.0, 30.0, 20.0]]
    made = packed(bodies_of(6.0, density=4e-4), 40, beside=around_standing(places))
    np.testing.assert_array_equal(made.places[made.count :], places)
    apart = made.places[: made.count, None] - np.array(places)
    length = np.linalg.norm(apart - 40 * np.rint(apart / 40), axis=2)
    assert length.min() > 11


def test_bodies_that_stand_count_among_the_wanted():
    bodies = bodies_of(6.0, density=0.3 / (4 / 3 * np.pi * 6**3))
    alone = packed(bodies, 40, beside=around_standing(np.empty((0, 3))))
    assert alone.count == round(bodies.density * 40**3)
    beside = around_standing([[20.0, 20.0, 20.0], [8.0, 8.0, 8.0], [30.0, 8.0, 30.0]])
    assert packed(bodies, 40, beside=beside).count == alone.count - 3


def test_bodies_that_overlap_behind_the_joint_give_way_there_alone():
    places, radii = np.array([[9.0, 15.0, 14.0], [9.0, 15.0, 23.0]]), np.full((2, 6 * 169), 6.0)
    unseen = np.zeros((40, 30, 40), bool)
    unseen[9:] = True
    known = radius_towards(radii[0], -1.0, 0.0, 0.2)
    for at, less in ((places, False), (places + np.array([17, 0, 0]), True)):
        found = give_way(at, radii.astype(np.float32), unseen, CUBE, 1.0)
        both = radius_towards(found[0], 0.0, 0.0, 1.0) + radius_towards(found[1], 0.0, 0.0, -1.0)
        assert (both < 9.5) == less
        assert radius_towards(found[0], -1.0, 0.0, 0.2) == pytest.approx(known, abs=0.2)
        assert radius_towards(found[0], 0.0, 0.0, -1.0) == pytest.approx(6)


def test_an_interface_meets_the_known_one_and_keeps_its_place_beyond():
    x = np.arange(40) + 0.5
    depth = np.broadcast_to((22 - x).astype(np.float32), (40, 9, 40)).copy()
    known = np.zeros(depth.shape, bool)
    known[:8] = True
    inside = known & (x < 18)
    moved = KnownBodies(inside, known & ~inside, known, OPEN, CUBE).join(depth, 0.0)
    ends = (moved[:, 4] > 0).sum(axis=1)
    assert abs(int(ends[8]) - 18) <= 1
    assert (np.diff(ends[8:]) >= 0).all()
    assert ends[-1] == 22


@pytest.mark.whole
def test_known_voxels_stay_and_the_free_ones_have_their_fraction(model, scan, extension):
    known, values = held(), scan[1].values
    np.testing.assert_array_equal(extension.values[known], values[known])
    near = surroundings(~known, known, 8)
    pooled = (values[near].sum() + (~known).sum() * model.fraction) / (near.sum() + (~known).sum())
    assert abs(int(extension.values[~known].sum()) - round(float(pooled) * (~known).sum())) <= 1


@pytest.mark.whole
def test_beads_go_on_across_the_joint(model, scan, extension):
    told = report(extension)
    assert told["standing"] > 25
    assert told["cut"] <= 0.03 * told["bodies"]
    own = np.mean([changes(scan[1].values, plane) for plane in range(10, 60)])
    assert changes(extension.values, HELD - 1) == pytest.approx(own, abs=0.25)
    near = np.mean([changes(extension.values, HELD + step) for step in range(3)])
    assert near == pytest.approx(own, abs=0.25)
    solid = extension.values[HELD : HELD + 12].mean()
    assert solid == pytest.approx(model.fraction, abs=0.06)
    # whole beads: a body whose half the joint hides would be smaller, or flat
    found = tb.measure.bodies(extension, phase=1)
    across = np.abs(found.centroid[:, 0] - HELD) < 4
    inner = across & found.inside
    assert inner.sum() > 5
    size = (3 * found.volume[inner] / (4 * np.pi)) ** (1 / 3)
    assert np.median(size) == pytest.approx(6, abs=0.4)


@pytest.mark.whole
def test_threads_change_no_voxel_and_a_seed_does(model, scan, extension):
    with tb.threads(3):
        again = model.generate(SIDE, seed=1, fixed=scan[1], known=held())
    np.testing.assert_array_equal(again.values, extension.values)
    other = model.generate(SIDE, seed=2, fixed=scan[1], known=held())
    assert (other.values != extension.values)[HELD + 15 :].mean() > 0.2


@pytest.mark.whole
def test_beside_known_voxels_axes_repeat_without_a_seam(model, scan):
    known = np.zeros((SIDE,) * 3, bool)
    known[20:44, :30, 20:60] = True
    made = model.generate(SIDE, seed=1, fixed=scan[1], known=known, periodic=True).values
    np.testing.assert_array_equal(made[known], scan[1].values[known])
    for axis in range(3):
        turned = np.moveaxis(made, axis, 0)
        across = np.mean(turned[0] != turned[-1])
        within = np.mean(turned[1:] != turned[:-1])
        assert across / within == pytest.approx(1, abs=0.25)


@pytest.mark.whole
def test_a_mask_is_empty_outside_and_has_its_fraction_among_the_free(model, scan):
    mask = np.zeros((SIDE,) * 3, bool)
    mask[:, 10:60, 5:50] = True
    known = held() & mask
    made = model.generate(SIDE, seed=1, fixed=scan[1], known=known, mask=mask).values
    assert not made[~mask].any()
    np.testing.assert_array_equal(made[known], scan[1].values[known])
    assert made[mask & ~known].mean() == pytest.approx(model.fraction, abs=0.02)


@pytest.mark.whole
def test_a_target_is_met_by_the_whole_as_far_as_possible(model, scan):
    known = held()
    made = model.generate(SIDE, seed=1, fixed=scan[1], known=known, target={"porosity": 0.6})
    assert (made.values == 0).mean() == pytest.approx(0.6, abs=1e-5)
    field = np.broadcast_to(np.linspace(0.5, 0.7, SIDE)[:, None, None], (SIDE,) * 3)
    graded = model.generate(SIDE, seed=1, fixed=scan[1], known=known, target={"porosity": field})
    np.testing.assert_array_equal(graded.values[known], scan[1].values[known])
    found = 1 - graded.values[HELD:].reshape(3, -1).mean(axis=1)
    np.testing.assert_allclose(found, field[HELD:].reshape(3, -1).mean(axis=1), atol=0.08)
    assert (np.diff(found) > 0.04).all()


@pytest.mark.parametrize("which", ["slice", "scattered", "one", "solid", "pore", "all but one"])
def test_few_known_voxels_stay_and_what_stands_is_counted(model, scan, which):
    known = np.zeros((40,) * 3, bool)
    values = scan[1].values[:40, :40, :40]
    if which == "slice":
        known[20] = True
    elif which == "scattered":
        known[::7, ::7, ::7] = True
    elif which == "one":
        known[20, 20, 20] = True
    elif which == "all but one":
        known[:] = True
        known[20, 20, 20] = False
    else:
        known |= values == (which == "solid")
    fixed = tb.Image(np.ascontiguousarray(values), "labels")
    made = model.generate(40, seed=3, fixed=fixed, known=known)
    np.testing.assert_array_equal(made.values[known], values[known])
    stand = report(made)["standing"]
    assert stand > 3 if which == "slice" else stand >= 0
    if which in ("scattered", "one", "solid"):
        assert stand == 0


@pytest.mark.slow
def test_bubbles_go_on_across_the_joint(scan):
    exemplar = tb.Image(1 - beads(SIDE, seed=5)[1].astype(np.uint8), "labels")
    model = tb.method("packing", phase="void", separation=1.0, fillet=0.0).fit(exemplar)
    fixed = tb.Image(1 - scan[1].values, "labels")
    made = model.generate(SIDE, seed=1, fixed=fixed, known=held())
    assert report(made)["standing"] > 25
    assert changes(made.values, HELD - 1) == pytest.approx(0.85, abs=0.3)


def test_flat_voxels_have_their_bodies_as_far_from_the_joint():
    places = np.array([[12.0, 10.0, 10.0], [12.0, 30.0, 28.0]])
    inside = balls_in(40, places, 6.0)[:, :, ::2]
    known = np.zeros(inside.shape, bool)
    known[:13] = True
    steps = np.array([1.0, 1.0, 2.0])
    found = find_standing(inside & known, known, steps, OPEN, bodies_of(6.0), 4)
    assert len(found.places) == 2
    order = np.argsort(found.places[:, 1])
    np.testing.assert_allclose(found.places[order], places, atol=0.7)


@pytest.mark.whole
def test_the_forecast_holds_beside_known_voxels(model, scan):
    request = tb.Request((SIDE,) * 3, seed=1, fixed=scan[1], known=held())
    plan = model.plan(request)
    arrays = plan.peak - plan.memory["interpreter and kernels"] - plan.memory["exemplar"]
    model.generate(request)
    peak = peak_bytes(lambda: model.generate(request))
    assert peak <= arrays <= 1.6 * peak

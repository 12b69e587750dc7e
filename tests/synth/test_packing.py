"""`packing`: shapes, sizes and places of bodies against what is known of them, and what is
refused.
"""

import numpy as np
import pytest
from packing_balls import balls_in, bodies_of, packed
from packing_balls import beads as touching

import trabecula as tb
from trabecula.core.errors import InputError, RequestError
from trabecula.synth.packing.drawing import draw_depth
from trabecula.synth.packing.radial_shapes import (
    NODES,
    SIZE,
    ball_radii,
    fit_radii,
    harmonics,
    radius_towards,
    table_directions,
)
from trabecula.synth.packing.scan_bodies import find_bodies
from trabecula.synth.shared.packed.depth import deepest_by_share, deepest_share
from trabecula.synth.shared.packed.neighbours import neighbour_pairs
from trabecula.synth.shared.packed.trials import SEPARATIONS, search

CUBE = np.ones(3)


@pytest.fixture(scope="module")
def grid():
    """Balls of two sizes that do not touch, eight small ones for each large one."""
    random = np.random.default_rng(1)
    cells = np.stack(np.indices((6, 6, 6)), -1).reshape(-1, 3) * 16 + 8
    large = random.random(len(cells)) < 0.3
    radii = np.where(large, 6.5, 3.5)
    return balls_in(96, cells + random.uniform(-0.5, 0.5, cells.shape), radii), large.mean()


@pytest.fixture(scope="module")
def beads():
    """Touching beads of one size, packed by the process that is tested elsewhere."""
    return tb.Image(touching(72, seed=5)[1].astype(np.uint8), "labels")


def test_harmonics_are_of_mean_square_one_and_know_nothing_of_each_other():
    z, weight = np.polynomial.legendre.leggauss(12)
    turn = 2 * np.pi * np.arange(24) / 24
    height, angle = (one.ravel() for one in np.meshgrid(z, turn, indexing="ij"))
    across = np.sqrt(1 - height**2)
    ways = np.stack([height, across * np.sin(angle), across * np.cos(angle)], axis=1)
    terms = harmonics(ways, 6)
    shares = np.repeat(weight, 24) / 48
    assert terms.shape == (288, 49)
    np.testing.assert_allclose((terms.T * shares) @ terms, np.eye(49), atol=1e-12)


def test_a_table_gives_the_radii_that_it_holds_in_its_directions_and_linear_ones_between():
    table = np.arange(SIZE, dtype=np.float32)
    ways = table_directions()
    _, second, first = np.sort(np.abs(ways), axis=1).T
    inner = first - second > 1e-9
    read = np.array([radius_towards(table, *(3.0 * way)) for way in ways])
    np.testing.assert_allclose(read[inner], table[inner], rtol=1e-5)
    assert inner.sum() == 6 * (NODES - 2) ** 2
    smooth = (2 + ways[:, 0]).astype(np.float32)
    random = np.random.default_rng(0).standard_normal((300, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    found = [radius_towards(smooth, *way) for way in random]
    np.testing.assert_allclose(found, 2 + random[:, 0], atol=0.01)


def test_an_ellipsoid_of_voxels_has_the_radii_of_the_ellipsoid():
    axes, at = np.array([9.0, 6.0, 4.5]), np.stack(np.indices((25, 25, 25)), -1) - 12.0
    image = tb.Image((((at / axes) ** 2).sum(-1) < 1).astype(np.uint8), "labels")
    faces = []
    for axis in range(3):
        place = np.argwhere(np.diff(image.values, axis=axis) != 0).astype(float)
        place[:, axis] += 0.5
        faces.append(place - 12.0)
    faces = np.concatenate(faces)
    radii, misfit = fit_radii(faces, np.zeros(len(faces), bool), 6)
    exact = 1 / np.sqrt(((table_directions() / axes) ** 2).sum(-1))
    assert np.abs(radii - exact).max() < 0.5
    assert np.abs(radii - exact).mean() < 0.15
    assert misfit < 0.4


def test_behind_a_contact_a_body_is_as_round_as_before_it():
    ways = table_directions()
    faces = 8.0 * ways
    contact = faces[:, 0] > 4
    faces[contact] *= 4 / faces[contact, :1]  # cut off by a plane
    radii, _ = fit_radii(faces, contact, 6)
    assert radii[contact].mean() == pytest.approx(8, abs=0.5)
    blind, _ = fit_radii(faces, np.zeros(len(faces), bool), 6)
    assert blind[contact].mean() < 6


@pytest.mark.whole
def test_bodies_of_a_scan_are_counted_and_sized(grid):
    inside, large = grid
    found = find_bodies(tb.Image(inside.astype(np.uint8), "labels"), 1, 4)
    sizes = found.radii.mean(axis=1)
    assert found.density * inside.size == pytest.approx(216, rel=0.1)
    assert found.weights[sizes > 5].sum() == pytest.approx(large, abs=0.06)
    np.testing.assert_allclose(sizes[sizes > 5], 6.5, atol=0.2)
    np.testing.assert_allclose(sizes[sizes < 5], 3.5, atol=0.25)
    assert found.misfit < 0.1
    assert not found.lie


@pytest.mark.whole
def test_bodies_that_a_face_cuts_count_as_whole_ones_of_their_size():
    """Large balls are cut more often: without them small ones would seem too frequent."""
    random, shares = np.random.default_rng(4), []
    for _ in range(12):
        cells = np.stack(np.indices((4, 4, 4)), -1).reshape(-1, 3) * 22 + random.uniform(0, 22, 3)
        radii = np.where(random.random(len(cells)) < 0.5, 9.0, 3.0)
        inside = balls_in(88, cells % 88, radii)[:60, :60, :60]
        found = find_bodies(tb.Image(inside.astype(np.uint8), "labels"), 1, 4)
        if found is not None:
            shares.append(found.weights[found.radii.mean(axis=1) > 6].sum())
    assert len(shares) > 8
    assert np.mean(shares) == pytest.approx(0.5, abs=0.08)  # of whole ones alone a third


def test_fewer_than_eight_whole_bodies_are_none():
    inside = balls_in(48, [(12, 12, 12), (30, 30, 30)], 6.0)
    assert find_bodies(tb.Image(inside.astype(np.uint8), "labels"), 1, 4) is None


@pytest.mark.slow
def test_flat_bodies_lie_and_are_mirrored_not_turned():
    random = np.random.default_rng(3)
    at = np.stack(np.indices((80, 80, 80)), -1).astype(float)
    inside = np.zeros((80, 80, 80), bool)
    for cell in np.ndindex(5, 5, 5):
        off = at - (np.array(cell) * 16 + 8 + random.uniform(-1, 1, 3))
        inside |= ((off / (2.5, 6.5, 6.5)) ** 2).sum(-1) < 1
    image = tb.Image(inside.astype(np.uint8), "labels")
    settings = {"phase": "solid", "separation": 1.0, "fillet": 0.0}
    model = tb.method("packing", **settings).fit(image)
    assert model.bodies.lie
    laid = tb.measure.bodies(model.generate(64, seed=1), phase=1)
    turned = tb.method("packing", turns="any", **settings).fit(image).generate(64, seed=1)
    assert np.median(np.abs(laid.directions[laid.inside, 2, 0])) > 0.95
    assert np.median(np.abs(tb.measure.bodies(turned, phase=1).directions[:, 2, 0])) < 0.8


def test_neighbours_are_those_of_a_search_of_all_pairs():
    random = np.random.default_rng(0)
    sides = np.array([40.0, 23.0, 31.0])
    places, reach = random.random((200, 3)) * sides, random.uniform(0.5, 6, 200)
    apart = places[:, None] - places
    apart -= sides * np.rint(apart / sides)
    near = (apart**2).sum(-1) < (reach[:, None] + reach) ** 2
    wanted = {frozenset(pair) for pair in np.argwhere(np.triu(near, 1)).tolist()}
    found = neighbour_pairs(places, reach, sides)
    assert {frozenset(pair) for pair in found.tolist()} == wanted
    assert len(found) == len(wanted)
    assert (reach[found[:, 0]] >= reach[found[:, 1]]).all()


@pytest.mark.parametrize("separation", [0.8, 1.0, 1.3])
def test_balls_keep_their_distance(separation):
    made = packed(bodies_of(3.0, 4.0, density=1e-3), 56, separation=separation)
    radii = made.radii.mean(axis=1)[made.shapes]
    apart = made.places[:, None] - made.places
    apart -= 56 * np.rint(apart / 56)
    length = np.sqrt((apart**2).sum(-1)) + 1e3 * np.eye(len(radii))
    share = length / (radii[:, None] + radii)
    assert share.min() > separation - 0.1
    assert len(made.places) == round(1e-3 * 56**3)
    assert made.lacking < 0.01
    assert np.bincount(made.shapes).min() == pytest.approx(len(radii) / 2, abs=1)


def test_turns_are_rotations_any_way_and_mirrors_along_the_axes():
    turns = packed(bodies_of(2.0), 40).turns
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 1, 2) - np.eye(3), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    assert np.abs(turns.mean(axis=0)).max() < 0.3
    mirrors = packed(bodies_of(2.0), 40, any_way=False).turns
    np.testing.assert_array_equal(np.abs(mirrors), np.broadcast_to(np.eye(3), mirrors.shape))
    assert (mirrors[:, 0, 0] < 0).any()
    assert (mirrors[:, 0, 0] > 0).any()


def test_a_drawn_ball_is_as_deep_as_its_radius_less_the_distance_in_a_box_that_repeats():
    made = packed(bodies_of(5.0, density=1 / 24**3), 24)
    depth = draw_depth(made, (24, 24, 24), CUBE, 0.0)
    off = np.stack(np.indices((24, 24, 24)), -1) + 0.5 - made.places[0]
    length = np.sqrt(((off - 24 * np.rint(off / 24)) ** 2).sum(-1))
    np.testing.assert_allclose(depth, np.maximum(5 - length, -4.5), atol=1e-5)


def test_a_part_of_the_box_is_drawn_as_in_the_whole_with_a_fillet_too():
    made = packed(bodies_of(4.0, 3.0, density=3e-3), 32)
    for fillet in (0.0, 1.5):
        whole = draw_depth(made, (64, 32, 32), CUBE, fillet)
        np.testing.assert_array_equal(whole[:32], whole[32:])
        np.testing.assert_array_equal(
            draw_depth(made, (20, 9, 13), CUBE, fillet), whole[:20, :9, :13]
        )


def test_flat_voxels_draw_the_same_bodies():
    made = packed(bodies_of(6.0, density=1e-3), 32)
    flat = draw_depth(made, (32, 32, 16), np.array([1.0, 1.0, 2.0]), 0.0) > 0
    assert flat.mean() == pytest.approx(
        (draw_depth(made, (32,) * 3, CUBE, 0.0) > 0).mean(), rel=0.05
    )


def test_the_deepest_share_is_met_to_the_voxel_among_equals_as_well():
    depth = np.repeat(np.arange(10.0, dtype=np.float32), 100).reshape(10, 10, 10)
    chosen = deepest_share(depth, 0.25)
    assert chosen.sum() == 250
    assert depth[chosen].min() == 7
    inside = np.zeros((10, 10, 10), bool)
    inside[:5] = True
    assert deepest_share(depth, 0.1, inside).sum() == 50
    assert not deepest_share(depth, 0.1, inside)[5:].any()
    assert deepest_share(depth, 0.0).sum() == 0
    assert deepest_share(depth, 1.0).all()


def test_a_field_of_shares_is_followed():
    depth = np.random.default_rng(0).standard_normal((40, 40, 40)).astype(np.float32)
    shares = np.broadcast_to(np.linspace(0.1, 0.6, 40)[:, None, None], depth.shape)
    chosen = deepest_by_share(depth, shares)
    np.testing.assert_allclose(chosen.mean(axis=(1, 2)), shares[:, 0, 0], atol=0.05)


def test_the_search_finds_the_lowest_place_of_a_valley():
    def valley(place):
        apart, rounding, seed = place
        across, along = rounding - 2 - 8 * (apart - 1), apart - 0.9
        return abs(across) + 3 * abs(along) + 0.01 * seed

    found = search(valley, SEPARATIONS, None)
    assert (found.separation, found.fillet) == (0.9, 1.25)
    assert search(valley, (1.1,), None).fillet == pytest.approx(2.75)
    assert search(valley, SEPARATIONS, 2.0).separation == pytest.approx(1.0)


@pytest.mark.slow
def test_trials_find_that_beads_touch_with_sharp_edges(beads):
    found = tb.method("packing", phase="solid", degree=4).fit(beads).packed
    assert 0.9 <= found.separation <= 1.0
    assert found.fillet <= 0.5
    assert found.score < 2


@pytest.mark.whole
def test_an_exemplar_too_small_for_trials_has_touching_bodies_and_says_so(beads):
    told = []
    small = tb.Image(np.ascontiguousarray(beads.values[:30]), "labels")
    with tb.progress(lambda label, fraction: told.append(label)):
        found = tb.method("packing", phase="solid", fillet=0.0).fit(small).packed
    assert (found.separation, found.fillet, found.score) == (1.0, 0.0, None)
    assert any("too small to try" in line for line in told)


@pytest.mark.whole
def test_what_is_packed_has_the_shapes_of_beads_and_their_fraction(beads):
    model = tb.method("packing", separation=1.0, fillet=0.0).fit(beads)
    assert model.label == 1
    made = model.generate(64, seed=3)
    shares = [tb.measure.shape_index(one, phase=1) for one in (beads, made)]
    assert np.linalg.norm(shares[0] - shares[1]) < 0.15 * np.linalg.norm(shares[0])
    assert (
        abs(int((made.values == 1).sum()) - round(float((beads.values == 1).mean()) * 64**3)) <= 1
    )
    assert tb.measure.coherence(beads, made)[4] < 0.2


@pytest.mark.whole
def test_bubbles_are_packed_in_the_void(beads):
    swapped = tb.Image(1 - beads.values, "labels", phases=("void", "solid"))
    model = tb.method("packing", separation=1.0, fillet=0.0).fit(swapped)
    assert model.facts[0].phases[model.label] == "void"
    made = model.generate(48, seed=2)
    assert (made.values == 0).mean() == pytest.approx((swapped.values == 0).mean(), abs=1e-4)


@pytest.mark.whole
def test_a_target_has_more_or_fewer_bodies_and_its_fraction_to_the_voxel(beads):
    model = tb.method("packing", separation=1.0, fillet=0.0).fit(beads)
    reports = {}
    for porosity in (0.45, 0.6):
        made = model.generate(48, seed=1, target={"porosity": porosity})
        assert (made.values == 0).mean() == pytest.approx(porosity, abs=1e-5)
        reports[porosity] = made.recipe.to_json()[-1]["report"]["bodies"]
    assert reports[0.45] > 1.3 * reports[0.6]


@pytest.mark.whole
def test_outside_a_mask_it_is_empty_and_inside_the_fraction_holds(beads):
    model = tb.method("packing", separation=1.0, fillet=0.0).fit(beads)
    mask = np.zeros((48, 48, 48), bool)
    mask[8:40, 5:30] = True
    made = model.generate(48, seed=1, mask=mask)
    assert not made.values[~mask].any()
    assert made.values[mask].mean() == pytest.approx(beads.values.mean(), abs=1e-4)


@pytest.mark.whole
def test_what_is_no_packing_is_refused_with_a_way_out(beads):
    three = tb.Image(beads.values + (np.indices(beads.shape)[0] < 9) * 1, "labels")
    with pytest.raises(InputError, match="two phases"):
        tb.method("packing").fit(three)
    with pytest.raises(InputError, match="larger crop"):
        tb.method("packing").fit(tb.crop(beads, 20))
    with pytest.raises(InputError, match="no phase of the exemplar"):
        tb.method("packing", phase="grains").fit(beads)
    rods = np.zeros((64, 64, 64), bool)
    for y, x in np.ndindex(8, 8):
        rods[(y % 2) * 6 : 58 + (y % 2) * 6, y * 8 + 2 : y * 8 + 5, x * 8 + 2 : x * 8 + 5] = True
    rods[30:32] = False
    with pytest.raises(InputError, match="no bodies"):
        tb.method("packing").fit(tb.Image(rods.astype(np.uint8), "labels"))


@pytest.mark.whole
def test_a_period_shorter_than_a_body_is_refused(beads):
    model = tb.method("packing", separation=1.0, fillet=0.0).fit(beads)
    with pytest.raises(RequestError, match="wide, and axis z repeats after 8"):
        model.generate((8, 32, 32), periodic=(True, False, False))


def test_balls_of_a_volume_have_it():
    radius = float(ball_radii(100.0)[0])
    assert 4 / 3 * np.pi * radius**3 == pytest.approx(100, rel=0.01)

"""Growth by fronts: against its definition in NumPy, and known results of single bubbles."""

import numpy as np
import pytest
from fronts import void
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import trabecula as tb

SHAPE = (14, 22, 19)


def grow(shape, *, seed=1, spacing=1.0, **settings):
    return (
        tb.method("bubbles", **settings).fit(spacing=spacing).generate(shape, seed=seed).values == 0
    )


def bubbles(shape, *, seed=1, **settings):
    """Return places, brakes, names of the bubbles around a box, and the law."""
    model = tb.method("bubbles", **settings).fit()
    growth = model._growth(tb.Request(shape, seed=seed))
    deep = (1,) * (3 - len(shape)) + tuple(shape)
    _, (_, places, brakes, _, names), _, _ = growth.world(tuple((0, side) for side in deep))
    near = (np.abs(places - np.array(deep) / 2) < np.array(deep) / 2 + 4 * growth.law.apart).all(1)
    return places[near], brakes[near], names[near], growth.law


def points(shape):
    deep = (1,) * (3 - len(shape)) + tuple(shape)
    return np.indices(deep).reshape(3, -1).T.astype(float)


@pytest.mark.parametrize("shape", [SHAPE, (60, 50)], ids=["volume", "picture"])
@pytest.mark.parametrize(
    "more",
    [{}, {"time": 0.5}, {"randomness": 0.4, "flow": "horizontal"}],
    ids=["full", "time", "flow"],
)
def test_voxels_are_those_of_the_definition(shape, more):
    """Every voxel, but for those that lie on a border to within rounding and the first order of a
    wall's place.
    """
    settings = {"distance": 15.0, "roughness": 0.0, "spread": 0.3, "separation": 1.5, **more}
    places, brakes, _, law = bubbles(shape, **settings)
    q = (0, 0, 1) if "flow" in more else (0, 0, 0)
    rules = {"wall": law.wall, "level": law.latest**2, "across": law.across, "along": law.along}
    expected = void(places, brakes, points(shape), flow=q, **rules).reshape(shape)
    made = grow(shape, **settings)
    assert 0.2 < expected.mean() < 0.95
    assert (made != expected).mean() < 0.02, "a wall's slope is taken in the middle of its block"
    assert not ndimage.binary_erosion(made != expected).any()


@pytest.mark.whole
def test_without_walls_the_definition_holds_to_the_voxel():
    settings = {"distance": 9.0, "roughness": 0.0, "separation": 0.0, "time": 0.5}
    places, brakes, _, law = bubbles(SHAPE, **settings)
    expected = void(places, brakes, points(SHAPE), wall=0, level=law.latest**2).reshape(SHAPE)
    assert np.count_nonzero(grow(SHAPE, **settings) != expected) <= 2


def alone(time, **settings):
    """Return the void about one bubble that meets no other, its start, and its stop.

    L is 60 voxels.
    """
    settings = {
        "distance": 60.0,
        "spread": 0.0,
        "roughness": 0.0,
        "regularity": 1.0,
        "time": time,
        **settings,
    }
    for seed in range(50):
        places, _, _, law = bubbles((100, 100, 100), seed=seed, **settings)
        middle = places[(np.abs(places - 50) < 15).all(1)]
        if len(middle):
            labels, _ = ndimage.label(grow((100, 100, 100), seed=seed, **settings))
            return labels == labels[tuple(np.round(middle[0]).astype(int))], middle[0], law.latest
    raise AssertionError("no seed puts a bubble in the middle")


def test_a_bubble_that_nothing_stops_is_a_ball():
    ball, place, radius = alone(0.25)
    assert radius == 15
    assert ball.sum() == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    inside = np.argwhere(ball)
    assert np.allclose(inside.mean(0), place, atol=0.15)
    assert np.linalg.norm(inside - place, axis=1).max() <= radius + 1e-6


def test_a_bubble_in_a_straight_flow_is_an_ellipsoid():
    body, place, radius = alone(0.2, randomness=0.5, flow="horizontal")
    assert body.sum() == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.02), (
        "a flow changes the shape, not the size"
    )
    spread = (np.argwhere(body) - place).std(0)
    assert spread[2] / spread[0] == pytest.approx(2, rel=0.03)
    assert spread[1] / spread[0] == pytest.approx(1, rel=0.03)


def test_a_bubble_in_a_circling_flow_bends_with_it():
    """Check two voxels ahead of its start: that on the circle is its own, that on the tangent is
    not.
    """
    chosen = {
        "distance": 50.0,
        "spread": 0.0,
        "roughness": 0.0,
        "randomness": 0.1,
        "flow": "concentric",
        "time": 0.25,
    }
    places, _, _, _ = bubbles((300, 300), seed=2, **chosen)
    labels, _ = ndimage.label(grow((300, 300), seed=2, **chosen))
    on_circle = on_tangent = tried = 0
    for place in places[:, 1:]:
        arm = place - 149.5
        if not 60 < np.hypot(*arm) < 110:
            continue
        own, side = labels[tuple(np.round(place).astype(int))], np.array([-arm[1], arm[0]])
        for angle in (0.35, -0.35):
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            on_circle += labels[tuple(np.round(turn @ arm + 149.5).astype(int))] == own
            on_tangent += (
                labels[tuple(np.round(arm + np.sin(angle) * side + 149.5).astype(int))] == own
            )
            tried += 1
    assert tried >= 10
    assert on_circle > 0.6 * tried
    assert on_tangent < 0.15 * tried


@pytest.mark.parametrize("separation", [2.0, 4.0])
def test_walls_are_as_thick_as_the_separation(separation):
    """Count straight through the wall of two bubbles of one size."""
    settings = {"distance": 24.0, "spread": 0.0, "roughness": 0.0, "separation": separation}
    made = grow((96, 96, 96), **settings)
    places, _, _, _ = bubbles((96, 96, 96), **settings)
    places = places[((places > 0) & (places < 95)).all(1)]
    found = []
    for i, one in enumerate(places):
        for two in places[:i]:
            middle = (one + two) / 2
            if np.partition(np.linalg.norm(places - middle, axis=1), 2)[2] < 1.5 * np.linalg.norm(
                one - middle
            ):
                continue
            line = one + np.linspace(0, 1, 600)[:, None] * (two - one)
            solid = ~ndimage.map_coordinates(made.astype(np.int8), line.T, order=0).astype(bool)
            found.append(solid.mean() * np.linalg.norm(two - one))
    assert len(found) > 20
    assert np.mean(found) == pytest.approx(separation, abs=0.15)
    assert np.std(found) < 0.7


def test_bubbles_that_all_merge_leave_no_wall():
    assert grow(SHAPE, coalescence=1.0).all()
    shares = [grow((48, 48, 48), coalescence=share).mean() for share in (0, 0.5, 1)]
    assert shares[0] < shares[1] < shares[2]


def test_the_same_seed_gives_the_same_bubbles_on_another_grid():
    """Nodes of the coarse grid are nodes of the fine one; what lies between differs by the bend of
    shifts.
    """
    settings = {"density": 12.0**-3, "roughness": 0.0}
    fine = grow((60, 60, 60), spacing=0.5, **settings)[::2, ::2, ::2]
    coarse = grow((30, 30, 30), spacing=1.0, **settings)
    assert (fine != coarse).mean() < 0.01
    settings["roughness"] = 0.3
    fine = grow((60, 60, 60), spacing=0.5, **settings)[::2, ::2, ::2]
    assert (fine != grow((30, 30, 30), spacing=1.0, **settings)).mean() < 0.05


@pytest.mark.whole
@settings(max_examples=12)
@given(
    st.fixed_dictionaries(
        {
            "distance": st.sampled_from([5.0, 7.3, 20.0]),
            "roughness": st.sampled_from([0.0, 0.7]),
            "regularity": st.sampled_from([0.0, 1.0]),
            "randomness": st.sampled_from([1.0, 0.3]),
            "coalescence": st.sampled_from([0.0, 0.4]),
            "flow": st.sampled_from(["none", "spiral"]),
        }
    ),
    st.tuples(*[st.tuples(st.integers(-30, 30), st.integers(1, 12)) for _ in range(3)]),
    st.integers(0, 2**40),
)
def test_any_box_is_a_part_of_any_other(chosen, ends, seed):
    model = tb.method("bubbles", **chosen).fit()
    request = tb.Request((20, 21, 22), seed=seed)
    box = tuple((start, start + length) for start, length in ends)
    wide = tuple((start - 9, stop + 14) for start, stop in box)
    inner = model.values_of(request, wide)[tuple(slice(9, 9 + length) for _, length in ends)]
    assert np.array_equal(model.values_of(request, box), inner)


@pytest.mark.parametrize("periodic", [True, (False, True, True)])
def test_a_turn_of_any_length_repeats(periodic):
    model, shape = tb.method("bubbles", distance=7.0, roughness=0.5).fit(), (19, 26, 37)
    whole = model.generate(shape, seed=4, periodic=periodic).values
    wraps = (True,) * 3 if periodic is True else periodic
    box = tuple(
        (-side - 3, 2 * side + 1) if wrap else (0, side)
        for side, wrap in zip(shape, wraps, strict=True)
    )
    round_ = model.window(shape, box, seed=4, periodic=periodic)
    at = np.ix_(*(np.arange(*ends) % side for ends, side in zip(box, shape, strict=True)))
    assert np.array_equal(round_, whole[at])
    assert not np.array_equal(whole, model.generate(shape, seed=4).values)


def test_nothing_shows_where_a_turn_ends():
    """As many borders between void and solid between the last plane and the first as between any
    two.
    """
    whole = (
        tb.method("bubbles", distance=8.0)
        .fit()
        .generate((64, 64, 61), seed=1, periodic=True)
        .values
    )
    steps = np.count_nonzero(whole != np.roll(whole, 1, axis=2), axis=(0, 1))
    assert abs(steps[0] - steps[1:].mean()) < 4 * steps[1:].std()


def test_a_picture_is_a_material_of_its_own():
    picture = grow((200, 200), distance=14.0, separation=2.0)
    assert picture.shape == (200, 200)
    _, count = ndimage.label(picture)
    assert count == pytest.approx((200 / 14) ** 2, rel=0.3), "a cell for every bubble"

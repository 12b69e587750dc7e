"""Dynamical systems: formulas, steps of Runge-Kutta, coordinates, fields of vectors."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from trabecula.errors import FileError, InputError, UnknownNameError
from trabecula.synth.bubbles.flow import FlowConfig, flow_of
from trabecula.synth.bubbles.flow.systems import SYSTEMS, step_direction

SIDE = 41
WHOLE = ((0, SIDE),) * 3


def whole(shape=(SIDE,) * 3, spacing=1.0, **settings):
    """Return directions -1 .. 1 of a whole box."""
    flow = flow_of(FlowConfig(**settings), shape, spacing)
    return flow.directions(tuple((0, side) for side in shape)) / 127


def test_a_step_ends_where_the_streamline_does():
    """Equation 3, at unit speed, beside an integrator of high order."""

    def velocity(point):
        y, x = point
        return 2 * x * y + 1, x * x - y * y + 1

    def at_unit_speed(_, point):
        v = np.array(velocity(point))
        return v / np.sqrt(v @ v)

    errors = []
    for step in (0.4, 0.2):
        start = (np.array([0.3, -0.7]), np.array([0.5, 0.2]))
        found = np.stack(step_direction(velocity, start, step), axis=-1)
        for begin, direction in zip(np.stack(start, axis=-1), found, strict=True):
            ends = [
                solve_ivp(
                    at_unit_speed, (0, half), begin, rtol=1e-12, atol=1e-13, method="DOP853"
                ).y[:, -1]
                for half in (-step / 2, step / 2)
            ]
            chord = ends[1] - ends[0]
            errors.append(np.abs(direction - chord / np.sqrt(chord @ chord)).max())
    assert max(errors) < 1e-4
    # The end is wrong by the fifth power of the step, its direction by the fourth.
    assert max(errors[2:]) < max(errors[:2]) / 10


def test_on_a_circle_the_step_is_its_tangent():
    y, x = step_direction(lambda point: (point[1], -point[0]), (np.zeros(1), np.ones(1)), 1.0)
    assert np.allclose([y[0], x[0]], [1, 0], atol=1e-9)


def test_what_stands_still_has_no_direction():
    nowhere = step_direction(
        lambda point: (0 * point[0], 0 * point[0] * np.nan), (np.ones(2), np.ones(2)), 1.0
    )
    assert not np.any(nowhere)
    slow = step_direction(
        lambda point: (0 * point[0], 1e-12 + 0 * point[0]), (np.ones(2), np.ones(2)), 1.0
    )
    assert not np.any(slow)


@pytest.mark.parametrize("axis", "zyx")
def test_streamlines_of_concentric_go_round_the_axis(axis):
    along, tall, wide = {"z": (0, 1, 2), "y": (1, 0, 2), "x": (2, 0, 1)}[axis]
    found = whole(flow="concentric", flow_axis=axis)
    places = np.indices((SIDE,) * 3) - (SIDE - 1) / 2
    radius = np.hypot(places[tall], places[wide])
    far = radius > 8
    outward = (found[..., tall] * places[tall] + found[..., wide] * places[wide]) / np.maximum(
        radius, 1
    )
    assert not found[..., along].any()
    assert np.abs(outward[far]).max() < 0.01
    turning = found[..., tall] * places[wide] - found[..., wide] * places[tall]
    assert (turning[far] > 0).all(), "x' = -y, y' = x turns one way"
    assert np.allclose(np.sqrt((found**2).sum(axis=-1))[far], 1, atol=0.01)


@pytest.mark.parametrize(
    ("axis", "across", "up"),
    [("z", (0, 0, 1), (0, 1, 0)), ("y", (0, 0, 1), (1, 0, 0)), ("x", (0, 1, 0), (1, 0, 0))],
)
def test_horizontal_and_vertical_are_those_of_the_slices(axis, across, up):
    shape = (4, 5, 6)
    assert (whole(shape, flow="horizontal", flow_axis=axis) == across).all()
    assert (whole(shape, flow="vertical", flow_axis=axis) == up).all()
    assert (whole(shape, flow="axial", flow_axis=axis) == np.subtract(1, np.add(across, up))).all()


def test_a_spiral_leaves_its_centre_at_one_angle_and_a_roll_has_even_windings():
    y, x = (np.arange(SIDE) - (SIDE - 1) / 2)[:, None], np.arange(SIDE) - (SIDE - 1) / 2
    radius = np.maximum(np.hypot(y, x), 1)
    for name, slope in (("spiral", 0.25), ("roll", 0.08 / (radius / (SIDE / 2)))):
        found = whole((SIDE, SIDE), flow=name)
        outward = found[..., 0] * y + found[..., 1] * x
        round_ = found[..., 0] * x - found[..., 1] * y
        far = radius > 10
        assert np.allclose((outward / radius)[far], (slope * round_ / radius)[far], atol=0.012), (
            name
        )


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_named_system_is_its_own_formula(name):
    spelt = whole((9, 10, 11), flow=SYSTEMS[name] if name != "axial" else "axial")
    assert (whole((9, 10, 11), flow=name) == spelt).all()
    assert spelt.any()


def test_three_formulas_are_of_the_volume_whatever_the_axis():
    for axis in "zyx":
        found = whole((3, 4, 5), flow="1, 2, 2", flow_axis=axis)
        assert np.allclose(found, [2 / 3, 2 / 3, 1 / 3], atol=0.005), (
            "z, y, x of x' = 1, y' = 2, z' = 2"
        )


def test_coordinates_are_shares_of_the_half_side_or_lengths():
    shares = whole((3, 8, 20), spacing=0.5, flow="x - 0.5, 0")[0, 0, :, 2]
    assert np.flatnonzero(np.diff(shares) > 0).tolist() == [14], (
        "x = 0.5 lies three quarters along the longest side"
    )
    lengths = whole((3, 8, 20), spacing=0.5, flow="x - 2, 0", flow_extent=0)[0, 0, :, 2]
    assert np.flatnonzero(np.diff(lengths) > 0).tolist() == [13], (
        "2 units are 4 voxels from the middle of 20"
    )


@pytest.mark.parametrize("name", ["roll", "quadratic", "spiral", "9*x*x - z, y*y - x, z + y"])
def test_a_finer_grid_has_the_same_flow(name):
    coarse, fine = (
        whole((12,) * 3, spacing=3.0, flow=name),
        whole((36,) * 3, spacing=1.0, flow=name),
    )
    middle = fine[1::3, 1::3, 1::3]
    cosine = (coarse * middle).sum(axis=-1)
    assert np.quantile(cosine, 0.02) > 0.97, "steps differ near points where the flow stands still"


@pytest.mark.whole
@given(
    corner=st.tuples(*[st.integers(-30, 30)] * 3),
    size=st.tuples(*[st.integers(1, 12)] * 3),
    step=st.integers(1, 5),
    axis=st.sampled_from("zyx"),
    name=st.sampled_from(["roll", "quadratic", "y, z, x"]),
)
@settings(max_examples=25, deadline=None)
def test_any_box_with_any_step_is_a_part_of_the_whole(corner, size, step, axis, name):
    flow = flow_of(FlowConfig(flow=name, flow_axis=axis), (20, 22, 24), 1.0)
    around = flow.directions(((-30, 42),) * 3)
    box = tuple((a, a + n) for a, n in zip(corner, size, strict=True))
    part = around[tuple(slice(a + 30, b + 30, step) for a, b in box)]
    assert np.array_equal(flow.directions(box, step), part)


def test_nothing_to_follow_is_none():
    assert flow_of(FlowConfig(), (8, 8, 8), 1.0) is None
    assert flow_of(FlowConfig(crust=3, silhouette=3), (8, 8, 8), 1.0) is None, "both are of a mask"
    assert flow_of(FlowConfig(flow="roll"), (8, 8, 8), 1.0) is not None


@pytest.mark.parametrize(
    ("flow", "error", "words"),
    [
        ("concentrik", UnknownNameError, "did you mean 'concentric'"),
        ("-y, q", UnknownNameError, "unknown name in a formula 'q'"),
        ("-y, open(x)", UnknownNameError, "unknown function in a formula 'open'"),
        ("-y, ().__class__", InputError, "only arithmetic"),
        ("x, y, z, x", InputError, "has 4 formulas"),
        ("-y, x +", InputError, "cannot be read"),
        (3, InputError, "a name, a formula, a file"),
        ("nowhere.npy", FileError, "from the folder that the run is started in"),
        (np.zeros((4, 4, 4)), InputError, r"give \(Z, Y, X, 3\)"),
        (np.full((2, 2, 2, 3), np.nan), InputError, "NaN"),
        (lambda z, y, x: z, InputError, "returns three arrays"),
    ],
)
def test_what_is_no_flow_is_refused(flow, error, words):
    with pytest.raises(error, match=words):
        FlowConfig(flow=flow)


def test_commas_in_brackets_do_not_separate_formulas():
    assert (whole((5, 5), flow="max(x, 1), min(0, 1)") == (0, 1)).all()


def test_a_field_of_vectors_spans_what_is_made():
    field = np.zeros((2, 2, 2, 3))
    field[0, ..., 0], field[1, ..., 2] = 4.0, 4.0  # along z below, along x above
    found = whole((8, 6, 6), flow=field)
    assert (found[:2] == (1, 0, 0)).all() and (found[6:] == (0, 0, 1)).all()
    between = found[4, 3, 3]
    assert 0 < between[0] < between[2], "trilinear: three eighths of z, five of x"
    tiny = whole((8, 6, 6), flow=field * 1e-15)
    assert np.array_equal(tiny, found), "the unit of the speed does not matter"


def test_a_picture_takes_a_field_of_pictures():
    field = np.zeros((4, 4, 2), np.float32)
    field[..., 0] = 1
    assert (whole((8, 8), flow=field) == (1, 0)).all()


def test_a_function_is_asked_at_coordinates_of_the_volume():
    def whirl(z, y, x):
        return 0 * z, x, -y

    assert np.array_equal(whole((7, 8, 9), flow=whirl), whole((7, 8, 9), flow="-y, x, 0"))
    recorded = FlowConfig(flow=whirl).flow
    assert recorded.startswith("a function in memory, ") and "whirl" in recorded
    with pytest.raises(InputError, match="nothing says how to make it again"):
        FlowConfig(flow=str(recorded))


def test_a_file_is_named_in_the_recipe_with_its_digest(tmp_path):
    rng = np.random.default_rng(1)
    field = rng.normal(size=(3, 4, 5, 3))
    np.save(tmp_path / "field.npy", field)
    config = FlowConfig(flow=str(tmp_path / "field.npy"))
    plain = json.loads(json.dumps(asdict(config)))
    again = FlowConfig(**plain)
    assert again == config and "#sha256=" in plain["flow"]
    box = ((0, 6),) * 3
    one, two, three = (
        flow_of(made, (6, 6, 6), 1.0).directions(box)
        for made in (config, again, FlowConfig(flow=field))
    )
    assert np.array_equal(one, two) and np.array_equal(one, three)
    np.save(tmp_path / "field.npy", field[::-1])
    with pytest.raises(FileError, match="holds other numbers"):
        FlowConfig(**plain)
    (tmp_path / "field.npy").write_bytes(b"nothing")
    with pytest.raises(FileError, match="cannot be read as an array"):
        FlowConfig(flow=str(tmp_path / "field.npy"))


def test_an_array_in_memory_is_said_to_be_one():
    recorded = json.loads(json.dumps(asdict(FlowConfig(flow=np.ones((2, 2, 2, 3))))))["flow"]
    assert recorded.startswith("an array in memory, SHA-256 ")
    with pytest.raises(InputError, match="nothing says how to make it again; give the array"):
        FlowConfig(flow=recorded)


def test_a_callers_array_is_not_written_into():
    field = np.random.default_rng(2).normal(size=(3, 3, 3, 3))
    before = field.copy()
    whole((5, 5, 5), flow=field)
    assert np.array_equal(field, before)

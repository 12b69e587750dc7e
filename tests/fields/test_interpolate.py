"""Inverse-distance interpolation, straight and around corners."""

import heapq

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula import fields
from trabecula.errors import InputError
from trabecula.fields.interpolate import interior_distance


def equation_seven(shape, points, values, power, spacing=1.0):
    at = (np.stack(np.indices(shape), -1) + 0.5) * spacing
    apart = np.linalg.norm(at[..., None, :] - np.asarray(points), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = apart**-power
        field = (weight * values).sum(-1) / weight.sum(-1)
    for k, value in enumerate(values):
        field[apart[..., k] == 0] = value
    return field


@pytest.mark.whole
@given(
    st.integers(0, 1000),
    st.sampled_from([1.0, 2.0, 4.0, 7.5]),
    st.sampled_from([(5, 6), (4, 5, 6)]),
)
def test_it_is_equation_seven(seed, power, shape):
    rng = np.random.default_rng(seed)
    points = rng.random((4, len(shape))) * shape
    points[0] = 1.5  # the middle of a voxel
    values = rng.random(4)
    field = fields.interpolate(shape, points, values, power=power)
    assert np.allclose(field.values, equation_seven(shape, points, values, power), atol=1e-5)
    assert field.values[(1,) * len(shape)] == np.float32(values[0])


def test_positions_are_in_the_unit():
    spacing = (2.0, 0.5)
    points, values = [(1.0, 0.25), (9.0, 2.75)], [0.0, 1.0]
    field = fields.interpolate((5, 6), points, values, spacing=spacing)
    assert np.allclose(field.values, equation_seven((5, 6), points, values, 4, spacing), atol=1e-6)


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0])
def test_a_filled_field_has_every_known_voxel_as_a_point(power):
    rng = np.random.default_rng(0)
    values, known = rng.random((9, 8, 7)), rng.random((9, 8, 7)) < 0.3
    field = tb.Image(np.where(known, values, 99), "grey", spacing=(1, 1, 2.0))
    filled = fields.fill(field, known, power=power)
    points = (np.argwhere(known) + 0.5) * field.spacing
    assert np.allclose(
        filled.values,
        equation_seven((9, 8, 7), points, values[known], power, field.spacing),
        atol=1e-5,
    )
    assert np.array_equal(filled.values[known], values[known].astype(np.float32))


def shortest(inside, start):
    """Return Dijkstra's distance over 26 neighbours: the true one, or up to 14 % longer."""
    time = np.full(inside.shape, np.inf)
    time[start] = 0
    queue = [(0.0, start)]
    while queue:
        now, at = heapq.heappop(queue)
        if now > time[at]:
            continue
        for step in np.ndindex(3, 3, 3):
            offset = np.array(step) - 1
            to = tuple(np.array(at) + offset)
            if (
                min(to) < 0
                or any(t >= n for t, n in zip(to, inside.shape, strict=True))
                or not inside[to]
            ):
                continue
            then = now + float(np.linalg.norm(offset))
            if then < time[to]:
                time[to] = then
                heapq.heappush(queue, (then, to))
    return time


def test_ways_lead_around_walls():
    inside = np.ones((6, 15, 15), bool)
    inside[:, 5, :12] = False
    inside[:, 10, 3:] = False
    found = interior_distance(inside, (3.5, 1.5, 1.5), (1, 1, 1))
    grid = shortest(inside, (3, 1, 1))
    assert np.array_equal(np.isfinite(found), inside)
    assert np.all(found[inside] <= 1.06 * grid[inside] + 0.5) and np.all(
        found[inside] >= 0.86 * grid[inside] - 0.5
    )
    straight = np.linalg.norm(np.argwhere(inside) - (3, 1, 1), axis=1)
    assert np.all(found[inside] >= straight - 1e-9), "no way is shorter than the straight line"


def test_in_an_open_box_ways_are_straight():
    spacing = (1.0, 0.5, 2.0)
    found = interior_distance(np.ones((12, 24, 8), bool), (0.5, 0.25, 1.0), spacing)
    straight = np.linalg.norm(np.stack(np.indices((12, 24, 8)), -1) * spacing, axis=-1)
    assert np.all(found >= straight - 1e-9) and np.max(found - straight) < 0.09 * straight.max()
    flat = interior_distance(np.ones((12, 24), bool), (0.5, 0.25), spacing[:2])
    assert np.max(np.abs(flat - straight[:, :, 0])) < 0.06 * straight.max()


def test_behind_a_wall_the_near_side_counts():
    mask = np.ones((21, 21), bool)
    mask[10, :19] = False
    points, values = [(8.5, 1.5), (12.5, 1.5)], [0.0, 1.0]
    bent = fields.interpolate((21, 21), points, values, mask=mask, power=2).values
    straight = fields.interpolate((21, 21), points, values, power=2).values
    assert bent[9, 3] < 0.01 < straight[9, 3] and bent[11, 3] > 0.99 > straight[11, 3]


def test_what_no_way_reaches_goes_by_straight_lines():
    mask = np.ones((9, 9), bool)
    mask[4] = False
    field = fields.interpolate((9, 9), [(1.5, 1.5), (2.5, 6.5)], [0.2, 0.8], mask=mask)
    assert np.allclose(
        field.values[5:],
        fields.interpolate((9, 9), [(1.5, 1.5), (2.5, 6.5)], [0.2, 0.8]).values[5:],
    )


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"points": [(1, 1, 1)], "values": [1]}, r"give \(N, 2\)"),
        ({"points": [(1, 1)], "values": [1, 2]}, "one number for each"),
        ({"points": [], "values": []}, "give"),
        ({"points": [(1, np.nan)], "values": [1]}, "NaN"),
        ({"points": [(1, 1)], "values": ["a"]}, "not made of numbers"),
        ({"points": [(1, 1)], "values": [1], "power": 0}, "power=0 is outside"),
        (
            {"points": [(1, 1)], "values": [1], "mask": np.ones((3, 3), bool)},
            r"boolean array of shape \(4, 4\)",
        ),
        ({"points": [(1, 1)], "values": [1], "mask": np.zeros((4, 4), bool)}, "holds no voxel"),
        ({"points": [(9, 1)], "values": [1], "mask": np.ones((4, 4), bool)}, "outside the mask"),
    ],
)
def test_what_does_not_fit_together_is_refused(given_, words):
    with pytest.raises(InputError, match=words):
        fields.interpolate((4, 4), **given_)


def test_nothing_is_filled_from_nothing():
    field = tb.Image(np.ones((3, 3)), "grey")
    for known, words in (
        (np.zeros((3, 3), bool), "no voxel"),
        (np.ones((2, 2), bool), "shape"),
        (np.ones((3, 3)), "boolean"),
    ):
        with pytest.raises(InputError, match=words):
            fields.fill(field, known)
    with pytest.raises(InputError, match="power=6"):
        fields.fill(field, np.ones((3, 3), bool), power=6)

"""The power of the finest level's votes, and the Euler numbers that it is chosen by."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.synth.shared.content.fields import quantise
from trabecula.synth.shared.content.kinds import content_of
from trabecula.synth.shared.matching.grid import Grid, targets_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import cast_votes, equal_weights, match_votes
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.matching.vote_power import (
    _planes_to_try,
    lower_votes,
    power_for,
    raise_distances,
)
from trabecula.synth.shared.statistics.euler import euler_densities, euler_slopes
from trabecula.synth.texture.config import TextureConfig

SIDE, WIDTH, STEP = 32, 6, 2


@pytest.fixture(scope="module")
def bone_field():
    image = tb.crop(tb.sample("bone"), SIDE)
    return quantise(content_of([image]).fields(image), clip=4.2, unit=1)


@pytest.fixture(scope="module")
def jittered(bone_field):
    """A grid over the exemplar itself whose sites are matched to places up to two voxels off."""
    stack = Stack.of([bone_field])
    candidates = Candidates.of(stack, width=WIDTH, step=STEP, variance=0.95, most=32)
    region = Region((SIDE,) * 3, (False,) * 3)
    grid = Grid.over(region, candidates, targets_of(region, stack.histograms, width=WIDTH))
    off = np.random.default_rng(0).integers(-2, 3, (3, *grid.shape))
    last = np.array(candidates.shape).reshape(3, 1, 1, 1) - 1
    places = np.clip(STEP * np.indices(grid.shape) + off, 0, last)
    match = np.ravel_multi_index(tuple(places), candidates.shape).astype(np.int32)
    return grid, match, equal_weights(grid.active)


def apart(jittered, power, euler):
    """Vote with a power; how far the Euler densities are off."""
    grid, match, weights = jittered
    voting = raise_distances(grid.candidates.stack.field, power)
    votes = cast_votes(grid, match, weights, trim=1, field=voting)
    return np.abs(euler_densities([match_votes(grid.region, votes, grid.targets)]) - euler).sum()


def test_euler_densities_are_those_of_the_measure_for_both_sides(bone_field):
    above, below = euler_densities([bone_field])
    inside = (bone_field[0] > 0).astype(np.uint8)
    for found, phase in ((above, 1), (below, 0)):
        measured = tb.measure.euler_density(tb.Image(inside, "labels"), phase=phase)
        assert found == pytest.approx(measured)


def test_several_fields_count_by_their_size(bone_field):
    small = np.ascontiguousarray(bone_field[:, :16])
    cubes = [np.prod(np.array(f.shape[1:]) - 1) for f in (bone_field, small)]
    each = np.array([euler_densities([f]) for f in (bone_field, small)])
    np.testing.assert_allclose(
        euler_densities([bone_field, small]), np.average(each, axis=0, weights=cubes)
    )


def test_slopes_say_what_places_of_other_weights_hold(bone_field):
    """Where the first planes weigh twice and the last nothing, only the first count."""
    g = np.where(np.arange(SIDE)[:, None, None] < 16, 1, -1) + np.zeros((SIDE,) * 3)
    moved = euler_densities([bone_field]) + euler_slopes([bone_field], [g])
    first = np.ascontiguousarray(bone_field[:, :17])  # 16 layers of cubes
    shares = (2 * 16 * 31**2 * euler_densities([first]) - 31**2 * euler_densities([bone_field])) / (
        31**3
    )
    np.testing.assert_allclose(moved, shares)


@pytest.mark.parametrize("power", [0.35, 1.0, 2.0])
def test_lowered_votes_are_those_of_distances(power):
    steps = np.arange(-127, 128).astype(np.int8)
    raised = raise_distances(steps.reshape(1, 1, 1, -1), power).astype(np.int16) * 256
    lowered = lower_votes(raised, power).ravel() / 256
    far = np.abs(steps) >= 30
    np.testing.assert_allclose(lowered[far], steps[far], atol=3)
    assert (np.diff(lowered) >= 0).all()


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_raised_distances_keep_signs_and_ends(power):
    steps = np.arange(-127, 128).astype(np.int8)
    raised = raise_distances(steps.reshape(1, 1, -1), power).ravel().astype(int)
    assert (raised[[0, 127, 254]] == [-127, 0, 127]).all()
    assert (np.diff(raised) >= 0).all()
    assert (raised == -raised[::-1]).all()
    middle = raised[127 + 32]
    assert (middle > 32, middle == 32, middle < 32)[(0.5, 1.0, 2.0).index(power)]


def test_the_power_leaves_loops_nearer_to_the_exemplars(jittered, bone_field):
    euler = euler_densities([bone_field])
    power = power_for(*jittered, euler, trim=1)
    assert power < 1  # a plain vote takes loops away
    assert apart(jittered, power, euler) < apart(jittered, 1.0, euler)


def test_no_power_but_1_where_a_plain_vote_is_right(jittered):
    grid, match, weights = jittered
    votes = cast_votes(grid, match, weights, trim=1)
    euler = euler_densities([match_votes(grid.region, votes, grid.targets)])
    assert power_for(*jittered, euler, trim=1) == 1


def test_votes_of_some_planes_are_the_first_of_all(jittered):
    whole = cast_votes(*jittered, trim=1)
    some = cast_votes(*jittered, trim=1, planes=20)
    np.testing.assert_array_equal(some, whole[:, :20])


def test_recipes_of_before_vote_with_plain_distances():
    assert TextureConfig.recorded({})["vote_power"] == 1
    assert TextureConfig.recorded({"vote_power": 0.0})["vote_power"] == 0


def test_beside_known_voxels_the_free_ones_choose(jittered, bone_field):
    """A wrong target for the known half changes nothing: its cubes do not count."""
    grid, match, weights = jittered
    known = np.arange(SIDE)[:, None, None] < 12
    free = np.ascontiguousarray(np.broadcast_to(~known, (SIDE,) * 3))
    low = np.where(free, -127, bone_field).astype(np.int8)
    high = np.where(free, 127, bone_field).astype(np.int8)
    region = Region((SIDE,) * 3, (False,) * 3, free, low, high)
    beside = Grid(grid.candidates, region, grid.shape, grid.active, grid.targets)
    euler = euler_densities([bone_field], within=free)
    assert not np.allclose(euler, euler_densities([bone_field]), rtol=0.02)
    apart = {}
    for power in (0.35, 0.5, 0.5**0.5, 1.0):
        votes = cast_votes(beside, match, weights, trim=1, field=raise_distances(bone_field, power))
        made = match_votes(region, lower_votes(votes, power), grid.targets)
        apart[power] = np.abs(euler_densities([made], within=free) - euler).sum()
    found = power_for(beside, match, weights, euler, trim=1)
    assert found < 1 and apart[min(apart, key=lambda power: abs(power - found))] < apart[1.0]


def test_euler_densities_within_a_mask_are_those_of_what_it_holds(bone_field):
    within = np.zeros(bone_field.shape[1:], bool)
    within[5:20] = True
    part = np.ascontiguousarray(bone_field[:, 5:20])
    np.testing.assert_allclose(
        euler_densities([bone_field], within=within), euler_densities([part])
    )


def test_so_many_planes_are_tried_as_hold_enough_free_voxels(monkeypatch):
    monkeypatch.setattr("trabecula.synth.shared.matching.vote_power._ENOUGH", 200)
    free = np.zeros((40, 10, 10), bool)
    free[30:] = True
    assert _planes_to_try(free.shape, free) == 32
    assert _planes_to_try(free.shape) == 16
    assert _planes_to_try(free.shape, ~free) == 16
    assert _planes_to_try(free.shape, np.zeros_like(free)) == 40


def test_the_first_planes_of_a_region_are_its_own(bone_field):
    free = bone_field[0] > 0
    region = Region((SIDE,) * 3, (True,) * 3, free, bone_field, bone_field)
    part = region.first_planes(9)
    assert part.shape == (9, SIDE, SIDE) and part.wraps == (False, True, True)
    assert part.free.shape == (9, SIDE, SIDE) and part.low.shape == part.high.shape
    np.testing.assert_array_equal(part.low, bone_field[:, :9])
    assert region.first_planes(SIDE) is region

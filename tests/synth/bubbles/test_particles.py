"""Growth by particles: what the paper's algorithms promise."""

import numpy as np
import pytest

from trabecula.core.errors import InputError
from trabecula.synth.bubbles.particles import grow_particles


def seeds_in(shape, count, number=0):
    rng = np.random.default_rng(number)
    return np.unique(np.stack([rng.integers(0, side, count) for side in shape], 1), axis=0)


def components(air):
    """Return the connected components (corners count) of a picture or volume, as sets of places."""
    left, parts = {tuple(place) for place in np.argwhere(air)}, []
    while left:
        part, edge = set(), [left.pop()]
        while edge:
            place = edge.pop()
            part.add(place)
            around = {tuple(np.add(place, step) - 1) for step in np.ndindex((3,) * air.ndim)}
            edge.extend(around & left)
            left -= around
        parts.append(part)
    return parts


def test_one_particle_without_a_flow_becomes_a_square_a_round():
    air = grow_particles(np.array([[20, 20]]), (41, 41), seed=1, rounds=6).air
    assert np.array_equal(np.argwhere(air).min(0), (15, 15))
    assert air.sum() == 11**2


@pytest.mark.whole
@pytest.mark.parametrize("separation", [1, 2, 4])
@pytest.mark.parametrize("shape", [(60, 50), (20, 24, 22)])
def test_particles_stay_apart(shape, separation):
    air = grow_particles(seeds_in(shape, 12), shape, seed=3, separation=separation).air
    parts = components(air)
    assert 5 <= len(parts) <= 12
    places = [np.array(sorted(part)) for part in parts]
    for i, one in enumerate(places):
        for other in places[:i]:
            apart = np.sqrt(((one[:, None] - other[None]) ** 2).sum(-1)).min()
            assert apart >= separation + 1


def test_full_means_that_nothing_more_fits():
    """Every voxel of mass is within the separation of two particles, or of one and the seeds of
    none.
    """
    shape = (50, 50)
    result = grow_particles(seeds_in(shape, 9), shape, seed=3, separation=2)
    assert result.alive == 0
    parts = [np.array(sorted(part)) for part in components(result.air)]
    for place in np.argwhere(~result.air):
        near = sum(((part - place) ** 2).sum(1).min() < 9 for part in parts)
        assert near >= 2


def test_neither_seed_nor_order_of_places_is_lost():
    places = seeds_in((40, 40), 10)
    first, again, other = (
        grow_particles(places, (40, 40), seed=n, rounds=9).air for n in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_target_is_met_to_the_voxel_or_the_most_is_told():
    places = seeds_in((40, 44), 12)
    assert grow_particles(places, (40, 44), seed=1, porosity=0.3).air.sum() == round(0.3 * 40 * 44)
    with pytest.raises(InputError, match=r"fill 0\.\d+ at most"):
        grow_particles(places, (40, 44), seed=1, separation=4, porosity=0.9)


def test_room_is_kept_to_and_shares_count_in_it():
    room = np.hypot(*np.mgrid[-20:20, -20:20]) < 17
    result = grow_particles(seeds_in(room.shape, 20), room.shape, seed=2, room=room, porosity=0.4)
    assert not (result.air & ~room).any()
    assert result.air.sum() == round(0.4 * room.sum())


def test_a_periodic_field_goes_round():
    one = np.array([[0, 0]])
    air = grow_particles(one, (20, 20), seed=1, periodic=(True, True), rounds=3).air
    assert np.array_equal(air, np.roll(np.pad(np.ones((5, 5), bool), (0, 15)), (-2, -2), (0, 1)))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0])
def test_particles_follow_a_flow_with_little_randomness(angle):
    """The direction of a strand is that of the flow, also between the lattice's own directions."""
    shape = (301, 301)
    flow = np.broadcast_to(
        np.rint(127 * np.array([np.sin(angle), np.cos(angle)])).astype(np.int8), (*shape, 2)
    )
    air = grow_particles(
        np.array([[20, 20]]), shape, seed=4, directions=flow, randomness=0.0, rounds=200
    ).air
    end = np.argwhere(air).max(0) - 20
    assert np.arctan2(*end) == pytest.approx(angle, abs=0.06)
    assert air.sum() == 200, "one voxel a round"


def test_randomness_widens():
    flow = np.broadcast_to(np.array([0, 127], np.int8), (81, 161, 2))
    widths = []
    for randomness in (0.02, 0.1, 1.0):
        air = grow_particles(
            np.array([[40, 80]]),
            (81, 161),
            seed=4,
            directions=flow,
            randomness=randomness,
            rounds=25,
        ).air
        places = np.argwhere(air)
        widths.append(np.ptp(places[:, 0]) / np.ptp(places[:, 1]))
    assert widths[0] < widths[1] < widths[2] == 1.0

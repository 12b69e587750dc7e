"""What is known beside new material: the pairs that steps cannot change, and how far they move."""

import numpy as np
import pytest

from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.known_part import (
    KnownPart,
    hold_move,
    interface_beside,
    is_a_sample,
    move_shares,
    target_beside,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.statistics.interface import interface_share
from trabecula.synth.shared.statistics.pairs import DIAGONAL
from trabecula.synth.shared.statistics.torus_steps import TorusPairs
from trabecula.synth.shared.statistics.two_point import Soft, correlations_of, soft_means

SHAPE = (24, 16, 20)
SOFT = 40.0


@pytest.fixture(scope="module")
def field():
    rough = np.random.default_rng(4).standard_normal(SHAPE)
    for axis in range(3):
        rough = rough + np.roll(rough, 1, axis)
    return np.clip(rough * 40, -127, 127).astype(np.int8)[None]


@pytest.fixture(scope="module")
def target(field):
    return correlations_of([field], softness=SOFT, r_max=6, directions=DIAGONAL)


@pytest.fixture(scope="module")
def means(field):
    return soft_means((Histogram.of(field[0].ravel()),), SOFT)


def curve_of(field, target):
    """The two-point function of a field on a torus."""
    pairs = TorusPairs.of(field.shape[1:], target)
    spectrum = pairs.forward(Soft.of(field[0], target.softness).planes)
    return pairs.curve(spectrum, spectrum)


def first_planes(count):
    known = np.zeros(SHAPE, bool)
    known[:count] = True
    return known


def test_where_all_is_known_the_target_is_what_is_there(field, target, means):
    found = target_beside(target, means, np.ones(SHAPE, bool), field)
    np.testing.assert_allclose(found.curves[0], curve_of(field, target), atol=1e-5)


def test_where_nothing_is_known_the_target_stays(field, target, means):
    found = target_beside(target, means, np.zeros(SHAPE, bool), field)
    np.testing.assert_allclose(found.curves, target.curves, atol=1e-6)


@pytest.mark.parametrize("planes", [6, 12])
def test_pairs_of_known_voxels_keep_their_own(planes, target, means, field):
    """Of neighbours along z: known ones by brute force, the others by their share."""
    known, pairs = first_planes(planes), TorusPairs.of(SHAPE, target)
    _, y, x = pairs.reach
    place = pairs.places[1, y, x]  # of pairs that are one voxel apart along z
    denser = np.clip(field.astype(np.int16) + 20, -127, 127).astype(np.int8)
    found = target_beside(target, means, known, denser).curves[0]
    soft = np.where(known, Soft.of(denser[0], SOFT).planes(0, SHAPE[0]), 0)
    free, own = float(means[0]), float(soft[known].mean())
    both, curve = np.mean(known & np.roll(known, 1, 0)), target.curves[0, place]
    one = 2 * (known.mean() - both)
    covariance = (curve - free**2) / (free - free**2)
    between = covariance * np.sqrt((free - free**2) * (own - own**2)) + own * free
    held = np.mean(soft * np.roll(soft, 1, 0))
    wanted = held + one * between + (1 - both - one) * curve
    assert found[place] == pytest.approx(wanted, abs=1e-4)


def test_known_interfaces_count_as_they_are(field):
    share = interface_share([field])
    known = first_planes(10)
    sides = field[0] > 0
    pairs = changes = held = 0
    for axis in range(3):
        near = [slice(None)] * 3
        far = [slice(None)] * 3
        near[axis], far[axis] = slice(None, -1), slice(1, None)
        both = known[tuple(near)] & known[tuple(far)]
        pairs += both.size
        held += np.count_nonzero(both)
        changes += np.count_nonzero(both & (sides[tuple(near)] != sides[tuple(far)]))
    wanted = (changes + 0.5 * share * (pairs - held)) / pairs
    np.testing.assert_allclose(interface_beside(0.5 * share, known, field), wanted)
    whole = interface_beside(0.5 * share, np.ones(SHAPE, bool), field)
    np.testing.assert_allclose(whole, share)


def test_moves_are_whole_from_four_voxels_beyond_the_known_ones_on():
    shares = move_shares(first_planes(8), (False, False, False))
    assert shares[:, 3, 3].tolist()[6:14] == [0, 0, 8, 24, 40, 56, 64, 64]
    around = move_shares(first_planes(8), (True, False, False))
    assert around[-1, 3, 3] == 8 and shares[-1, 3, 3] == 64


def test_a_held_move_goes_its_share_of_the_way(field):
    shares = move_shares(first_planes(8), (False,) * 3)
    votes = np.full(field.shape, 100 * UNIT, np.int16)
    hold_move(votes, field, shares)
    before = field.astype(np.int32) * UNIT
    wanted = before + (shares * (100 * UNIT - before)) // 64
    np.testing.assert_array_equal(votes, wanted)
    np.testing.assert_array_equal(votes[:, :8], before[:, :8])


def test_known_voxels_are_measured_by_the_middles_of_their_bounds(field, target, means):
    known = first_planes(12)
    low = np.where(known, field, -127).astype(np.int8)
    high = np.where(known, field, 127).astype(np.int8)
    region = Region(SHAPE, (True,) * 3, ~known, low, high)
    part, shares = KnownPart.of(region, target, means, interface_share([field]))
    wanted = target_beside(target, means, known, field)
    np.testing.assert_allclose(part.target.curves, wanted.curves)
    assert part.interface == pytest.approx(interface_share([field]), rel=0.1)
    np.testing.assert_array_equal(shares, move_shares(known, region.wraps))
    assert KnownPart.of(region, target, means, None)[0].interface is None


def test_three_tenths_of_free_voxels_are_a_sample():
    assert is_a_sample(np.arange(100).reshape(4, 5, 5) < 70)
    assert not is_a_sample(np.arange(100).reshape(4, 5, 5) < 71)

"""Interfaces of fields: their share by hand, and moves that are shortened to it."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.synth.shared.content.fields import UNIT, quantise
from trabecula.synth.shared.statistics.interface import interface_share, share_at, shorten_move
from trabecula.synth.shared.statistics.two_point import correlations_of


def ball(radius, side=24):
    away = np.indices((side, side, side)) - (side - 1) / 2
    return quantise(radius - np.sqrt((away**2).sum(axis=0))[None], clip=4)


def fringed(field, seed=0):
    noise = np.random.default_rng(seed).normal(0, 60, field.shape)
    return (np.clip(field + noise, -127, 127) * UNIT).astype(np.int16)


def share_by_hand(inside):
    changes = [np.diff(inside.astype(int), axis=axis) != 0 for axis in range(3)]
    return sum(int(each.sum()) for each in changes) / sum(each.size for each in changes)


def test_the_share_counts_neighbours_on_different_sides():
    field = ball(7.3)
    assert interface_share([field])[0] == pytest.approx(share_by_hand(field[0] > 0))
    both = interface_share([field, ball(9.1)])[0]
    assert interface_share([field])[0] < both < interface_share([ball(9.1)])[0]
    two = interface_share([np.concatenate([field, ball(9.1)])])
    assert two.shape == (2,) and two[0] == interface_share([field])[0]


def test_a_move_that_makes_no_more_interface_is_left_alone():
    field, votes = ball(7.3), ball(6.0).astype(np.int16) * UNIT
    moved = shorten_move(field, votes.copy(), interface_share([field]))
    assert np.array_equal(moved, votes)


def test_a_move_is_shortened_to_the_most_that_is_allowed():
    field, most = ball(7.3), 1.5 * interface_share([ball(7.3)])
    votes = fringed(field)
    assert share_by_hand(votes[0] > 0) > most[0]
    moved = shorten_move(field, votes.copy(), most)
    assert share_by_hand(moved[0] > 0) <= most[0]
    before = field.astype(float) * UNIT
    asked = votes - before
    part = np.round(8 * np.median((moved - before)[asked != 0] / asked[asked != 0]))
    assert 0 < part < 8 and np.allclose(moved, before + part / 8 * asked, atol=1)


def test_a_field_with_too_much_interface_is_not_moved():
    field = ball(7.3)
    moved = shorten_move(field, fringed(field), 0.5 * interface_share([field]))
    assert np.array_equal(moved, field.astype(np.int16) * UNIT)


def test_threads_change_nothing():
    field, most = ball(7.3), 1.5 * interface_share([ball(7.3)])
    with tb.threads(1):
        one = shorten_move(field, fringed(field), most)
    with tb.threads(2):
        two = shorten_move(field, fringed(field), most)
    assert np.array_equal(one, two)


def plates(period, side=48):
    place = np.arange(side) % period - (period - 1) / 2
    field = quantise(period / 4 - np.abs(place), clip=4, unit=1.0)
    return np.broadcast_to(field[:, None, None], (side, 24, 24))[None].copy()


def test_the_share_of_other_material_follows_its_two_point_function():
    """Plates twice as far apart have half of the interface, nearly: a bin holds diagonals."""
    near, far = (correlations_of([plates(p)], softness=1.0, r_max=6) for p in (12, 24))
    share = interface_share([plates(12)])
    assert share_at(share, near, far)[0] == pytest.approx(share[0] / 2, rel=0.2)
    assert share_at(share, near, near)[0] == pytest.approx(share[0])

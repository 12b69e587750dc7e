"""`Request`: what it takes, and which of its parts are in use."""

import dataclasses

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError


def test_a_cube_and_defaults():
    request = tb.Request(5)
    assert request.shape == (5, 5, 5) and request.seed == 0 and request.periodic == (False,) * 3
    assert request.asks_for() == frozenset()


@pytest.mark.parametrize("value", [True, np.True_, (1, 1, 1), [True] * 3])
def test_periodic_along_every_axis(value):
    assert tb.Request(5, periodic=value).periodic == (True, True, True)


def test_parts_in_use_are_named():
    image = tb.Image(np.zeros((2, 2, 2), int), "labels")
    full = tb.Request(
        2,
        periodic=(False, True, False),
        mask=np.ones((2,) * 3, bool),
        target={"porosity": np.ones((2,) * 3)},
        fixed=image,
    )
    assert full.asks_for() == {"periodic", "mask", "target", "fixed"}
    assert tb.Request(2, fixed=image).asks_for() == {"fixed"}
    assert tb.Request(2, target={}).asks_for() == frozenset()


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"shape": 0}, "must be positive"),
        ({"shape": (4, 4)}, "has 2 numbers"),
        ({"shape": 4.5}, "whole numbers"),
        ({"shape": 10**9}, "more than 2\\*\\*48"),
        ({"shape": 4, "seed": -1}, "seed -1 is outside"),
        ({"shape": 4, "seed": 0.5}, "seed 0.5 is not an integer"),
        ({"shape": 4, "periodic": (True, False)}, "one truth value or three"),
    ],
)
def test_refused(fields, says):
    with pytest.raises(InputError, match=says):
        tb.Request(**fields)


def test_a_request_does_not_change():
    with pytest.raises(dataclasses.FrozenInstanceError):
        tb.Request(5).seed = 1

"""Droplets keep the shares, locally, and do not repeat from layer to layer."""

import numpy as np
import pytest

from trabecula.core.seeds import key
from trabecula.layers.dithering import diffuse


@pytest.mark.parametrize("share", [0.1, 0.37, 0.5, 0.9])
def test_the_share_is_kept_in_every_corner(share):
    shares = np.stack([np.full((64, 64), 1 - share), np.full((64, 64), share)]).astype(np.float32)
    drops = diffuse(np.ones((64, 64), bool), shares, key(0, "t"), 3)
    windows = drops.reshape(4, 16, 4, 16).mean(axis=(1, 3))
    assert np.abs(windows - share).max() < 0.04


def test_a_pure_share_is_pure_and_nothing_is_placed_outside():
    shares = np.stack([np.zeros((8, 9)), np.ones((8, 9)), np.zeros((8, 9))]).astype(np.float32)
    inside = np.zeros((8, 9), bool)
    inside[2:5] = True
    drops = diffuse(inside, shares, key(0, "t"), 0)
    assert (drops[inside] == 1).all() and (drops[~inside] == 0).all()


def test_layers_differ_and_come_out_alike_again():
    shares = np.full((2, 32, 32), 0.5, np.float32)
    inside = np.ones((32, 32), bool)
    one, again, other = (diffuse(inside, shares, key(1, "t"), k) for k in (4, 4, 5))
    assert (one == again).all()
    assert 0.3 < (one != other).mean() < 0.7

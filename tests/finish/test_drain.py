"""Holes lead from every closed pore into the open, and are as wide as was said."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure.distance import distance_transform


def report(image):
    return image.recipe.steps[-1]["report"]


def box(side=15, at=(7, 7, 7), half=2):
    values = np.ones((side,) * 3, np.uint8)
    values[tuple(slice(place - half, place + half + 1) for place in at)] = 0
    return values


def test_a_pore_is_opened_the_shortest_way():
    values = box(at=(7, 7, 4))
    drained = tb.finish.drain(values, width=1)
    assert report(drained)["holes"] == 1 and report(drained)["left"] == 0
    assert report(drained)["removed"] == 2  # two voxels of wall towards low x
    assert (drained.values[7, 7, :2] == 0).all()
    assert tb.finish.trapped(drained)["pores"] == 0


def test_the_hole_lets_a_ball_of_its_width_pass():
    values = box(31, half=5)
    drained = tb.finish.drain(values, width=5)
    void = np.pad(drained.values == 0, 5, constant_values=True)
    wide = distance_transform(void) >= 2.5
    from trabecula.measure.labelling import label_components

    assert len(label_components(wide)[1]) == 1
    area = report(drained)["removed"] / (report(drained)["longest"] - 1)
    assert area == pytest.approx(np.pi * 2.5**2, rel=0.25)


def test_every_pore_of_many_is_opened():
    rng = np.random.default_rng(0)
    values = (rng.random((24, 24, 24)) < 0.9).astype(np.uint8)
    assert tb.finish.trapped(values)["pores"] > 50
    drained = tb.finish.drain(values, width=1)
    assert tb.finish.trapped(drained)["pores"] == 0
    assert (drained.values <= values).all()
    kept = tb.finish.drain(values, width=1, min_size=3)
    assert report(kept)["left"] == tb.finish.trapped(kept)["pores"] > 0


def test_lengths_are_in_the_unit_and_voxels_need_not_be_cubes():
    values = np.ones((9, 21, 21), np.uint8)
    values[4, 10, 10] = 0
    image = tb.Image(values, "labels", (4.0, 1.0, 1.0), unit="um")
    drained = tb.finish.drain(image, width=3)
    assert report(drained)["longest"] == 11  # along y: 11 um; along z it would be 20
    assert tb.finish.trapped(drained)["pores"] == 0


def test_nothing_to_open_changes_nothing():
    values = np.zeros((5, 5, 5), np.uint8)
    values[2] = 1
    drained = tb.finish.drain(values, width=2)
    assert (drained.values == values).all() and report(drained)["holes"] == 0
    assert report(drained)["components"] == [1, 1]


def test_what_cannot_be_drained_is_refused():
    for width in (0, -1, 100):
        with pytest.raises(tb.errors.InputError, match="width"):
            tb.finish.drain(box(), width=width)
    with pytest.raises(tb.errors.InputError, match="3 axes"):
        tb.finish.drain(np.ones((4, 4), np.uint8), width=1)
    with pytest.raises(tb.errors.InputError, match="nothing"):
        tb.finish.drain(np.zeros((4, 4, 4), np.uint8), width=1)

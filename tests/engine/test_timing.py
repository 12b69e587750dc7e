"""Seconds that are forecast: of makers whose cost is known, told by a clock of their own."""

from math import prod

import pytest

from trabecula.engine.chunking import boxes_of
from trabecula.pipeline.plan import seconds_of, seconds_of_whole


class Maker:
    """Takes c (s + h)^3 seconds for a box, on its own clock."""

    def __init__(self, cost, around=0.0, first=0.0):
        self.cost, self.around, self.first, self.now, self.made = cost, around, first, 0.0, []

    def seconds(self, box):
        return self.cost * prod(last - start + self.around for start, last in box)

    def __call__(self, box):
        self.now += self.seconds(box) + (0.0 if self.made else self.first)
        self.made.append(box)

    def clock(self):
        return self.now

    def forecast(self, shape, side):
        return seconds_of(self, shape, side, clock=self.clock)

    def truth(self, shape, side):
        return sum(self.seconds(box) for box in boxes_of(shape, side)) + 30e-9 * prod(shape)


@pytest.mark.parametrize("around", [0, 20, 64])
@pytest.mark.parametrize(
    ("shape", "side"), [((1024,) * 3, 256), ((300, 700, 410), 128), ((90, 80, 70), 256)]
)
@pytest.mark.parametrize("cost", [1e-9, 1e-7, 3e-6])
def test_what_a_block_takes_follows_from_smaller_boxes(shape, side, around, cost):
    maker = Maker(cost, around)
    assert maker.forecast(shape, side) == pytest.approx(
        maker.truth(shape, side), rel=0.01, abs=1.5 * maker.seconds(((0, 8),) * 3)
    )


def test_a_trial_costs_little():
    maker = Maker(1e-7)
    maker.forecast((1024,) * 3, 256)
    assert maker.now < 2.0
    assert all(0 <= start < last <= 1024 for box in maker.made for start, last in box)


def test_what_is_done_once_counts_once():
    shape, side = (512,) * 3, 128
    assert Maker(1e-7, first=100.0).forecast(shape, side) == pytest.approx(
        100 + Maker(1e-7).forecast(shape, side)
    )


def test_flat_volumes_and_pictures():
    for shape in ((1, 500, 500), (400, 300), (4, 4, 4)):
        maker = Maker(1e-7)
        assert maker.forecast(shape, 128) == pytest.approx(
            maker.truth(shape, 128), rel=0.01, abs=1e-4
        )


@pytest.mark.parametrize("shape", [(1024,) * 3, (20, 700, 30), (60, 50, 40), (8, 8, 8)])
@pytest.mark.parametrize(("cost", "always"), [(1e-7, 0.0), (2e-6, 0.3), (4e-5, 0.02)])
def test_what_a_whole_takes_follows_from_smaller_ones(shape, cost, always):
    """Of a maker that takes a constant beside a cost a voxel, and more at the first call."""
    now, made = [0.0], []

    def make(sides):
        now[0] += always + cost * prod(sides) + (0 if made else 5)
        made.append(prod(sides))

    found = seconds_of_whole(make, shape, clock=lambda: now[0])
    truth = always + cost * prod(shape)
    # Half of the mean cost is the least that is believed of a further voxel, however much the
    # constant hides.
    assert found >= truth
    assert found == pytest.approx(truth + 30e-9 * prod(shape), rel=0.01) or always / cost > max(
        made
    )
    assert now[0] < 5 + 12 + 3 * cost * 36**3


def test_a_constant_does_not_rule_the_forecast_of_a_large_volume():
    """Half a second beside 2.5 us a voxel: 40 us a voxel of 24^3, as the default of `texture`."""
    now = [0.0]

    def make(sides):
        now[0] += 0.5 + 2.5e-6 * prod(sides)

    found = seconds_of_whole(make, (512,) * 3, clock=lambda: now[0])
    assert found == pytest.approx(2.5e-6 * 512**3, rel=0.05)

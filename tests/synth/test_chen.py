"""`chen`: voxels are pixels, and all pixels are used."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.synth.chen.config import ChenConfig
from trabecula.synth.chen.method import position_excess
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.planes import RegionViews
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack

QUICK = {"rounds": (3, 5), "first_rounds": 10, "sweeps": (1, 2), "tries": 4}


def spots(side=48):
    """Colours that occur together only: red discs in blue, with a little noise in both."""
    y, x = np.indices((side, side)) % 12 - 5.5
    disc = (y**2 + x**2 < 14)[..., None]
    noise = np.random.default_rng(0).integers(-20, 21, (side, side, 1))
    return tb.Image(
        (np.where(disc, (200, 40, 30), (30, 40, 200)) + noise).astype(np.uint8), "colour"
    )


@pytest.mark.whole
@pytest.mark.parametrize("orientations", ["none", "all"])
def test_no_colour_is_new(orientations):
    picture = spots()
    made = (
        tb.method("chen", orientations=orientations, **QUICK)
        .fit(picture)
        .generate((26, 24, 28), seed=1)
    )
    known = {tuple(colour) for colour in picture.values.reshape(-1, 3).tolist()}
    assert {tuple(colour) for colour in made.values.reshape(-1, 3).tolist()} <= known
    red = [np.mean(image.values[..., 0] > image.values[..., 2]) for image in (picture, made)]
    assert red[1] == pytest.approx(red[0], abs=0.1)


@pytest.mark.whole
def test_fixed_pixels_stay_and_outside_a_form_is_nothing():
    picture = spots()
    shape = (24, 26, 26)
    known, mask = np.zeros(shape, bool), np.ones(shape, bool)
    known[12], mask[:4] = True, False
    values = np.zeros((*shape, 3), np.uint8)
    values[12] = picture.values[:26, :26]
    fixed = tb.Image(values, "colour")
    made = (
        tb.method("chen", **QUICK)
        .fit(picture)
        .generate(shape, seed=1, mask=mask, fixed=fixed, known=known)
        .values
    )
    assert np.array_equal(made[12], picture.values[:26, :26])
    assert not made[:4].any()
    red = made[..., 0] > made[..., 2]
    assert np.mean(red[12] != red[13]) < 0.6 * np.mean(red[12] != red[22])


def test_the_penalties_spread_the_use_of_pixels():
    """How many pixels of the picture are the source of any voxel: more with both histograms than
    with neither.
    """
    rng = np.random.default_rng(3)
    # every value once
    picture = tb.Image(rng.permutation(90 * 90).reshape(90, 90).astype(np.uint16), "grey")
    used = []
    for weight in (0.0, 5.0):
        method = tb.method("chen", index_penalty=weight, position_penalty=weight, **QUICK)
        used.append(len(np.unique(method.fit(picture).generate(18, seed=1).values)))
    assert used[1] > 1.05 * used[0]


def test_the_position_histogram_alone_spreads_the_use_of_pixels():
    rng = np.random.default_rng(3)
    picture = tb.Image(rng.permutation(30 * 30).reshape(30, 30).astype(np.uint16), "grey")
    used = []
    for weight in (0.0, 1.0):
        method = tb.method("chen", index_penalty=0.0, position_penalty=weight, **QUICK)
        used.append(len(np.unique(method.fit(picture).generate(16, seed=1).values)))
    assert used[1] > 1.05 * used[0]


@pytest.mark.whole
def test_fractions_of_labels_are_exact():
    values = (np.random.default_rng(0).random((40, 40)) < 0.5).astype(float)
    for _ in range(3):
        values = (values + np.roll(values, 1, 0) + np.roll(values, 1, 1)) / 3
    picture = tb.Image((values > 0.55).astype(np.uint8), "labels")
    model = tb.method("chen", **QUICK).fit(picture)
    made = model.generate(28, seed=1)
    assert np.count_nonzero(made.values) == round(28**3 * picture.values.mean())
    made = model.generate(28, seed=1, target={"porosity": 0.7})
    assert np.count_nonzero(made.values == 0) == round(28**3 * 0.7)


def test_the_excess_is_counted_in_multiples_of_even_use():
    field = np.zeros((1, 1, 12, 12), np.int8)
    field[0, 0, :6] = 50
    candidates = Candidates.of(Stack.of([field]), width=8, step=2, variance=0.9, most=8, flat=True)
    views = [(0, candidates), (1, candidates)]
    frame = RegionViews.over(Region((12, 12, 12)), views, (Histogram.of(field),))
    sources = np.repeat(np.arange(288), 6).reshape(12, 12, 12)
    assert all((over == 1).all() for over in position_excess(sources, frame, 2.0))
    # the second view's eighth pixel: used twice as often
    sources = np.where(sources == 150, 151, sources)
    first, second = position_excess(sources, frame, 2.0)
    assert (first == 1).all()
    assert second.ravel()[7] == pytest.approx(3)
    assert np.count_nonzero(second != 1) == 1
    assert all((over == 1).all() for over in position_excess(None, frame, 2.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [("index_penalty", -1), ("position_penalty", 11), ("discrete", "yes"), ("sweeps", 0)],
)
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        ChenConfig(**{name: value})

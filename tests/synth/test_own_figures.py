"""What is off in a result: against material that is made to differ in one known figure."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.synth.shared.own_figures import Figure, OwnFigures, off_line


def rods(side, period, width, *, seed=None):
    """Square rods along z, `period` voxels apart; moved at random, a rod at a time, with a seed."""
    values = np.zeros((side, side, side), np.uint8)
    draw = np.random.default_rng(seed)
    for y in range(0, side, period):
        for x in range(0, side, period):
            dy, dx = (0, 0) if seed is None else draw.integers(0, period - width, 2)
            values[:, y + dy : y + dy + width, x + dx : x + dx + width] = 1
    return tb.Image(values, "labels", phases=("void", "solid"))


def figures_of(own, result):
    return own.compare(result, result.values)


@pytest.fixture(scope="module")
def own():
    found = OwnFigures.of(rods(48, 12, 6, seed=1), box=48)
    assert found is not None
    return found


def test_another_sample_is_not_off(own):
    assert off_line(figures_of(own, rods(48, 12, 6, seed=2))) == ""


def test_thicker_rods_are_named_with_their_ratio(own):
    figures = figures_of(own, rods(48, 16, 8, seed=2))
    assert figures["thickness"].is_off
    assert figures["thickness"].value == pytest.approx(8 / 6, abs=0.05)
    assert f"thickness {figures['thickness'].value:.2f} times" in off_line(figures)
    assert "pore size" in figures
    assert figures["two-point function"].is_distance


def test_a_ratio_is_off_beyond_three_spreads_and_a_twentieth():
    assert not Figure(1.04, 0.001).is_off
    assert Figure(1.06, 0.001).is_off
    assert Figure(0.94, 0.001).is_off
    assert not Figure(1.25, 0.1).is_off
    assert Figure(0.2, 0.05, is_distance=True).is_off
    assert not Figure(0.2, 0.1, is_distance=True).is_off
    assert Figure(1.21, 0.06).to_json() == {"ratio": 1.21, "spread": 0.06, "off": True}


def test_samples_of_more_voxels_spread_less(own):
    small = figures_of(own, rods(48, 12, 6, seed=2))["two-point function"].spread
    large = figures_of(OwnFigures.of(rods(48, 12, 6, seed=1), box=96), rods(96, 12, 6, seed=2))
    assert large["two-point function"].spread == pytest.approx(small * np.sqrt((1 + 1 / 8) / 2))


def test_what_is_too_small_or_holds_a_phase_here_and_there_only_is_not_measured(own):
    assert OwnFigures.of(rods(24, 12, 6), box=48) is None
    assert figures_of(own, rods(24, 12, 6)) == {}
    one_corner = rods(48, 12, 6).values.copy()
    one_corner[:8, :8, :8] = 2
    image = tb.Image(one_corner, "labels", phases=("void", "solid", "grain"))
    names = figures_of(OwnFigures.of(image, box=48), image)
    assert "thickness of solid" in names
    assert not any("grain" in name for name in names)


@pytest.mark.whole
def test_a_run_names_what_is_off_and_records_all():
    exemplar = rods(40, 10, 5, seed=3)
    heard = []
    with tb.progress(lambda label, fraction: heard.append(label)):
        made = tb.method("texture", preset="fast").fit(exemplar).generate(36, seed=0)
    figures = made.recipe.steps[-1]["report"]["figures"]
    assert {"thickness", "pore size", "surface"} <= figures.keys()
    off = [name for name, one in figures.items() if one["off"]]
    said = [line for line in heard if line.startswith("off beyond the exemplar's own spread")]
    assert len(said) == bool(off)
    assert all(name in said[0] for name in off)
    replayed = (
        tb.method("texture", preset="fast")
        .fit(exemplar)
        .generate(36, seed=0, target={"porosity": 0.7})
    )
    assert "figures" not in replayed.recipe.steps[-1].get("report", {})


@pytest.mark.whole
def test_rods_that_became_rows_of_balls_differ_in_shape():
    z, y, x = np.mgrid[:96, :96, :96] % 16 - 7.5
    rods = (y**2 + x**2 < 5**2).astype(np.uint8)
    balls = (z**2 + y**2 + x**2 < 7.5**2).astype(np.uint8)
    own = OwnFigures.of(tb.Image(rods, "labels"), box=96)
    same, other = (figures_of(own, tb.Image(one, "labels")) for one in (rods, balls))
    assert not same["shape index"].is_off and same["shape index"].is_distance
    assert other["shape index"].is_off
    assert "shape index off by" in off_line(other)


def test_a_shape_that_the_exemplar_does_not_have_is_not_held_against_a_result():
    values = np.zeros((48, 48, 48), np.uint8)
    values[:, ::24, ::2] = values[::24] = values[:, :, ::24] = 1
    values[3:-3, 3:-3, 3:-3] = 0  # interfaces at the faces alone
    image = tb.Image(values, "labels")
    own = OwnFigures.of(image, box=48)
    assert own is not None
    assert "shape index" not in figures_of(own, image)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("settings", "name", "told"),
    [
        ({}, "shape index", True),
        ({}, "shape index of binder", True),
        ({}, "thickness", False),
        ({"search": "leaves"}, "shape index", False),
        ({"layout": "structure"}, "shape index", False),
        ({"preset": "fast"}, "shape index", False),
    ],
)
def test_leaves_are_advised_for_shapes_that_sweeps_made(settings, name, told):
    model = tb.method("texture", **settings).fit(tb.crop(tb.sample("bone"), 32))
    off, right = Figure(0.3, 0.01, is_distance=True), Figure(0.01, 0.01, is_distance=True)
    assert ("search=leaves" in model._advice({name: off})) == told
    assert not model._advice({name: right})

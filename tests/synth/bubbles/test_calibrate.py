"""Settings found for an exemplar: the search on functions that are known, the distances, and
bubbles whose settings are.
"""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.synth.bubbles.calibrate import Scale, Search, halton_points
from trabecula.synth.bubbles.fit_objective import (
    FARTHEST,
    descriptors_of,
    distances,
    reduce_exemplar,
)

TWO = [Scale("a", -2.0, 2.0, 0.5), Scale("b", 0.0, 1.0, 0.25)]


def bowl(point):
    a, b = point
    return (a - 0.6) ** 2 + 4 * (b - 0.35) ** 2 + 0.5 * a * b


def test_the_search_finds_the_bottom_of_a_bowl_with_its_axes_aslant():
    """Known truth: 2 (a - 0.6) + b / 2 = 0 and 8 (b - 0.35) + a / 2 = 0."""
    b, a = np.linalg.solve([[0.5, 2], [8, 0.5]], [1.2, 2.8])
    search = Search(bowl, TWO, 80)
    search.run([(0.0, 0.0)], halvings=6)
    assert search.best(1)[0] == pytest.approx((a, b), abs=0.02)
    assert len(search.tried) <= 80


def test_the_search_stays_in_its_ranges_and_keeps_to_its_trials():
    search = Search(lambda point: -point[0] - point[1], TWO, 200)
    search.run([(-1.0, 0.1)])
    assert search.best(1)[0] == (2.0, 1.0)
    few = Search(bowl, TWO, 7)
    few.run([(0.0, 0.0), (1.0, 1.0)])
    assert len(few.tried) == 7
    assert few.tried[few.best(1)[0]] == min(few.tried.values())


def test_a_second_start_leaves_a_hollow_that_is_not_the_deepest():
    hollow = [Scale("a", -4.0, 4.0, 0.25)]

    def cost(point):
        return min((point[0] + 3) ** 2 + 0.5, (point[0] - 2.5) ** 2 * 5)

    search = Search(cost, hollow, 100)
    search.run([(-3.2,), (1.5,)])
    assert search.best(1)[0][0] == pytest.approx(2.5, abs=0.05)


def test_even_points_fill_the_ranges_that_are_near():
    points = np.array(halton_points(TWO, (0.0, 0.5), 64))
    assert (
        points[:, 0].min() >= -2
        and points[:, 0].max() <= 2
        and points[:, 1].min() >= 0
        and points[:, 1].max() <= 1
    )
    for axis, (low, high) in enumerate([(-2, 2), (0, 1)]):
        counts, _ = np.histogram(points[:, axis], bins=4, range=(low, high))
        assert counts.min() >= 13
    assert np.abs(np.array(halton_points(TWO, (2.0, 0.0), 20))[:, 0] - 2).max() <= 4 * TWO[0].step


def balls(radius, *, period=16, side=48):
    """Return void balls on a cubic lattice in solid."""
    z, y, x = np.ogrid[:side, :side, :side]
    far = sum(((axis % period) - (period - 1) / 2) ** 2 for axis in (z, y, x))
    return tb.Image((far > radius**2).astype(np.uint8), "labels")


def test_distances_are_none_to_itself_and_tell_what_differs():
    six = descriptors_of(balls(6))
    assert set(distances(six, six).values()) == {0.0}
    larger = distances(descriptors_of(balls(7)), six)
    assert larger["pore_size"] == pytest.approx(1 / 6, abs=0.1) and larger["porosity"] > 0.3
    flat = tb.Image(np.repeat(balls(6).values[::2], 2, axis=0)[:48], "labels")
    stretched = np.repeat(balls(6).values, 2, axis=0)[:48]
    assert (
        distances(descriptors_of(tb.Image(stretched, "labels")), six)["anisotropy"]
        > 3 * distances(descriptors_of(flat), six)["anisotropy"]
    )
    assert (
        distances(descriptors_of(tb.Image(np.zeros((20, 20, 20), np.uint8), "labels")), six)[
            "pore_size"
        ]
        == FARTHEST
    )


@pytest.mark.whole
def test_an_exemplar_is_made_coarser_and_cut_no_further_than_needed():
    fine = np.kron(balls(6, side=64).values, np.ones((3, 3, 3), np.uint8))
    # 36 voxels across, of which their discs tell a little less
    seen = reduce_exemplar(tb.Image(fine, "labels", 2.0, "um"))
    assert (
        seen.image.spacing == (4.0,) * 3
        and seen.image.unit == "um"
        and seen.image.shape == (72, 72, 72)
    )
    # Balls on a lattice grow and shrink all at once: a measure of the middle comes no nearer.
    assert seen.measured.porosity == pytest.approx(np.mean(fine == 0), abs=0.025)
    named = reduce_exemplar(tb.Image(1 - balls(6).values, "labels", 1.0, "um", ("rock", "void")))
    assert np.array_equal(named.image.values, balls(6).values)


def exemplar(side=40, **settings):
    plain = {
        "distance": 12.0,
        "spread": 0.3,
        "thickness": 0.15,
        "regularity": 0.8,
        "porosity": 0.55,
    }
    return (
        tb.method("bubbles", **{**plain, **settings})
        .fit(spacing=0.5, unit="mm")
        .generate(side, seed=9)
    )


@pytest.fixture(scope="module")
def own():
    """Return a foam of known settings, and the model found for it."""
    known = exemplar()
    return known, tb.method("bubbles", trials=20).fit(known)


@pytest.mark.whole
def test_a_foams_own_settings_are_nearly_found(own):
    known, model = own
    report = model.report
    assert json.loads(json.dumps(report)) == report
    assert report["end"]["total"] < 0.75 * report["start"]["total"]
    assert np.mean([check["total"] for check in report["checks"]]) < report["start"]["total"]
    assert len(report["trace"]) == 20 and np.all(np.diff(report["trace"]) <= 0)
    assert (model.found.density * 6.0**3) ** (-1 / 3) == pytest.approx(1, rel=0.3), (
        "12 voxels of 0.5 mm"
    )
    made = model.generate(64, seed=3)
    assert made.spacing == (0.5,) * 3 and made.unit == "mm"
    assert tb.measure.porosity(made) == pytest.approx(tb.measure.porosity(known), abs=0.02)
    assert tb.measure.pore_size(made) == pytest.approx(tb.measure.pore_size(known), rel=0.2)


@pytest.mark.whole
def test_the_recipe_keeps_the_users_settings_and_tells_what_was_found(own):
    _, model = own
    step = model.generate(16, seed=1).recipe.steps[-1]
    assert step["settings"]["density"] is None and step["settings"]["trials"] == 20
    assert step["report"]["fit"]["found"]["density"] == model.found.density


@pytest.mark.whole
def test_the_same_exemplar_gives_the_same_settings_for_any_number_of_threads():
    known = exemplar(32)
    one = tb.method("bubbles", trials=6).fit(known)
    with tb.threads(3):
        again = tb.method("bubbles", trials=6).fit(known)
    assert one.found == again.found and one.report == again.report


@pytest.mark.whole
def test_what_was_given_is_kept():
    known = exemplar(32)
    model = tb.method("bubbles", trials=6, spread=0.1, density=0.004, coalescence=0.25).fit(known)
    assert (model.found.spread, model.found.density, model.found.coalescence) == (0.1, 0.004, 0.25)
    assert "thickness" in model.report["found"]
    plain = tb.method("bubbles", trials=0).fit(known)
    assert plain.found == plain.config and not plain.report
    assert plain.generate(20, seed=1).spacing == (0.5,) * 3


@pytest.mark.whole
def test_a_direction_is_found_where_there_is_one():
    long = exemplar(flow="0, 1, 0", randomness=0.5)  # x', y', z': along y
    model = tb.method("bubbles", trials=3).fit(long)
    x, y, z = (float(part) for part in model.found.flow.split(","))
    assert y > 0.9 and max(abs(x), abs(z)) < 0.4
    assert 0.3 < model.found.randomness < 0.9
    assert tb.method("bubbles", trials=1).fit(exemplar()).found.flow == "none"


@pytest.mark.whole
def test_a_picture_teaches_pictures():
    picture = tb.method("bubbles", distance=14, porosity=0.6).fit().generate((150, 160), seed=2)
    model = tb.method("bubbles", trials=8).fit(picture)
    made = model.generate((90, 100), seed=1)
    assert made.shape == (90, 100)
    assert model.report["end"]["total"] < 1.1 * model.report["start"]["total"] < 1
    assert tb.measure.porosity(made) == pytest.approx(tb.measure.porosity(picture), abs=0.02)


def test_an_exemplar_with_bubbles_at_its_rim_alone_is_refused():
    rim = np.ones((120, 80, 80), np.uint8)
    rim[:6] = 0
    with pytest.raises(InputError, match="bubbles all over"):
        tb.method("bubbles").fit(rim)


@pytest.mark.whole
def test_a_file_tells_what_was_found(tmp_path, monkeypatch):
    """Load without a search."""
    model = tb.method("bubbles", trials=4).fit(tb.crop(tb.sample("bone"), 24))
    model.save(tmp_path / "bone.model")
    monkeypatch.setattr("trabecula.synth.bubbles.method.calibrate", None)
    again = tb.load_model(tmp_path / "bone.model")
    assert (again.found, again.report, again.sha256) == (model.found, model.report, model.sha256)
    assert again.found != again.config
    assert np.array_equal(again.generate(20, seed=3).values, model.generate(20, seed=3).values)

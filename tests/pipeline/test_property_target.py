"""Material that has a property."""

import json
from dataclasses import replace

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.core.request import Request
from trabecula.errors import InputError, RequestError, UnknownNameError
from trabecula.measure.properties import PROPERTIES, measure_property
from trabecula.pipeline import property_target
from trabecula.pipeline.property_target import MOST, _crossing, _Goal, _next, match_property


@pytest.fixture(scope="module")
def model():
    return tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 48))


@pytest.mark.whole
def test_the_result_has_what_was_asked_for_and_its_recipe_makes_it_again(model, tmp_path):
    usual = measure_property(model.exemplars[0], "specific_surface")
    found = match_property(model, 48, {"specific_surface": 1.15 * usual}, seed=3)
    assert found.met and abs(found.error) <= 0.02 and not found.moved
    assert measure_property(found.image, "specific_surface") == found.value
    assert found.value == pytest.approx(1.15 * usual, rel=0.02)
    report = found.image.recipe.steps[-1]["report"]["property"]
    assert report["asked"] == 1.15 * usual and report["value"] == found.value
    assert np.array_equal(model.generate(found.request).values, found.image.values)
    path = tmp_path / "x.tif"
    tb.write(found.image, path)
    assert tb.read(path).recipe == found.image.recipe


@pytest.mark.whole
def test_what_the_material_cannot_have_is_refused_with_the_range(model):
    with pytest.raises(
        RequestError, match=r"pore_size 3 um is outside .* have \d+\S* \.\. \d+"
    ) as it:
        match_property(model, 48, {"pore_size": 3.0})
    assert "\n" not in str(it.value)


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [
        ({}, InputError, "no property"),
        ({"permeability": 1.0, "stiffness": 0.1}, InputError, "one property can be met"),
        ({"permeabilty": 1.0}, UnknownNameError, "did you mean 'permeability'"),
        ({"permeability:w": 1.0}, UnknownNameError, "known are x, y, z"),
        ({"pore_size:z": 1.0}, InputError, "no direction"),
        ({"permeability": 0.0}, InputError, "more than 0"),
        ({"permeability": "many"}, InputError, "should be a number"),
    ],
)
def test_what_is_no_property_is_refused(model, asked, error, words):
    with pytest.raises(error, match=words):
        match_property(model, 48, asked)


@pytest.mark.whole
def test_requests_and_methods_that_cannot_are_refused(model, monkeypatch):
    with pytest.raises(RequestError, match="a property beside target"):
        match_property(model, Request(48, target={"porosity": 0.8}), {"pore_size": 600.0})
    with pytest.raises(RequestError, match="one of a volume"):
        match_property(tb.method("lattice").fit(), (48, 48), {"pore_size": 600.0})
    noise = tb.method("noise").fit()
    monkeypatch.setattr(noise, "capabilities", replace(noise.capabilities, targets=("size",)))
    with pytest.raises(RequestError, match="takes no target porosity"):
        match_property(noise, 48, {"pore_size": 6.0})
    three = np.random.default_rng(0).integers(0, 3, (40, 40, 40)).astype(np.uint8)
    many = tb.method("texture", preset="fast").fit(tb.Image(three, "labels"))
    with pytest.raises(RequestError, match="two phases of which one is void"):
        match_property(many, 40, {"pore_size": 6.0})


def next_of(trials, made, asked, scatter=3e-3):
    return _next(_Goal("diffusivity", asked, 0.02, tuple(trials)), made, scatter=scatter)


def test_the_next_porosity_lies_where_results_bound_it():
    trials = [(0.2, 1.0), (0.5, 10.0), (0.8, 100.0)]
    assert _crossing(trials, 10.0, near=0.5) == pytest.approx(0.5)
    assert _crossing(trials, 31.6227766, near=0.5) == pytest.approx(0.65)
    assert _crossing(trials, 200.0, near=0.5) is None
    # one result twice as large as the map says: the map at its level
    assert next_of(trials, [(0.5, 20.0)], 10.0) == pytest.approx(0.5 - 0.3 * np.log10(2))
    # results on both sides rule, but for those that differ by chance
    assert 0.4 < next_of(trials, [(0.5, 20.0), (0.4, 8.0)], 10.0) < 0.5
    near = [(0.5, 12.0), (0.502, 9.0)]
    assert 0.5 < next_of(trials, near, 10.0, scatter=0) < 0.502 < next_of(trials, near, 10.0)
    # the nearest names one that was made already, and had less: it goes on from that
    made = [(0.5, 9.0), (0.5 + 0.3 * np.log10(10 / 9), 8.0)]
    assert next_of(trials, made, 10.0) == pytest.approx(made[1][0] + 0.3 * np.log10(10 / 8))
    # of two crossings the nearer one
    hump = [(0.1, 1.0), (0.5, 9.0), (0.9, 1.0)]
    assert _crossing(hump, 3.0, near=0.8) == pytest.approx(0.7)
    # nothing spans the sparse end
    assert _crossing([(0.2, 0.0), (0.5, 1.0), (0.8, 4.0)], 2.0, near=0.0) == pytest.approx(0.65)


@pytest.mark.whole
def test_where_results_scatter_the_surface_of_the_nearest_is_moved(model, monkeypatch, tmp_path):
    make, seeds = type(model).generate, iter(range(20, 40))

    def scattered(self, request, **more):
        chance = replace(request, seed=next(seeds) if "porosity" in request.target else None)
        return make(self, chance, **more)

    usual = measure_property(model.exemplars[0], "diffusivity:z")
    monkeypatch.setattr(type(model), "generate", scattered)
    found = match_property(model, 32, {"diffusivity:z": 0.9 * usual}, within=0.002, seed=1)
    assert len(found.made) == MOST and found.moved and found.met
    assert all(abs(value / found.asked - 1) > 0.002 for _, value in found.made)
    void = found.image.values == found.image.phases.index("void")
    assert void.mean() == pytest.approx(found.porosity, abs=1 / void.size)
    assert (found.porosity, found.value) == found.moved[-1]
    base = min(found.made, key=lambda one: abs(one[1] - found.asked))
    assert found.request.target["porosity"] == base[0]
    assert 1e-4 <= abs(found.porosity - base[0]) <= 0.03
    assert measure_property(found.image, "diffusivity:z") == found.value
    step = found.image.recipe.steps[-1]
    assert step["operation"] == "offset" and step["settings"]["fraction"] == 1 - found.porosity
    assert step["report"]["property"]["moved"] == [list(one) for one in found.moved]


@pytest.mark.whole
def test_a_surface_moves_by_little(model, monkeypatch):
    usual = measure_property(model.exemplars[0], "specific_surface")
    monkeypatch.setattr(property_target, "MOST", 1)
    monkeypatch.setattr(property_target, "_first", lambda *given: 0.72)
    found = match_property(model, 32, {"specific_surface": 0.8 * usual}, seed=1)
    assert not found.met and "NOT within" in str(found)
    assert found.moved == ((0.75, found.value),) and found.made[0][0] == 0.72


@pytest.mark.slow
def test_properties_are_those_of_the_descriptors():
    image = tb.crop(tb.sample("bone"), 24)
    found = tb.describe(image, level="full")
    for name in ("diffusivity", "permeability", "conductivity"):
        assert measure_property(image, f"{name}:y") == pytest.approx(found[name]["y"], rel=5e-3)
        mean = np.mean(list(found[name].values()))
        assert measure_property(image, name) == pytest.approx(mean, rel=5e-3)
    moduli = found["stiffness"]["moduli"]
    assert measure_property(image, "stiffness:z") == pytest.approx(moduli["z"], rel=5e-3)
    for name in ("specific_surface", "pore_size", "thickness"):
        assert measure_property(image, name) == found[name]
    assert {name: PROPERTIES[name].power for name in ("permeability", "specific_surface")} == {
        "permeability": 2,
        "specific_surface": -1,
    }


@pytest.mark.whole
def test_the_command_line(tmp_path):
    out = tmp_path / "x.tif"
    words = ["generate", "sample:bone", "--crop", "48", "--method", "texture", "--preset", "fast"]
    words += ["--shape", "40", "--out", str(out)]
    done = trabecula(*words, "--target", "pore_size=600", "--json")
    report = json.loads(done.out)["recipe"][-1]["report"]["property"]
    assert report["name"] == "pore_size" and abs(report["value"] / 600 - 1) <= 0.02
    assert any(line.startswith("trabecula: pore_size") and "off 600" in line for line in done.lines)
    assert tb.measure.pore_size(tb.read(out)) == report["value"]
    for more, said in (
        (["--chunks", "32"], "made and measured in memory"),
        (["--count", "3"], "with --count"),
        (["--target", "stiffness=0.1"], "one property"),
    ):
        place = str(tmp_path / ("{seed}.zarr" if more[0] == "--count" else "y.zarr"))
        text = refused(*words[:-1], place, "--target", "pore_size=600", *more)
        assert said in text

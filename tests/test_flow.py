"""The sentence as functions: load, load_like, export, demo, replay."""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.cli import demo
from trabecula.core.recipe import Recipe, digest
from trabecula.errors import FileError, InputError, NotReproducedError, UnknownNameError
from trabecula.pipeline import inputs, outputs, replay

SETTINGS = {"neighbourhood": 4, "first_rounds": 2, "rounds": (1,)}


@pytest.fixture
def place(tmp_path, monkeypatch, bone):
    """Make a working folder with a small scan, and a sample that costs nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(inputs, "sample", lambda name: bone)
    np.save("scan.npy", tb.crop(bone, 24).values)
    np.save("grey.npy", tb.crop(bone, 24).values * np.uint8(90) + np.arange(24, dtype=np.uint8))
    return tmp_path


@pytest.mark.whole
def test_the_sentence(place):
    exemplar = tb.read("scan.npy", spacing=19.5, unit="um")
    material = tb.method("texture", **SETTINGS).fit(exemplar).generate((24, 20, 22), seed=7)
    part = tb.finish.connect(material)
    verdict = tb.verify(exemplar, part)
    tb.write(part, "femur.zarr")
    assert tb.export(part, "femur.stl").stat().st_size > 84
    assert verdict.metrics["floating"].value == 0 and verdict.metrics["components"].value == 1
    assert part.shape == (24, 20, 22) and part.spacing == (19.5,) * 3 and part.unit == "um"
    np.testing.assert_array_equal(tb.rerun("femur.zarr").values, part.values)


def test_load_crops_and_segments(place, bone):
    image = tb.load(
        "grey.npy",
        crop=(10, 12, 14),
        threshold="auto",
        spacing=2,
        unit="mm",
        phases=("void", "bone"),
    )
    assert (
        image.shape == (10, 12, 14) and image.kind == "labels" and image.phases == ("void", "bone")
    )
    assert image.spacing == (2.0,) * 3 and image.unit == "mm"
    assert [step["verb"] for step in image.recipe.steps] == ["read", "segment", "crop"]
    np.testing.assert_array_equal(
        image.values, tb.crop(tb.segment(tb.read("grey.npy")), (10, 12, 14)).values
    )
    assert tb.load("grey.npy").kind == "grey"
    np.testing.assert_array_equal(tb.load("sample:bone", crop=20).values, tb.crop(bone, 20).values)
    assert tb.load("scan.npy", threshold="auto", phases=("marrow", "bone")).phases == (
        "marrow",
        "bone",
    )


def test_load_refuses_what_has_no_meaning(place):
    with pytest.raises(InputError, match=r"scan\.npy holds labels, a threshold is for grey images"):
        tb.load("scan.npy", threshold=1)
    with pytest.raises(InputError, match="sample:bone comes with its spacing, unit and phases"):
        tb.load("sample:bone", unit="mm")
    with pytest.raises(UnknownNameError, match="unknown kind"):
        tb.load("scan.npy", kind="volume")


def test_what_states_nothing_takes_the_exemplars_meaning(place, bone):
    exemplar = tb.Image(np.load("scan.npy"), "labels", 40, "um", ("marrow", "bone"))
    plain = inputs.load_like("scan.npy", exemplar)
    assert (plain.spacing, plain.unit, plain.phases) == ((40.0,) * 3, "um", ("marrow", "bone"))
    tb.write(tb.Image(plain.values, "labels", 2, "mm", ("pore", "bone")), "own.zarr")
    own = inputs.load_like("own.zarr", exemplar)
    assert (own.spacing, own.unit, own.phases) == ((2.0,) * 3, "mm", ("pore", "bone"))
    assert inputs.load_like("grey.npy", exemplar).kind == "labels"


def test_export_chooses_by_the_suffix(place):
    values = np.load("scan.npy")
    assert tb.export(values, "part.ply").read_bytes().startswith(b"ply")
    np.testing.assert_array_equal(tb.read(tb.export(values, "part.nrrd")).values, values)
    with pytest.raises(UnknownNameError, match=r"unknown format '\.slt': did you mean '\.stl'"):
        tb.export(values, "part.slt")
    assert not (place / "part.slt").exists()


def test_targets(place):
    for good in ("x.zarr", "deep/er/x.npy", "x.nii.gz", "slices/", "./x.TIF"):
        outputs.check_target(good)
    outputs.check_target("x.stl", surfaces=True)
    for bad in ("x.stl", "x", "x.gz", "x.zarr.txt"):
        with pytest.raises(UnknownNameError):
            outputs.check_target(bad)
    with pytest.raises(FileError, match=r"about 1048576 MiB are needed, \d+ MiB are free"):
        outputs.check_target("x.npy", size=1 << 40)
    assert not (place / "deep").exists()


@pytest.mark.whole
def test_demo_leaves_what_it_says(place, monkeypatch, bone):
    small = tb.crop(bone, 28)
    method = tb.method
    monkeypatch.setattr("trabecula.exemplar.samples.sample", lambda name: small)
    monkeypatch.setattr(
        "trabecula.synth.api.registry.method", lambda name: method(name, **SETTINGS)
    )
    verdict = demo.demo("out", shape=24)
    names = {path.name for path in (place / "out").iterdir()}
    assert names == {
        "exemplar.zarr",
        "bone.zarr",
        "part.zarr",
        "part.3mf",
        "part.png",
        "slices.png",
        "report.html",
    }
    part = tb.read("out/part.zarr")
    assert part.shape == (24, 24, 24) and verdict.metrics["components"].value == 1
    assert verdict.metrics["porosity"].value == pytest.approx((part.values == 0).mean())
    assert "part.zarr" in (place / "out" / "report.html").read_text(encoding="utf-8")
    assert set(demo._WHAT) == names


def full_recipe(place):
    """Make a recipe with every verb in it, as JSON."""
    exemplar = tb.load("grey.npy", crop=22, threshold="auto")
    material = tb.method("texture", **SETTINGS).fit(exemplar).generate(16, seed=1)
    part = tb.finish.connect(material)
    return json.loads(json.dumps(tb.render(part, size=(32, 24)).recipe.to_json()))


@pytest.mark.whole
def test_replay_does_every_step(place):
    recipe = Recipe.from_json(full_recipe(place))
    assert [step["verb"] for step in recipe.steps] == ["generate", "finish", "render"]
    assert [step["verb"] for step in recipe.steps[0]["exemplars"][0]] == ["read", "segment", "crop"]
    assert digest(replay.replay(recipe, folder=place).values) == recipe.steps[-1]["sha256"]


@pytest.mark.whole
def test_every_step_is_compared(place):
    for change in (
        lambda steps: steps[0],
        lambda steps: steps[1],
        lambda steps: steps[0]["exemplars"][0][1],
    ):
        steps = full_recipe(place)
        change(steps)["sha256"] = "0" * 64
        with pytest.raises(NotReproducedError, match=f"step '{change(steps)['verb']}'"):
            replay.replay(Recipe.from_json(steps), folder=place)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda steps: steps.clear(), "the recipe is empty"),
        (lambda steps: steps.pop(0), "needs an image that no step made"),
        (
            lambda steps: steps[0].update(verb="generat"),
            "unknown step of a recipe 'generat': did you mean 'generate'",
        ),
        (lambda steps: steps[0].update(verb=["generate"]), "unknown step of a recipe"),
        (lambda steps: steps[0].pop("sha256"), "the recipe is damaged: its step 'generate'"),
        (lambda steps: steps[0].pop("exemplars"), "the recipe is damaged: its step 'generate'"),
        (lambda steps: steps[0].update(exemplars=[]), "no exemplar was given"),
        (
            lambda steps: steps[0].update(exemplars=[3]),
            "the recipe is damaged: it should be a list of steps",
        ),
        (lambda steps: steps[0].update(method="textrue"), "did you mean 'texture'"),
        (lambda steps: steps[0]["settings"].update(wings=2), "unknown setting of texture 'wings'"),
        (
            lambda steps: steps[0]["request"].update(wings=2),
            "the recipe is damaged, or .*: its step 'generate'.*wings",
        ),
        (lambda steps: steps[0]["request"].update(shape="x"), "shape 'x' is not made of integers"),
        (lambda steps: steps[0]["request"].update(shape=10**30), "more than 2"),
        (
            lambda steps: steps[1].update(operation="conect"),
            "the recipe is damaged: its step 'finish'",
        ),
        (
            lambda steps: steps[1].update(settings=None),
            "the recipe is damaged, or .*: its step 'finish'",
        ),
        (lambda steps: steps[2].pop("look"), "the recipe is damaged: its step 'render'"),
    ],
)
def test_damaged_recipes_are_told(place, damage, says):
    steps = full_recipe(place)
    damage(steps)
    with pytest.raises((InputError, NotReproducedError), match=says):
        replay.replay(Recipe.from_json(steps), folder=place)


@pytest.mark.whole
def test_a_missing_exemplar_is_told(place):
    steps = full_recipe(place)
    (place / "grey.npy").unlink()
    with pytest.raises(
        FileError,
        match=r"the recipe starts from grey\.npy, which is not here: give its place with --exempl",
    ):
        replay.replay(Recipe.from_json(steps), folder=place)
    with pytest.raises(FileError, match=r"there is no file grye\.npy"):
        replay.replay(Recipe.from_json(steps), folder=place, exemplar="grye.npy")


@pytest.mark.whole
def test_a_target_field_is_found_again(tmp_path, monkeypatch):
    """Find a field by its recipe, which stands in that of the result."""

    class Method:
        def fit(self, exemplar):
            return self

        def generate(self, request):
            return tb.Image(request.target["porosity"] > 0.5, "labels")

    monkeypatch.setattr(
        "trabecula.pipeline.replay.recorded_method", lambda name, settings: Method()
    )
    np.save(tmp_path / "field.npy", np.linspace(0, 1, 27).reshape(3, 3, 3))
    field, exemplar = tb.read(tmp_path / "field.npy"), tb.sample("foam")
    values = (field.values > 0.5).astype(np.uint8)
    step = {"method": "any", "settings": {}, "exemplars": [exemplar.recipe.to_json()]}
    request = tb.Request(3, target={"porosity": field})
    recipe = tb.Recipe().then("generate", values, request=request.to_json(), **step)
    assert np.array_equal(replay.replay(recipe, folder=tmp_path).values, values)
    (tmp_path / "field.npy").rename(tmp_path / "moved.npy")
    with pytest.raises(FileError, match="--target"):
        replay.replay(recipe, folder=tmp_path)
    again = replay.replay(recipe, folder=tmp_path, target=tmp_path / "moved.npy")
    assert np.array_equal(again.values, values)

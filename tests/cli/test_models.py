"""Learn once, make often: fit, --model, models, and volumes that are made block by block."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import attempt, refused, trabecula
from trabecula import models
from trabecula.core.recipe import digest
from trabecula.engine import store
from trabecula.engine.parallel import thread_count
from trabecula.errors import InputError, NotReproducedError
from trabecula.pipeline.replay import model_and_request

REACH = ("--set", "reach=10", "--set", "corrections=2")


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Make a folder with a scan, a model of it, and what was printed when it learned."""
    folder = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        np.save("scan.npy", tb.crop(tb.sample("bone"), 24).values)
        printed = trabecula(
            "fit",
            "scan.npy",
            "--spacing",
            20,
            "--unit",
            "um",
            "--method",
            "noise",
            "--out",
            "b.model",
            *REACH,
        )
    assert (
        "b.model: a model of noise" in printed.out
        and printed.sha256 == tb.load_model(folder / "b.model").sha256
    )
    return folder


@pytest.fixture
def place(home, monkeypatch):
    monkeypatch.chdir(home)
    return home


def test_a_model_makes_what_its_method_makes(place):
    source = ("scan.npy", "--spacing", 20, "--unit", "um", "--method", "noise", *REACH)
    with_model = trabecula(
        "generate", "--model", "b.model", "--shape", 30, "--seed", 2, "--out", "m.npy"
    )
    at_once = trabecula("generate", *source, "--shape", 30, "--seed", 2, "--out", "o.npy")
    assert with_model.sha256 == at_once.sha256
    one, two = tb.read("m.npy"), tb.read("o.npy")
    assert (
        one.recipe.to_json() == two.recipe.to_json()
        and one.spacing == (20,) * 3
        and one.unit == "um"
    )
    assert trabecula("rerun", "m.npy").sha256 == with_model.sha256


def test_another_model_of_the_same_name_is_noticed(place):
    step = {"verb": "generate", "model": {"name": "b.model", "sha256": "0" * 64}}
    with pytest.raises(NotReproducedError, match=r"b\.model is another"):
        model_and_request(step, folder=place)


@pytest.mark.parametrize(
    ("words", "inner"),
    [
        (("generate", "scan.npy", "--shape", 9, "--out", "x.npy"), "generate._generate"),
        (("fit", "scan.npy", "--method", "noise", "--out", "y.model"), "fit.shared.load_exemplar"),
        (("plan", "scan.npy", "--method", "noise", "--shape", 9), "plan.GenerateTask.fit"),
    ],
)
def test_the_threads_that_were_given_are_used(place, monkeypatch, words, inner):
    used = []

    def note(*_, **__):
        used.append(thread_count())
        raise InputError("enough")

    monkeypatch.setattr(f"trabecula.cli.{inner}", note)
    assert refused(*words, "--threads", 3) == "enough" and used == [3]


def test_a_form_takes_the_voxels_of_the_model(place):
    refused_line = refused(
        "generate", "--model", "b.model", "--shape", 30, "--mask", "scan.npy", "--out", "x.npy"
    )
    assert "cannot honour mask" in refused_line or "mask has shape" in refused_line
    assert "cannot honour fixed" in refused(
        "generate",
        "--model",
        "b.model",
        "--shape",
        30,
        "--fixed",
        "scan.npy",
        "--at",
        0,
        0,
        0,
        "--out",
        "x.npy",
    )


def test_plan_of_a_model_has_no_learning(place):
    plan = json.loads(trabecula("plan", "--model", "b.model", "--shape", 60, "--json").out)
    assert plan["learning"]["peak"] == 0 and plan["peak"] == sum(plan["memory"].values()) > 0
    method = json.loads(
        trabecula("plan", "scan.npy", "--method", "noise", *REACH, "--shape", 60, "--json").out
    )
    assert method["learning"]["peak"] > 0 and method["memory"] == plan["memory"]


@pytest.mark.whole
def test_over_the_budget_it_is_made_in_blocks_and_goes_on_after_an_interruption(place, monkeypatch):
    asked = (
        "generate",
        "--model",
        "b.model",
        "--shape",
        150,
        140,
        180,
        "--seed",
        3,
        "--threads",
        1,
    )
    budget = ("--memory", 0.25)
    whole = trabecula(*asked, "--out", "whole.npy")
    assert "write a .zarr, which is made block by block" in refused(
        *asked, "--out", "big.npy", *budget
    )
    plan = [
        json.loads(trabecula("plan", *asked[1:], "--json", *words).out)["peak"]
        for words in ((), ("--out", "b.zarr"), ("--out", "b.zarr", *budget))
    ]
    assert plan[0] == plan[1] > 0.25 * 2**30 > plan[2]
    real, count = store.slices_of, []

    def interrupted(box):
        count.append(box)
        if len(count) == 4:
            raise KeyboardInterrupt
        return real(box)

    monkeypatch.setattr(store, "slices_of", interrupted)
    stopped = attempt(*asked, "--out", "big.zarr", *budget)
    assert stopped.status == 130 and "the same run resumes from big.zarr.part" in stopped.err
    monkeypatch.setattr(store, "slices_of", real)
    assert "did not finish" in refused("measure", "big.zarr.part")
    done = trabecula(*asked, "--out", "big.zarr", *budget)
    assert "resuming from big.zarr.part" in done.err and done.sha256 == whole.sha256
    image = tb.read("big.zarr")
    assert digest(image.values) == done.sha256 and repr(image) in done.out
    assert image.recipe.to_json() == tb.read("whole.npy").recipe.to_json()
    assert trabecula("rerun", "big.zarr").sha256 == done.sha256
    assert not (place / "big.zarr.part").exists()


def test_a_block_that_does_not_fit_is_refused(place):
    asked = (
        "generate",
        "--model",
        "b.model",
        "--shape",
        150,
        "--out",
        "small.zarr",
        "--memory",
        0.05,
    )
    assert "a block of 128 voxels needs about" in refused(*asked)
    assert not (place / "small.zarr.part").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--shape", 9), "no exemplar was given"),
        (("scan.npy", "--model", "b.model", "--shape", 9), "an exemplar beside --model"),
        (("--model", "b.model", "--method", "noise", "--shape", 9), "--method beside --model"),
        (("--model", "b.model", "--set", "reach=9", "--shape", 9), "--set beside --model"),
        (("--model", "b.model", "--crop", 9, "--shape", 9), "--crop beside --model"),
        (("--model", "b.model"), "add --shape"),
        (("--model", "c.model", "--shape", 9), "did you mean b.model"),
        (("--model", "telepathy", "--shape", 9), "unknown model"),
        (("--model", "scan.npy", "--shape", 9), "cannot read scan.npy as a model"),
    ],
)
def test_what_cannot_be_made_with_a_model_is_said(place, words, says):
    assert says in refused("generate", *words, "--out", "x.npy")
    assert not (place / "x.npy").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("--method", "noise", "--minutes", 3),
            "--minutes 3.0: method 'noise' has no such setting",
        ),
        (("--method", "nose"), "did you mean 'noise'"),
        (("--method", "noise", "--set", "reach=1"), "reach"),
        (("--method", "noise", "--crop", 4), "one phase only"),
        (("--method", "gan", "--minutes", 1, "--set", "minutes=2"), "give one of them"),
    ],
)
def test_what_cannot_be_learned_is_said(place, words, says):
    assert says in refused("fit", "scan.npy", *words, "--out", "y.model")
    assert not (place / "y.model").exists()


def test_a_place_that_cannot_be_written_is_refused_before_learning(place, monkeypatch):
    monkeypatch.setattr("trabecula.synth.noise.method.Noise.learn", None)
    assert "is a file, not a folder" in refused(
        "fit", "scan.npy", "--method", "noise", "--out", "scan.npy/x.model"
    )
    (place / "taken").mkdir(exist_ok=True)
    assert "a folder of that name" in refused(
        "fit", "scan.npy", "--method", "noise", "--out", "taken"
    )


def test_the_list_of_models(place, tmp_path, monkeypatch):
    monkeypatch.setattr(models, "_HERE", tmp_path)
    assert "no model comes with this package" in trabecula("models").out
    (tmp_path / "marrow.safetensors").write_bytes((place / "b.model").read_bytes())
    (tmp_path / "marrow.md").write_text("# marrow\n\nBone of a test.\n")
    assert trabecula("models").out.split() == ["marrow", "Bone", "of", "a", "test."]
    assert json.loads(trabecula("models", "--json").out)["marrow"]["summary"] == "Bone of a test."
    assert trabecula("models", "marrow").out == "# marrow\n\nBone of a test.\n"
    assert "did you mean 'marrow'" in refused("models", "marow")
    by_name = trabecula(
        "generate", "--model", "marrow", "--shape", 12, "--seed", 1, "--out", "n.npy"
    )
    assert (
        by_name.sha256
        == trabecula(
            "generate", "--model", "b.model", "--shape", 12, "--seed", 1, "--out", "f.npy"
        ).sha256
    )

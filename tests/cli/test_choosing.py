"""`inspect` on the command line, and the method that generate, plan and fit choose by it."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, attempt, refused, trabecula
from trabecula.cli.main import VERBS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inspect")
    values = tb.sample("foam").values
    tb.write(tb.Image(values[:40, :40, :40].copy(), "labels", 25.0, "um"), folder / "scan.tif")
    tb.write(tb.Image(values[40], "labels"), folder / "picture.png")
    tb.write(
        tb.Image(np.repeat(values[40][..., None] * np.uint8(200), 3, -1), "colour"),
        folder / "colour.png",
    )
    tb.write(tb.Image(np.pad(values[:40, :40, :40], 1), "labels"), folder / "padded.zarr")
    tb.write(tb.Image(values[:6, :40, :40].copy(), "labels"), folder / "thin.tif")
    layers = np.broadcast_to((np.arange(64) % 8 < 3)[:, None, None], (64,) * 3).astype(np.uint8)
    tb.write(tb.Image(layers.copy(), "labels"), folder / "layers.tif")
    return folder


@pytest.fixture(autouse=True)
def there(folder, monkeypatch):
    monkeypatch.chdir(folder)


BY_PROCESS = "trabecula: method kopf --set process=auto"


def choice(output) -> list[str]:
    return [line.split("(")[0].strip() for line in output.lines if "(recommended: " in line]


def method_of(path) -> dict:
    (step,) = tb.read(path).recipe.steps
    return step


@pytest.mark.whole
def test_the_words_and_the_figures():
    assert "inspect" in VERBS
    found = json.loads(trabecula("inspect", "scan.tif", "--json").out)
    assert found["shape"] == [40, 40, 40] and found["recommendation"]["method"] == "texture"
    assert found["origin"]["spacing"] == "metadata of this package"
    text = trabecula("inspect", "scan.tif").out
    assert len(text.splitlines()) <= 40
    for word in (
        "scan",
        "phases",
        "spacing",
        "margins",
        "correlated",
        "components",
        "recommended",
        "decidable",
    ):
        assert any(line.startswith(word) for line in text.splitlines()), word
    assert "25 um (the sample)" in trabecula("inspect", "sample:foam").out


@pytest.mark.whole
def test_how_it_is_read():
    found = json.loads(
        trabecula("inspect", "picture.png", "--spacing", 2, "--unit", "um", "--json").out
    )
    assert found["spacing"] == [2.0, 2.0] and found["origin"]["spacing"] == "given"
    assert "(given)" in trabecula("inspect", "picture.png", "--spacing", 2, "--unit", "um").out
    assert "100 x 100" not in trabecula("inspect", "colour.png", "--crop", 64).out
    assert (
        json.loads(trabecula("inspect", "padded.zarr", "--crop", "auto", "--json").out)["shape"]
        == [40] * 3
    )
    assert (
        json.loads(trabecula("inspect", "padded.zarr", "--json").out)["margins"]["size"] == [40] * 3
    )
    assert "which is not here" not in refused("inspect", "missing.tif")


def test_a_store_that_does_not_fit_is_inspected_in_its_middle(monkeypatch):
    from trabecula.report import inspection

    monkeypatch.setattr(inspection, "SLAB_BOX", 32)
    output = trabecula("inspect", "padded.zarr", "--memory", 0.0005)
    assert "the centre box of 42 x 42 x 42" in output.out and "not looked at" in output.out
    boxed = json.loads(
        trabecula("inspect", "padded.zarr", "--memory", 0.0005, "--crop", 24, "--json").out
    )
    assert boxed["shape"] == [24] * 3
    for verb in ("inspect", "measure"):
        line = attempt(verb, "padded.zarr", "--memory", 0.0005, "--crop", "auto")
        assert line.status == 2 and "--crop auto looks at all of padded.zarr" in line.err


@pytest.mark.slow
def test_a_micrograph_works_at_once():
    made = trabecula("generate", "picture.png", "--shape", 16, "--seed", 1, "--out", "more.zarr")
    assert choice(made) == [BY_PROCESS]
    same = trabecula(
        "generate",
        "picture.png",
        "--method",
        "kopf",
        "--set",
        "process=auto",
        "--shape",
        16,
        "--seed",
        1,
        "--out",
        "same.zarr",
    )
    assert choice(same) == [] and same.sha256 == made.sha256
    assert {**method_of("more.zarr"), "versions": 0} == {**method_of("same.zarr"), "versions": 0}
    assert trabecula("rerun", "more.zarr").sha256 == made.sha256


@pytest.fixture(scope="module")
def beads(folder):
    """A scan of separate balls of several sizes."""
    draw, values = np.random.default_rng(3), np.zeros((60, 60, 60), np.uint8)
    at, centres = np.stack(np.indices(values.shape), -1), np.zeros((0, 3))
    for centre in draw.uniform(0, 60, (900, 3)):
        if len(centres) == 0 or ((centres - centre) ** 2).sum(-1).min() > 11**2:
            centres = np.vstack([centres, centre])
            values[((at - centre) ** 2).sum(-1) < draw.uniform(3.5, 5) ** 2] = 1
    tb.write(tb.Image(values, "labels"), folder / "beads.tif")
    return values


@pytest.mark.whole
def test_separate_balls_are_packed_unless_packing_cannot_make_what_is_asked_for(beads):
    made = trabecula("generate", "beads.tif", "--shape", 40, "--seed", 1, "--out", "packed.zarr")
    assert choice(made) == ["trabecula: method packing"]
    assert method_of("packed.zarr")["method"] == "packing"
    options = ("--fixed", "beads.tif", "--at", "0", "0", "0", "--shape", "60", "60", "66")
    beside = trabecula("generate", "beads.tif", *options, "--out", "beside.zarr")
    assert choice(beside) == ["trabecula: method packing"]
    assert method_of("beside.zarr")["report"]["standing"] > 10
    assert (tb.read("beside.zarr").values[:, :, :60] == beads).all()
    large = attempt("plan", "beads.tif", "--shape", 900, "--memory", 2)
    assert choice(large) == ["trabecula: method texture"]


@pytest.mark.whole
def test_closed_cells_are_made_anew_unless_their_walls_cannot_be(tmp_path):
    cells = tb.sample("cells")
    tb.write(tb.crop(cells, 48), tmp_path / "cells.tif")
    name = str(tmp_path / "cells.tif")
    small = ("--set", "lloyd_steps=1", "--set", "volume_spread=0.2", "--set", "rounding=0.2")
    target = ("--target", "porosity=0.5")
    trabecula(
        "generate",
        name,
        "--method",
        "tessellation",
        *small,
        *target,
        "--shape",
        40,
        "--out",
        "c.zarr",
    )
    assert np.mean(tb.read("c.zarr").values == 0) == pytest.approx(0.5, abs=1e-3)
    assert choice(attempt("plan", name, "--shape", 40)) == ["trabecula: method tessellation"]
    fixed = ("--fixed", name, "--at", "0", "0", "0", "--shape", "48", "48", "64")
    for words in ((*fixed,), (name, "--shape", 40), ("--shape", 3000)):
        assert choice(attempt("plan", name, *words)) == ["trabecula: method texture"]


@pytest.mark.whole
def test_a_volume_stays_texture():
    made = trabecula("generate", "scan.tif", "--shape", 16, "--out", "volume.zarr")
    assert choice(made) == ["trabecula: method texture"]
    named = trabecula(
        "generate", "scan.tif", "--method", "texture", "--shape", 16, "--out", "named.zarr"
    )
    assert named.sha256 == made.sha256
    assert method_of("named.zarr")["settings"] == method_of("volume.zarr")["settings"]
    # Settings without a method are those of texture, as they were before there was a choice.
    assert (
        choice(trabecula("generate", "scan.tif", "--shape", 16, "--out", "small.zarr", *SMALL))
        == []
    )


@pytest.mark.whole
def test_layers_get_the_preset_that_keeps_order():
    made = trabecula("generate", "layers.tif", "--shape", 24, "--out", "layered.zarr")
    assert choice(made) == ["trabecula: method texture --preset best"]
    assert method_of("layered.zarr")["settings"]["novelty"] == 0
    own = trabecula(
        "generate", "layers.tif", "--preset", "fast", "--shape", 24, "--out", "fast.zarr"
    )
    assert method_of("fast.zarr")["settings"]["first_rounds"] == 14 and choice(own) == []


@pytest.mark.slow
def test_plan_and_fit_choose_as_well():
    assert choice(trabecula("plan", "picture.png", "--shape", 16)) == [
        "trabecula: method kopf --set process=auto"
    ]
    fitted = trabecula("fit", "picture.png", "--out", "picture.model")
    assert choice(fitted) == [BY_PROCESS] and "a model of kopf" in fitted.out
    assert tb.load_model("picture.model").capabilities.name == "kopf"
    assert "name one, as --method gan" in refused(
        "fit", "scan.tif", "--minutes", 1, "--out", "gan.model"
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("picture.png", "--method", "texture"),
            "texture needs a 3-D exemplar; this is a picture of 96 x 96: use --method kopf",
        ),
        (
            ("scan.tif", "--method", "mrf"),
            "mrf needs a picture; this is a volume of 40 x 40 x 40: use --method texture",
        ),
        (("colour.png", "--method", "gan"), "use --method chen"),
        (
            ("thin.tif",),
            "no method was named, and none fits: 6 x 40 x 40 is too small to learn from",
        ),
        (("picture.png", "--set", "novelty=0"), "novelty"),
    ],
)
def test_what_does_not_fit_is_told_with_what_does(words, says):
    for verb in (("plan",), ("generate", "--out", "new.zarr")):
        assert says in refused(verb[0], words[0], "--shape", 16, *verb[1:], *words[1:])


def test_python_names_the_door():
    with pytest.raises(tb.errors.InputError, match=r"tb\.inspect\(image\)\.recommendation"):
        tb.method("texture").fit(tb.read("picture.png"))

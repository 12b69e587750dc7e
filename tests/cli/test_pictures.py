"""From a picture to a volume as a user types it: files, requests, refusals."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image as Pillow

import trabecula as tb
from commands import attempt, refused, trabecula

METHOD = ("--method", "kopf", "--preset", "fast", "--set", "first_rounds=2", "--set", "rounds=[1]")


def blobs(seed, side=48, *, share=0.35):
    """Make a picture of round blobs."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((side, side))
    field = sum(
        np.exp(-((y - a) ** 2 + (x - b) ** 2) / 12) for a, b in rng.uniform(0, side, (90, 2))
    )
    return (field > np.quantile(field, 1 - share)).astype(np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make pictures good and bad, and a form."""
    folder = tmp_path_factory.mktemp("pictures")
    picture = blobs(0)
    tb.write(tb.Image(picture, "labels", 4, "um"), folder / "picture.tif")
    tb.write(tb.Image(1 - blobs(1, share=0.05), "labels", 4, "um"), folder / "dense.tif")
    tb.write(tb.Image(picture, "labels", 8, "um"), folder / "coarse.tif")
    tb.write(tb.Image(picture, "labels", (4, 8), "um"), folder / "long.tif")
    fine = np.kron(picture, np.ones((2, 2), np.uint8))
    tb.write(tb.Image(fine, "labels", 2, "um"), folder / "fine.tif")
    rgba = np.dstack([picture * np.uint8(200)] * 3 + [np.full(picture.shape, 255, np.uint8)])
    Pillow.fromarray(rgba).save(folder / "opaque.png")
    rgba[..., 3] = 255 * picture
    Pillow.fromarray(rgba).save(folder / "clear.png")
    palette = Pillow.fromarray(picture)
    palette.putpalette([10, 20, 30, 200, 180, 160] + [0] * 750)
    palette.save(folder / "palette.png")
    noisy = picture * np.uint16(40000) + np.random.default_rng(0).integers(
        0, 9000, picture.shape
    ).astype(np.uint16)
    Pillow.fromarray(noisy).save(folder / "sixteen.png")
    Pillow.fromarray(np.full((40, 40), 7, np.uint8)).save(folder / "one.png")
    Pillow.fromarray(np.full((40, 40, 3), 7, np.uint8)).save(folder / "one-colour.png")
    Pillow.fromarray(np.eye(6, dtype=np.uint8) * np.uint8(255)).save(folder / "small.png")
    y, x, z = np.indices((20, 20, 20)) - 9.5
    tb.export(
        tb.Image((x**2 + y**2 + z**2 < 81).astype(np.uint8), "labels", 4, "um"), folder / "ball.stl"
    )
    np.save(folder / "field.npy", np.full((16, 16, 16), 0.6, np.float32))
    return folder


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """Work in a copy."""
    shutil.copytree(made, tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return tmp_path / "place"


def generate(*words, exemplars=("picture.tif",), out="made.zarr"):
    output = trabecula("generate", *exemplars, *words, *METHOD, "--out", out)
    return tb.read(out), output


@pytest.mark.whole
def test_a_volume_has_the_pictures_pixels_and_can_be_made_again(place):
    image, output = generate("--shape", 16, 18, 20, "--seed", 3)
    assert image.shape == (16, 18, 20) and image.spacing == (4.0,) * 3 and image.unit == "um"
    assert not (place / "made.zarr.part").exists()
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.parametrize("view", ["yx", "xz"])
def test_the_picture_itself_is_the_middle_slice(place, view):
    words = ("--shape", 20, "--fixed", "picture.tif", "--view", view)
    at = ("--at", 10, 0, 0) if view == "yx" else ("--at", 0, 10, 0)
    image, output = generate(*words, *at)
    picture = tb.read("picture.tif").values[:20, :20]
    np.testing.assert_array_equal(
        image.values[10] if view == "yx" else image.values[:, 10].T, picture
    )
    assert 0.05 < image.values[13 if view == "yx" else slice(None)].mean() < 0.95
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


def test_a_target_porosity_is_met_and_told(place):
    image, output = generate("--shape", 16, "--target", "porosity=0.55")
    assert tb.measure.porosity(image) == pytest.approx(0.55, abs=0.01)
    assert image.recipe.steps[-1]["request"]["target"] == {"porosity": 0.55}
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
def test_a_form_is_in_the_pictures_pixels(place):
    image, output = generate("--mask", "ball.stl")
    assert all(18 <= side <= 20 for side in image.shape)
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256
    assert not image.values[0, 0, 0] and image.values.any()
    plan = json.loads(trabecula("plan", "picture.tif", "--mask", "ball.stl", "--json", *METHOD).out)
    assert plan["peak"] > np.prod(image.shape)


@pytest.mark.whole
def test_a_form_is_in_the_voxels_of_a_model_from_pictures(place):
    """A model's file says no more of its pictures than what they were."""
    trabecula("fit", "picture.tif", *METHOD, "--out", "kept.model")
    output = trabecula(
        "generate", "--model", "kept.model", "--mask", "ball.stl", "--out", "of.zarr"
    )
    image = tb.read("of.zarr")
    assert image.spacing == (4, 4, 4) and all(18 <= side <= 20 for side in image.shape)
    assert not image.values[0, 0, 0] and output.sha256


def test_two_pictures_for_named_views(place):
    words = ("--shape", 16, "--set", "views=yx,zy")
    first, _ = generate(*words, exemplars=("picture.tif", "picture.tif"))
    second, _ = generate("--shape", 16, "--set", "views=yx,zy")
    np.testing.assert_array_equal(first.values.shape, second.values.shape)
    assert len(first.recipe.steps[-1]["exemplars"]) == 2
    assert tuple(first.recipe.steps[-1]["settings"]["views"]) == ("yx", "zy")


@pytest.mark.parametrize(
    ("name", "kind"),
    [("opaque.png", "colour"), ("palette.png", "colour"), ("sixteen.png", "labels")],
)
def test_what_pictures_are_read_as(place, name, kind):
    assert generate("--shape", 14, exemplars=(name,))[0].kind == kind


BAD = [
    ("small.png", (), "a neighbourhood of 8 needs at least 12 pixels"),
    ("one.png", (), "one phase only"),
    ("one-colour.png", (), "one value only"),
    ("clear.png", (), "pixels are transparent"),
    ("picture.tif", ("--set", "views=yx,zz"), "unknown view 'zz'"),
    ("picture.tif", ("--set", "views=yx,xy"), "different axes"),
    ("picture.tif", ("--target", "porosity=0.01"), "outside what the exemplar holds"),
    ("sixteen.png", ("--threshold", "none", "--target", "porosity=0.5"), "the exemplar is grey"),
    ("picture.tif", ("--fixed", "coarse.tif", "--at", 8, 0, 0), "give the spacing of both"),
    ("picture.tif", ("--fixed", "picture.tif", "--at", 16, 0, 0), "does not lie inside"),
    ("picture.tif", ("--fixed", "picture.tif"), "needs the place where it is known"),
]


@pytest.mark.parametrize(("name", "words", "says"), BAD)
def test_what_cannot_be_is_refused(made, monkeypatch, name, words, says):
    monkeypatch.chdir(made)
    output = attempt("generate", name, "--shape", 16, *words, *METHOD, "--out", "new.zarr")
    assert output.status == 2 and output.out == ""
    assert says in output.lines[-1], "notices may come before (a threshold found, a picture cut)"
    assert not (made / "new.zarr").exists() and not (made / "new.zarr.part").exists()


def test_a_finer_picture_is_averaged_and_a_line_says_so(made, monkeypatch):
    monkeypatch.chdir(made)
    options = ("--shape", 16, "--seed", 1, *METHOD)
    two = trabecula("generate", "picture.tif", "fine.tif", *options, "--out", "two.zarr")
    assert "pixels of 2, 4 um: the finer ones are averaged to 4" in two.err
    same = trabecula("generate", "picture.tif", "picture.tif", *options, "--out", "same.zarr")
    assert two.sha256 == same.sha256 and tb.read("two.zarr").spacing == (4.0, 4.0, 4.0)
    assert "averaged" not in same.err


def test_views_that_contradict_each_other_name_the_statistic(made, monkeypatch):
    monkeypatch.chdir(made)
    said = refused(
        "generate", "picture.tif", "dense.tif", "--shape", 16, *METHOD, "--out", "new.zarr"
    )
    assert "contradict" in said and "the fraction of void" in said
    said = refused(
        "generate", "picture.tif", "long.tif", "--shape", 16, *METHOD, "--out", "new.zarr"
    )
    assert "contradict" in said and "spacing" in said
    four = ["picture.tif"] * 4
    assert "one, two or three pictures" in refused(
        "generate", *four, "--shape", 16, *METHOD, "--out", "new.zarr"
    )

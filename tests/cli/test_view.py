"""`view` and `render` as a user types them."""

import json

import numpy as np
import pytest
from PIL import Image as Pillow

import trabecula as tb
from commands import refused, trabecula
from trabecula.view.page.server import PageServer


@pytest.fixture
def place(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    tb.write(
        tb.Image((rng.random((20, 20, 20)) > 0.6).astype(np.uint8), "labels", 5, "um"),
        tmp_path / "a.tif",
    )
    tb.write(
        tb.Image(rng.random((16, 16, 16)).astype(np.float32), "grey", 0.01, "mm"),
        tmp_path / "grey.nrrd",
    )
    (tmp_path / "certificate.json").write_text(
        json.dumps(
            {"metrics": {"porosity": {"value": 0.625, "real_band": [0.6, 0.7], "pass": True}}}
        )
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_page_is_written(place):
    output = trabecula(
        "view",
        "a.tif",
        "grey.nrrd",
        "--html",
        "page.html",
        "--certificate",
        "certificate.json",
        "--look",
        "foam",
    )
    assert output.out.startswith("page.html: 0.1 MB")
    html = (place / "page.html").read_text(encoding="utf-8")
    assert (
        '"kind": "grey"' in html
        and '"name": "a.tif"' in html
        and "0.625" in html
        and '"look": "foam"' in html
    )
    trabecula("view", "grey.nrrd", "--threshold", "0.5", "--crop", "8", "--html", "page.html")
    html = (place / "page.html").read_text(encoding="utf-8")
    assert '"kind": "labels"' in html and '"shape": [8, 8, 8]' in html


def test_a_page_is_served_until_interrupted(place, monkeypatch):
    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", interrupt)
    output = trabecula("view", "a.tif", "--no-browser")
    assert (
        output.lines[-1].startswith("trabecula: open http://127.0.0.1:")
        and "?token=" in output.lines[-1]
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("a.tif", "--html", "page.png"), "should end in .html"),
        (("a.tif", "--html", "p.html", "--look", "breed"), "did you mean 'bread'"),
        (("a.tif", "--port", "http"), "one whole number"),
        (("a.tif", "--port", "70000"), "outside 0..65535"),
        (("a.tif", "--html", "p.html", "--certificate", "none.json"), "cannot read none.json"),
        (("a.tif", "--html", "p.html", "--certificate", "a.tif"), "is no JSON"),
        (("a.tif",) * 7 + ("--html", "p.html"), "1 to 6 images"),
        (("b.tif", "--html", "p.html"), "there is no file"),
        (("a.tif", "--html", "p.html", "--threshold", "3"), "a threshold is for grey images"),
    ],
)
def test_what_cannot_be_is_refused(place, words, message):
    assert message in refused("view", *words)
    assert not (place / "p.html").exists()


def test_a_still_is_cut_as_asked_and_can_be_made_again(place):
    trabecula(
        "render",
        "a.tif",
        "--out",
        "still.png",
        "--size",
        80,
        60,
        "--cut",
        "x=0.4",
        "plane=10,20,0.6",
    )
    step = tb.read("still.png").recipe.steps[-1]
    assert step["cut"] == ["x=0.4", "plane=10,20,0.6"]
    expected = tb.render(tb.read("a.tif"), size=(80, 60), cut=["x=0.4", "plane=10,20,0.6"])
    np.testing.assert_array_equal(tb.read("still.png").values, expected.values)


@pytest.mark.whole
def test_a_traced_still_is_that_of_python_and_can_be_run_again(place):
    (place / "own.toml").write_text('base = "wax"\nalbedo = [200, 120, 90]\n')
    words = ("render", "a.tif", "--out", "traced.png", "--size", 32, 24, "--cut", "none")
    options = ("--quality", "draft", "--samples", 2, "--look", "own.toml", "--up", "y")
    trabecula(*words, *options, "--lens", 40, "--no-ground", "--phase", "solid")
    still = tb.read("traced.png")
    expected = tb.render(
        tb.read("a.tif"), size=(32, 24), cut="none", quality="draft", samples=2, look="own.toml",
        up="y", lens=40, ground=False, phase=["solid"],
    )  # fmt: skip
    np.testing.assert_array_equal(still.values, expected.values)
    (place / "own.toml").unlink()  # the recipe holds the look
    assert trabecula("rerun", "traced.png").sha256 == still.recipe.to_json()[-1]["sha256"]
    assert "quality" in refused(*words, "--exposure", 1)
    assert "--turntable" in refused(*words[:3], "t.gif", "--turntable", 3, "--quality", "draft")


def test_a_turntable_is_a_moving_picture(place):
    output = trabecula("render", "a.tif", "--out", "turn.gif", "--turntable", 3, "--size", 48, 40)
    assert "3 frames" in output.out
    with Pillow.open(place / "turn.gif") as moving:
        assert moving.n_frames == 3 and moving.size == (48, 40)
    assert "written as .gif" in refused("render", "a.tif", "--out", "turn.png", "--turntable", 3)
    assert "2..360 frames" in refused("render", "a.tif", "--out", "turn.gif", "--turntable", 1)


@pytest.fixture
def large(place):
    """Make a store of three levels, the finest of which takes some 2 MiB to draw."""
    values = np.zeros((600, 20, 20), np.uint8)
    values[:, 4:16, 4:16] = np.random.default_rng(3).random((600, 12, 12)) < 0.7
    tb.write(tb.Image(values, "labels", 2.0, "um"), place / "large.zarr")
    return place


RENDER = ("render", "large.zarr", "--out", "still.png", "--size", 64, 48)


@pytest.mark.parametrize(("memory", "level"), [(0.004, 0), (0.001, 1), (0.0002, 2)])
def test_what_does_not_fit_is_shown_at_the_finest_level_that_does(large, memory, level):
    told = trabecula(*RENDER, "--memory", memory)
    shown = tb.render(tb.read("large.zarr", level=level), size=(64, 48))
    np.testing.assert_array_equal(tb.read("still.png").values, shown.values)
    assert any(f"its level {level} is shown" in line for line in told.lines) == (level > 0)
    told = trabecula(
        "view", "large.zarr", "a.tif", "--html", "page.html", "--memory", 1.75 * memory
    )
    html = (large / "page.html").read_text(encoding="utf-8")
    assert json.dumps({"shape": [600 >> level, 20 >> level, 20 >> level]})[1:-1] in html
    assert any(f"its level {level} is shown" in line for line in told.lines) == (level > 0)


def test_a_level_that_is_asked_for_is_shown_or_refused(large):
    assert not trabecula(*RENDER, "--level", 1, "--memory", 0.001).lines
    np.testing.assert_array_equal(
        tb.read("still.png").values, tb.render(tb.read("large.zarr", level=1), size=(64, 48)).values
    )
    assert "show a coarser --level" in refused(*RENDER, "--level", 0, "--memory", 0.001)
    assert "got level 7" in refused(*RENDER, "--level", 7, "--memory", 0.001)
    assert "level 2 is the coarsest" in refused(*RENDER, "--memory", 0.00005)
    assert "--crop" in refused("view", "large.zarr", "--html", "p.html", "--memory", 0.00004)


def test_of_a_crop_of_what_does_not_fit_nothing_else_is_read(large, monkeypatch):
    def whole(*words):
        raise AssertionError("all of it was read")

    with monkeypatch.context() as patch:
        patch.setattr("trabecula.engine.store.Store.load", whole)
        trabecula(*RENDER, "--crop", 16, "--memory", 0.0003)
    still, image = tb.read("still.png"), tb.crop(tb.read("large.zarr"), 16)
    np.testing.assert_array_equal(still.values, tb.render(image, size=(64, 48)).values)
    assert still.recipe.to_json()[:-1] == image.recipe.to_json()

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
    tb.write(tb.Image((rng.random((20, 20, 20)) > 0.6).astype(np.uint8), "labels", 5, "um"), tmp_path / "a.tif")
    tb.write(tb.Image(rng.random((16, 16, 16)).astype(np.float32), "grey", 0.01, "mm"), tmp_path / "grey.nrrd")
    (tmp_path / "certificate.json").write_text(
        json.dumps({"metrics": {"porosity": {"value": 0.625, "real_band": [0.6, 0.7], "pass": True}}})
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_page_is_written(place):
    output = trabecula(
        "view", "a.tif", "grey.nrrd", "--html", "page.html", "--certificate", "certificate.json", "--look", "foam"
    )
    assert output.out.startswith("page.html: 0.1 MB")
    html = (place / "page.html").read_text(encoding="utf-8")
    assert '"kind": "grey"' in html and '"name": "a.tif"' in html and "0.625" in html and '"look": "foam"' in html
    trabecula("view", "grey.nrrd", "--threshold", "0.5", "--crop", "8", "--html", "page.html")
    html = (place / "page.html").read_text(encoding="utf-8")
    assert '"kind": "labels"' in html and '"shape": [8, 8, 8]' in html


def test_a_page_is_served_until_interrupted(place, monkeypatch):
    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(PageServer, "serve_forever", interrupt)
    output = trabecula("view", "a.tif", "--no-browser")
    assert output.lines[-1].startswith("trabecula: open http://127.0.0.1:") and "?token=" in output.lines[-1]


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
    trabecula("render", "a.tif", "--out", "still.png", "--size", 80, 60, "--cut", "x=0.4", "plane=10,20,0.6")
    step = tb.read("still.png").recipe.steps[-1]
    assert step["cut"] == ["x=0.4", "plane=10,20,0.6"]
    expected = tb.render(tb.read("a.tif"), size=(80, 60), cut=["x=0.4", "plane=10,20,0.6"])
    np.testing.assert_array_equal(tb.read("still.png").values, expected.values)


def test_a_turntable_is_a_moving_picture(place):
    output = trabecula("render", "a.tif", "--out", "turn.gif", "--turntable", 3, "--size", 48, 40)
    assert "3 frames" in output.out
    with Pillow.open(place / "turn.gif") as moving:
        assert moving.n_frames == 3 and moving.size == (48, 40)
    assert "written as .gif" in refused("render", "a.tif", "--out", "turn.png", "--turntable", 3)
    assert "2..360 frames" in refused("render", "a.tif", "--out", "turn.gif", "--turntable", 1)

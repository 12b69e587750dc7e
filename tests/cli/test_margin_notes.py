"""Margins of a scan on the command line: reported with every figure, and cropped by an option."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, refused, trabecula
from trabecula.core.progress import listen

NOTE = (
    "the first plane along z holds void alone: crop them (--crop auto, tb.crop_margins), or they "
    "count as material"
)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    values = tb.sample("bone").values[:40, :40, :40].copy()
    values[0] = 0
    tb.write(tb.Image(values, "labels"), folder / "scan.tif")
    noise = np.random.default_rng(0).normal(0, 9, values.shape)
    grey = np.clip(60 + 100.0 * values + noise, 1, 255).astype(np.uint8)
    grey[:2] = 0
    tb.write(tb.Image(grey, "grey"), folder / "grey.tif")
    return folder


def notices(output) -> bool:
    return any(NOTE in line for line in output.lines)


@pytest.mark.whole
def test_whoever_makes_or_measures_says_it(scan, monkeypatch):
    monkeypatch.chdir(scan)
    assert notices(trabecula("generate", "scan.tif", "--shape", 24, "--out", "a.tif", *SMALL))
    assert notices(trabecula("fit", "scan.tif", "--method", "noise", "--out", "a.model"))
    assert notices(trabecula("plan", "scan.tif", "--shape", 24, *SMALL))
    measured = trabecula("measure", "scan.tif", "--quick", "--json")
    assert notices(measured) and NOTE in json.loads(measured.out)["notes"][0]


@pytest.mark.whole
def test_cropped_nobody_says_it_and_the_recipe_tells(scan, monkeypatch):
    monkeypatch.chdir(scan)
    made = trabecula(
        "generate", "scan.tif", "--crop", "auto", "--shape", 24, "--out", "b.tif", *SMALL
    )
    assert not notices(made)
    assert made.lines == [
        "trabecula: scan.tif: the first plane along z holds void alone; cropped to 39 x 40 x 40 at "
        "(1, 0, 0)"
    ]
    (step,) = tb.read("b.tif").recipe.steps
    assert [inner["verb"] for inner in step["exemplars"][0]] == ["read", "crop"]
    assert trabecula("rerun", "b.tif").sha256 == made.sha256
    measured = json.loads(
        trabecula("measure", "scan.tif", "--quick", "--crop", "auto", "--json").out
    )
    assert measured["shape"] == [39, 40, 40] and measured["notes"] == []


@pytest.mark.whole
def test_a_frame_is_cut_off_before_the_threshold_is_found(scan, monkeypatch):
    monkeypatch.chdir(scan)
    whole = tb.read("grey.tif")
    made = trabecula(
        "generate", "grey.tif", "--crop", "auto", "--shape", 24, "--out", "c.tif", *SMALL
    )
    steps = tb.read("c.tif").recipe.steps[0]["exemplars"][0]
    assert [step["verb"] for step in steps] == ["read", "crop", "segment"]
    assert steps[2]["threshold"] == tb.segment(tb.crop_margins(whole)).recipe.steps[-1]["threshold"]
    assert trabecula("rerun", "c.tif").sha256 == made.sha256


@pytest.mark.whole
def test_without_margins(scan):
    done = trabecula("measure", "sample:foam", "--quick", "--crop", "auto")
    assert done.lines == ["trabecula: sample:foam has no margins to crop"]
    assert "--crop automatic" in refused("measure", "sample:foam", "--quick", "--crop", "automatic")


@pytest.mark.whole
def test_in_python_the_notes_say_it(scan):
    image = tb.read(scan / "scan.tif")
    assert NOTE in tb.describe(image, level="quick")["notes"][0]
    note = tb.describe(tb.read(scan / "grey.tif"))["notes"][0]
    assert note.startswith("the first 2 planes along z hold one grey (about 0) alone: crop them")
    lines = []
    with listen(lambda label, fraction: lines.append(label) if fraction < 0 else None):
        tb.method("noise").fit(image)
        tb.method("noise").fit(tb.crop_margins(image))
    assert [line for line in lines if NOTE in line] == lines[:1] and len(lines) == 1

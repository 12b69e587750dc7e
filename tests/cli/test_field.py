"""Target fields, and a material that follows one, as a user makes them."""

import json

import numpy as np
import pytest
from PIL import Image

import trabecula as tb
from commands import SMALL, attempt, refused, trabecula
from trabecula import fields


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.whole
@pytest.mark.parametrize("suffix", [".npy", ".tif", ".zarr"])
def test_a_ramp_becomes_a_target(place, suffix):
    trabecula(
        "field",
        "ramp",
        "--shape",
        24,
        16,
        16,
        "--from",
        0.15,
        "--to",
        0.3,
        "--out",
        f"ramp{suffix}",
    )
    assert np.array_equal(
        tb.read(f"ramp{suffix}").values, fields.ramp((24, 16, 16), start=0.15, end=0.3).values
    )
    trabecula(
        "generate", "sample:bone", "--crop", 32, "--shape", 24, 16, 16,
        "--target", f"volume_fraction=ramp{suffix}", "--seed", 1, "--out", "made.npy", *SMALL,
    )  # fmt: skip
    made = tb.read("made.npy").values
    assert made.mean() == pytest.approx(0.225, abs=0.001)


@pytest.mark.whole
def test_a_result_is_made_again_with_its_field(place):
    trabecula(
        "field", "formula", "0.2 + 0.05 * sin(2 * pi * x / X)", "--shape", 16, "--out", "field.tif"
    )
    words = (
        "sample:bone",
        "--crop",
        32,
        "--shape",
        16,
        "--target",
        "volume_fraction=field.tif",
        "--seed",
        1,
    )
    trabecula("generate", *words, "--out", "made.zarr", *SMALL)
    (place / "field.tif").unlink()
    assert "the same voxels" in trabecula("rerun", "made.zarr").out


@pytest.mark.whole
def test_every_kind_is_what_its_function_makes(place):
    # few levels, which are greys all the same
    drawn = np.repeat(np.array([[0, 51, 255]], np.uint8), 4, axis=0)
    Image.fromarray(drawn).save("drawn.png")
    mask = np.ones((9, 9), np.uint8)
    mask[4, :7] = 0
    tb.write(mask, "slit.tif")
    grid = ("--shape", 6, 7, 8, "--spacing", 2, "--unit", "um")
    size = {"spacing": 2, "unit": "um"}
    made = {
        (
            "radial",
            *grid,
            "--inside",
            0.1,
            "--outside",
            0.4,
            "--radius",
            5,
            "--centre",
            6,
            7,
            8,
        ): fields.radial((6, 7, 8), inside=0.1, outside=0.4, radius=5, centre=(6, 7, 8), **size),
        ("formula", "z / Z + x", *grid): fields.formula((6, 7, 8), "z / Z + x", **size),
        ("picture", "drawn.png", *grid, "--low", 0, "--high", 1, "--axis", "y"): fields.picture(
            drawn, (6, 7, 8), low=0, high=1, axis="y", **size
        ),
        (
            "interpolate",
            "--shape",
            9,
            9,
            "--point",
            1,
            1,
            0.2,
            "--point",
            8,
            1,
            0.6,
            "--mask",
            "slit.tif",
        ): (fields.interpolate((9, 9), [(1, 1), (8, 1)], [0.2, 0.6], mask=mask > 0)),
        ("measure", "sample:bone", "--crop", 20, "--size", 7, "--name", "euler"): fields.measure(
            tb.crop(tb.sample("bone"), 20), "euler", size=7
        ),
        (
            "simp",
            "wheel",
            "--elements",
            4,
            6,
            6,
            "--shape",
            8,
            12,
            12,
            "--volume",
            0.6,
        ): fields.resample(fields.simp("wheel", (4, 6, 6), volume=0.6), (8, 12, 12)),
    }
    for words, expected in made.items():
        told = json.loads(trabecula("field", *words, "--out", "field.tif", "--json").out)
        image = tb.read("field.tif")
        assert np.allclose(image.values, expected.values, atol=1e-6), words
        assert (image.spacing, image.unit) == (expected.spacing, expected.unit), words
        assert told["least"] == pytest.approx(float(expected.values.min())) and told[
            "shape"
        ] == list(expected.shape)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("formula", "__import__('os')", "--shape", "4"),
            "unknown function in a formula '__import__'",
        ),
        (("ramp", "--shape", "four", "--from", "0", "--to", "1"), "--shape four"),
        (("ramp", "--shape", "4", "--from", "low", "--to", "1"), "--from low: give numbers"),
        (("simp", "bridge"), "known are cantilever, wheel"),
        (("measure", "sample:bone", "--size", "200"), "does not fit into"),
        (("measure", "sample:bone", "--size", "9", "--name", "surfce"), "did you mean 'surface'"),
        (("interpolate", "--shape", "4", "4", "--point", "1", "1", "1", "1"), "give (N, 2)"),
        (
            ("picture", "missing.png", "--shape", "4", "--low", "0", "--high", "1"),
            "there is no file missing.png",
        ),
    ],
)
def test_what_cannot_be_made_is_refused(place, words, says):
    assert says in refused("field", *words, "--out", "field.tif")
    assert not (place / "field.tif").exists()


def test_a_kind_is_asked_for(place):
    assert attempt("field").status == 2
    assert "invalid choice: 'rmap'" in attempt("field", "rmap", "--out", "a.tif").err


@pytest.mark.whole
@pytest.mark.parametrize(
    ("target", "says"),
    [
        ("volume_fraction=ramp.npy", "has shape (4, 4, 4), the request (16, 16, 16)"),
        ("volume_fractoin=0.2", "did you mean 'volume_fraction'"),
        ("surface=0.1", "cannot honour the target surface"),
        ("volume_fraction=0.99", "is outside what the exemplar holds"),
    ],
)
def test_targets_that_do_not_fit_are_refused(place, target, says):
    np.save("ramp.npy", np.full((4, 4, 4), 0.2, np.float32))
    words = ("sample:bone", "--crop", 32, "--shape", 16, "--target", target, "--out", "made.npy")
    assert says in refused("generate", *words, *SMALL)

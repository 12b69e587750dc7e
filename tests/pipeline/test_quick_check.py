"""The figures that a run names at its end."""

import re

import numpy as np
import pytest

import trabecula as tb
from commands import trabecula
from trabecula.core.request import Request
from trabecula.pipeline.generate import generate_to
from trabecula.pipeline.quick_check import quick_check


@pytest.fixture(scope="module")
def model():
    return tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 64))


@pytest.mark.whole
def test_what_is_off_is_named_and_what_is_not_measured_is_silent(model, tmp_path):
    request = Request((64, 64, 64), seed=1)
    made = generate_to(model, request, tmp_path / "made.tif")
    assert re.search(
        r"all \d+ quick figures lie|\d+ of \d+ figures out", quick_check(model, request, made)
    )
    cubes = np.random.default_rng(0).integers(0, 2, (4, 4, 4)).astype(np.uint8)
    exemplar = model.exemplars[0]
    fake = tb.Image(
        np.kron(cubes, np.ones((16, 16, 16), np.uint8)),
        "labels",
        spacing=exemplar.spacing,
        unit=exemplar.unit,
        phases=exemplar.phases,
        recipe=made.recipe,
    )
    tb.write(fake, made.path)
    line = quick_check(model, request, made)
    assert "figures out of band" in line and "porosity" in line and "trabecula verify" in line
    for other in (Request((48, 64, 64)), Request((64,) * 3, target={"porosity": 0.8})):
        assert quick_check(model, other, made) == ""


@pytest.mark.whole
def test_the_command_says_it_on_standard_error(tmp_path):
    words = ["--method", "texture", "--preset", "fast", "--crop", 64, "--shape", 64]
    output = trabecula("generate", "sample:bone", *words, "--out", tmp_path / "a.tif")
    assert any("quick figures" in line or "out of band" in line for line in output.lines)

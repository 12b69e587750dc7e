"""`trabecula finish --for PRINTER`: what its limits ask for, and what is left to say."""

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula


@pytest.fixture
def part(tmp_path, monkeypatch):
    """Two struts too thin for resin, apart, and a closed pore in one of them."""
    monkeypatch.chdir(tmp_path)
    values = np.zeros((24, 24, 24), np.uint8)
    values[2:22, 3:5, 3:5] = 1
    values[2:22, 12:21, 12:21] = 1
    values[10:13, 15:18, 15:18] = 0
    tb.write(tb.Image(values, "labels", 200.0, unit="um"), "part.tif")
    return tmp_path


def test_resin_gets_walls_joins_and_holes(part):
    out = trabecula("finish", "part.tif", "--for", "sla", "--out", "resin.tif").out
    for word in ("connect.joins", "thicken.added", "drain.holes", "one piece", "estimate"):
        assert word in out
    made = tb.read("resin.tif")
    assert tb.measure.components(made) == 1 and tb.finish.trapped(made)["pores"] == 0
    steps = {step["operation"]: step for step in made.recipe.steps if "operation" in step}
    assert steps["thicken"]["settings"]["thickness"] == pytest.approx(500)
    assert steps["drain"]["settings"]["width"] == pytest.approx(500)


def test_what_the_options_say_goes_first(part):
    words = ("--for", "sls", "--thicken", 300, "--fill", "--out", "powder.tif")
    out = trabecula("finish", "part.tif", *words).out
    steps = {
        step["operation"]: step["settings"]
        for step in tb.read("powder.tif").recipe.steps
        if "operation" in step
    }
    assert steps["thicken"]["thickness"] == 300 and "drain" not in steps and "fill_trapped" in steps
    assert "sls: " in out


def test_a_part_without_a_size_or_an_unknown_printer_is_refused(part):
    np.save("plain.npy", np.ones((6, 6, 6), np.uint8))
    assert "--unit" in refused("finish", "plain.npy", "--for", "sla", "--out", "a.npy")
    assert "sls" in refused("finish", "part.tif", "--for", "slz", "--out", "a.tif")

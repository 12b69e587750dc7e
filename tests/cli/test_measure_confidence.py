"""`measure --confidence` adds intervals, and `--sizes` their page."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from commands import refused, trabecula


@pytest.fixture
def scan(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    noise = np.random.default_rng(0).standard_normal((200, 200))
    image = tb.Image(
        ndimage.gaussian_filter(noise, 2.0) > 0, "labels", spacing=(2.0, 2.0), unit="um"
    )
    tb.write(image, "scan.zarr")
    return image


@pytest.mark.whole
def test_json_and_table(scan):
    plain = json.loads(trabecula("measure", "scan.zarr", "--quick", "--json").out)
    found = json.loads(trabecula("measure", "scan.zarr", "--quick", "--confidence", "--json").out)
    intervals = found.pop("confidence")
    assert found == plain
    own = tb.measure.confidence(scan, level="quick")
    assert {name: one.to_json() for name, one in own.items()} == intervals
    assert "thickness" not in intervals
    lines = trabecula("measure", "scan.zarr", "--quick", "--confidence", "default").out.splitlines()
    (row,) = (line.split() for line in lines if line.startswith("porosity") and "%" in line)
    assert float(row[1]) == pytest.approx(intervals["porosity"]["low"], rel=1e-5)
    assert any(line.startswith("thickness") and "%" in line for line in lines)


def test_page(scan):
    trabecula("measure", "scan.zarr", "--quick", "--sizes", "sizes.html")
    text = Path("sizes.html").read_text(encoding="utf-8")
    assert text.count("<svg viewBox") >= 5 and "Specific surface" in text and "http" not in text
    assert text.count("<polyline") == 2 * text.count("<figure>")


def test_refusals(scan):
    assert "leave out --phase" in refused(
        "measure", "scan.zarr", "--confidence", "--phase", "solid"
    )
    assert "level" in refused("measure", "scan.zarr", "--confidence", "much")

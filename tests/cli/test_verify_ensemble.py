"""An ensemble judged on the command line."""

import json

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from commands import refused, trabecula


def material(seed, side):
    noise = np.random.default_rng(seed).normal(size=(side + 8,) * 3)
    smooth = ndimage.gaussian_filter(noise, 1.0)[4:-4, 4:-4, 4:-4]
    return tb.Image((smooth > 0.05).astype(np.uint8), "labels", 5.0, "um")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ensemble")
    for seed in (0, 1):
        tb.write(material(seed, 54), folder / f"scan{seed}.zarr")
    for seed in range(8):
        tb.write(material(10 + seed, 18), folder / f"{seed}.zarr")
    tb.write(material(30, 20), folder / "large.zarr")
    return folder


@pytest.mark.whole
def test_members_are_judged_together(folder, tmp_path):
    members = [folder / f"{seed}.zarr" for seed in range(8)]
    page = tmp_path / "page.html"
    words = ("verify", folder / "scan0.zarr", *members, "--ensemble", "--quick")
    shown = trabecula(*words, "--report", page)
    assert shown.out.startswith("8 members: ") and "two_point_half" in shown.out
    html = page.read_text(encoding="utf-8")
    assert "Is the ensemble the material?" in html and "data:image/png;base64" in html
    found = json.loads(trabecula(*words, "--json").out)["ensemble"]
    assert found["members"] == 8 and found["real"]["exemplars"] == 1
    assert found["names"] == [member.name for member in members]
    both = json.loads(trabecula(*words, "--json", "--parts", folder / "scan1.zarr").out)["ensemble"]
    assert both["real"]["exemplars"] == 2
    assert both["real"]["parts"] == 2 * found["real"]["parts"] == 54


def test_what_is_no_ensemble_is_refused(folder):
    scan, one, large = (folder / name for name in ("scan0.zarr", "0.zarr", "large.zarr"))
    assert "ensemble of 1 members" in refused("verify", scan, one, "--ensemble")
    assert "one shape" in refused("verify", scan, *[one] * 3, large, "--ensemble")
    assert "--parts are for" in refused("verify", scan, one, "--parts", scan)
    views = refused("verify", scan, *[one] * 4, "--ensemble", "--views", "yx")
    assert "leave out --pictures" in views

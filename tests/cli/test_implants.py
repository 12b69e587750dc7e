"""`measure --bone` and `measure --coating`: the figures of the library, and what is refused."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula


@pytest.fixture
def part(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.zeros((20, 16, 16), np.uint8)
    values[:4] = values[4:16, ::4] = values[10:12] = 1
    image = tb.Image(values, "labels", 50.0, "um", phases=("void", "solid"))
    tb.write(image, "part.zarr")
    return image


def test_bone(part):
    found = json.loads(trabecula("measure", "part.zarr", "--bone", "--json").out)
    assert found["bone"] == tb.measure.bone_figures(part)
    lines = trabecula("measure", "part.zarr", "--bone").out
    assert "Conn.D" in lines and "1/um^3" in lines and "SMI" in lines


def test_coating(part):
    found = json.loads(trabecula("measure", "part.zarr", "--coating", "--json").out)
    assert found["coating"] == tb.measure.coating(part).to_json()
    lines = trabecula("measure", "part.zarr", "--coating", "z").out
    assert "volume_percent_void" in lines and "21 CFR 888.3358" in lines
    assert "OUTSIDE" in lines or "inside" in lines
    turned = tb.Image(part.values[::-1].copy(), "labels", 50.0, "um", phases=part.phases)
    tb.write(turned, "turned.zarr")
    other = json.loads(trabecula("measure", "turned.zarr", "--coating", "z-", "--json").out)
    assert other["coating"] == found["coating"]


def test_what_does_not_go_with_them_is_refused(part):
    words = ("measure", "part.zarr")
    assert "leave out --quick" in refused(*words, "--bone", "--full")
    assert "leave out --quick" in refused(*words, "--coating", "--drainage", "z")
    assert "not allowed with" in refused(*words, "--bone", "--coating")
    assert "give z, y or x" in refused(*words, "--coating", "w")
    np.save("picture.npy", part.values[:, 4])
    picture = ("measure", "picture.npy", "--kind", "labels", "--phases", "void", "solid")
    assert "axes y and x" in refused(*picture, "--coating", "z")
    assert "2-D" in refused(*picture, "--bone")

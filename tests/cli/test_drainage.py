"""`measure --drainage`: the curves of two fluids, and what does not go with them."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula


@pytest.fixture
def bottle(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.ones((14, 9, 9), np.uint8)
    values[:5, 3:6, 3:6] = values[5:10, 1:8, 1:8] = values[10:, 4, 4] = 0
    image = tb.Image(values, "labels", spacing=2.0, unit="um", phases=("void", "solid"))
    tb.write(image, "bottle.zarr")
    return image


def test_curves_are_those_of_the_library(bottle):
    words = ("measure", "bottle.zarr", "--drainage")
    found = json.loads(trabecula(*words, "--trapping", "--json").out)
    own = tb.measure.drainage(bottle, trapping=True)
    assert found["entry_radius"] == own.entry_radius == 2.0
    assert found["drainage"]["radii"] == own.radii.tolist()
    assert found["drainage"]["saturation"] == own.saturation.tolist()
    assert found["drainage"]["pressure"] is None
    back = tb.measure.imbibition(bottle, trapping=True)
    assert found["imbibition"]["trapped"] == back.trapped > 0.5
    assert found["imbibition"]["radii"][-1] is None
    lines = trabecula(*words, "z", "--surface-tension", "0.48", "--contact-angle", "140").out
    assert "entry_radius  2\n" in lines and "pressure, Pa" in lines
    assert "trapped 0 of the phase" in lines and "end" in lines
    mercury = json.loads(trabecula(*words, "all", "--json").out)
    assert mercury["entry_radius"] is None


def test_what_does_not_go_with_it_is_refused(bottle):
    words = ("measure", "bottle.zarr")
    assert "--drainage as well" in refused(*words, "--trapping")
    assert "z, y, x or all" in refused(*words, "--drainage", "w")
    assert "leave out --trapping" in refused(*words, "--drainage", "all", "--trapping")
    assert "leave out --quick" in refused(*words, "--drainage", "--quick")
    assert "--surface-tension as well" in refused(*words, "--drainage", "--contact-angle", "20")
    assert "outside 0" in refused(*words, "--drainage", "--surface-tension", "-1")
    assert "does not reach the inlet" in refused(*words, "--drainage", "y")
    np.save("picture.npy", bottle.values[:, 4])
    picture = ("measure", "picture.npy", "--kind", "labels", "--phases", "void", "solid")
    assert "axes y and x" in refused(*picture, "--drainage", "z")


def test_relative_permeability_is_the_librarys(bottle):
    words = ("measure", "bottle.zarr", "--drainage", "--relative-permeability", "0.5", "0.9")
    found = json.loads(trabecula(*words, "--json").out)["relative_permeability"]
    own = tb.measure.relative_permeability(bottle, axis=0, saturations=[0.5, 0.9])
    assert found["drainage"] == own.to_json()
    assert "does not percolate" in [*found["drainage"]["nonwetting"], *found["drainage"]["wetting"]]
    assert set(found) == {"drainage", "imbibition"}
    lines = trabecula(*words).out
    assert "relative permeability, drainage: of " in lines and "does not percolate" in lines
    bare = ("measure", "bottle.zarr", "--relative-permeability")
    assert "--drainage as well" in refused(*bare)
    assert "has no way to flow" in refused(*words[:2], "--drainage", "all", *words[3:])
    assert "outside 0" in refused(*words[:4], "60")

"""Tables of settings: what they say is what the configs hold to."""

import dataclasses
import json
import re

import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.synth.api.method import Capabilities
from trabecula.synth.api.registry import methods
from trabecula.synth.api.settings import preset_settings, settings_of

METHODS = methods()
NUMBERS = [
    pytest.param(name, one, id=f"{name}-{one.name}")
    for name, spec in METHODS.items()
    for one in settings_of(spec)
    if type(one.default) in (int, float) and (name, one.name) != ("gan", "seed")
]


@pytest.mark.parametrize(("name", "one"), NUMBERS)
def test_a_value_beyond_the_range_is_refused(name, one):
    if "above 0 and below 1" in one.allowed:
        least, most = "0", "1"
    else:
        least, most = re.split(r" \.\. ", one.allowed.removeprefix("0, "))
    beyond = [float(least) - 1 or -1.0]  # 0 may stand for something of its own
    if re.fullmatch(r"[\d.]+", most):
        beyond.append(float(most) + 1)
    for value in beyond:
        value = int(value) if isinstance(one.default, int) else value
        with pytest.raises(tb.errors.InputError, match=one.name):
            tb.method(name, **{one.name: value})


@pytest.mark.parametrize("name", METHODS)
def test_every_setting_has_a_meaning_and_presets_replay(name):
    settings = settings_of(METHODS[name])
    assert [one.name for one in settings] == [
        field.name for field in dataclasses.fields(tb.method(name).config)
    ]
    assert all(one.meaning for one in settings)
    for preset, given in preset_settings(METHODS[name]).items():
        assert given == {one.name: one.presets[preset] for one in settings if preset in one.presets}


@pytest.mark.parametrize(
    ("name", "setting", "unit", "allowed"),
    [
        ("texture", "clip", "voxels", "2 .. 20"),
        ("texture", "rounds", "", "each 1 .. 100"),
        ("texture", "adaptive", "", "true, false"),
        ("texture", "layout", "", "rounds, structure, coarse"),
        ("quilt", "patch", "voxels", "0, 4 .. 64"),
        ("gan", "rate", "", "1e-6 .. 0.1"),
        ("gan", "minutes", "minutes", "0 .. 100000"),
        ("noise", "length", "unit of the image", "at least 2 voxels"),
        ("noise", "porosity", "", "above 0 and below 1"),
        ("sliced", "step", "voxels", "1 .. half their width"),
        ("mrf", "neighbourhood", "pixels", "3 .. 15"),
        ("bubbles", "grain", "L", "0.25 .. 4"),
    ],
)
def test_units_and_ranges_are_read_from_the_texts(name, setting, unit, allowed):
    (one,) = (one for one in settings_of(METHODS[name]) if one.name == setting)
    assert (one.unit, one.allowed) == (unit, allowed)


def test_a_config_without_source_has_no_meanings():
    spec = Capabilities("made", "", "", "made:X", ("settings",))
    config = dataclasses.make_dataclass("MadeConfig", [("width", int, 3)])
    made = type("Made", (tb.synth.api.Method,), {"capabilities": spec, "config_type": config})
    with tb.synth.api.register(made):
        (one,) = settings_of(spec)
    assert (one.name, one.default, one.meaning, one.allowed) == ("width", 3, "", "")


def test_the_command_prints_what_set_takes():
    text = trabecula("methods", "texture").out
    assert "\nclip: voxels; 2 .. 20; default 4.2\n  Signed distance" in text
    assert "\nrounds: each 1 .. 100; default [4, 6, 8, 12]; fast [2, 4, 6]; best [2, 6, 8]" in text
    found = json.loads(trabecula("methods", "texture", "--json").out)
    assert found["settings"]["clip"]["default"] == 4.2
    assert found["settings"]["step"]["presets"] == {"paper": found["presets"]["paper"]["step"]}
    assert "did you mean 'texture'" in refused("methods", "textur")

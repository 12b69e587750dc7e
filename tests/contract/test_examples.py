"""The methods that the how-to page shows keep the contract, and so do methods of other packages."""

import dataclasses
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.errors import FileError, PluginError
from trabecula.synth.api import registry
from trabecula.testing import METHOD_CHECKS, check_method

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)


@pytest.fixture
def announce(monkeypatch):
    """Return a function that makes entry points known, NAME=VALUE."""

    def known(**points):
        found = [EntryPoint(name, value, registry.GROUP) for name, value in points.items()]
        monkeypatch.setattr(registry, "_points", lambda: found)

    registry._notify_once.cache_clear()
    return known


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "class_name"), [("coin", "Coin"), ("dust", "Dust"), ("plates", "Plates")]
)
def test_the_examples_keep_the_contract(name, class_name):
    module = __import__(name)
    skipped = check_method(getattr(module, class_name))
    assert len(skipped) < len(METHOD_CHECKS) / 2
    assert name not in tb.methods() and "Inapplicable" not in str(skipped)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"deterministic": True}, "seed: deterministic, and another seed gives other voxels"),
        ({"large": "box"}, 'capabilities: large="box" and a Model'),
        ({"large": "memmap"}, "capabilities: large=.* needs the hook resident_memory"),
        ({"honours": frozenset({"mask"})}, "parts: mask: labels .* are outside of the form"),
    ],
)
def test_a_method_that_claims_too_much_is_found(monkeypatch, change, says):
    import dust

    told = dataclasses.replace(dust.CAPABILITIES, **change)
    monkeypatch.setattr(dust.Dust, "capabilities", told)
    monkeypatch.setattr(dust.DustModel, "capabilities", told)
    with pytest.raises(AssertionError, match=says):
        check_method(dust.Dust, leave_out=("old processor", "resume"))


def test_a_method_of_another_package_is_found_by_its_entry_point(announce, tmp_path):
    announce(dust="dust:CAPABILITIES")
    assert "dust" in tb.methods()
    made = tb.method("dust", porosity=0.7).fit().generate(24, seed=1)
    assert abs(tb.measure.porosity(made) - 0.7) < 0.02
    path = tb.method("dust").fit().save(tmp_path / "dust.model")
    assert np.array_equal(
        tb.load_model(path).generate(9).values, tb.method("dust").fit().generate(9).values
    )
    announce()
    with pytest.raises(FileError, match="install the package that has it"):
        tb.load_model(path)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("nowhere:CAPABILITIES", "cannot be loaded .ModuleNotFoundError"),
        ("dust:NOTHING", "cannot be loaded .AttributeError"),
        ("dust:DustConfig", "is a type: it should name the Capabilities"),
        ("plates:CAPABILITIES", "describes a method 'plates'"),
    ],
)
def test_a_broken_entry_point_is_named_and_the_others_work(announce, value, says):
    announce(broken=value, dust="dust:CAPABILITIES")
    lines = []
    with listen(lambda line, done: lines.append(line)):
        assert {"dust", "noise"} <= set(tb.methods()) and "broken" not in tb.methods()
    assert len([line for line in lines if "the entry point broken" in line]) == 1
    with pytest.raises(PluginError, match=f"the entry point broken = .*{says}"):
        tb.method("broken")
    assert tb.method("dust").config.porosity == 0.8


def test_an_entry_point_cannot_take_the_name_of_another_method(announce):
    announce(noise="dust:CAPABILITIES")
    assert tb.methods()["noise"].method.startswith("trabecula.synth.noise")


def test_a_class_that_is_not_there_is_named(announce, monkeypatch):
    import dust

    gone = dataclasses.replace(dust.CAPABILITIES, method="dust:Gone")
    monkeypatch.setattr(dust, "CAPABILITIES", gone)
    announce(dust="dust:CAPABILITIES")
    with pytest.raises(PluginError, match="'dust:Gone', which cannot be imported"):
        tb.method("dust")

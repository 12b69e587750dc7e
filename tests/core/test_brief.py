"""Results in a terminal: short, and with the numbers that a person would look at."""

from dataclasses import dataclass

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.brief import brief, short
from trabecula.synth.api.registry import methods


@dataclass(frozen=True)
class Result:
    values: np.ndarray
    share: float
    mask: np.ndarray | None = None
    names: tuple[str, ...] = ()

    __repr__ = brief


def test_large_arrays_are_shown_by_shape_and_range_small_ones_are_written_out():
    large = Result(
        np.linspace(0, 1, 10**6).reshape(100, 100, 100), 1 / 3, np.ones((100, 100), bool)
    )
    assert (
        repr(large) == "Result(values=<array 100x100x100 float64, 0 .. 1>, share=0.333333, "
        "mask=<array 100x100 bool>)"
    )
    assert (
        repr(Result(np.arange(3), 0.5, names=("pore",)))
        == "Result(values=[0 1 2], share=0.5, names=('pore',))"
    )
    matrix = repr(Result(np.eye(6), 0.5))
    assert matrix.splitlines()[2].strip().startswith("[[1. 0.") and len(matrix.splitlines()) == 10


def test_numbers_are_short():
    assert (
        short(np.float32(0.1)) == "0.1"
        and short({"z": 1 / 7}) == "{'z': 0.142857}"
        and short(np.int64(3)) == "3"
    )


def test_what_a_session_meets_shows_itself_in_a_few_lines(bone):
    cube = tb.crop(bone, 24)
    model = tb.method("noise", reach=6).fit(cube)
    assert repr(tb.method("noise", reach=6)) == "<Method noise: reach=6>"
    assert repr(tb.method("noise")) == "<Method noise: default settings>"
    assert (
        repr(model)
        == "<Model: noise of Image 24x24x24 labels, voxel 40x40x40 um, phases void/solid; reach=6>"
    )
    assert (
        repr(cube.recipe) == "<Recipe: sample bone, crop>"
        and repr(tb.Recipe()) == "<Recipe: nothing known>"
    )
    assert (
        repr(model.facts[0])
        == "<ExemplarInfo 24x24x24 labels, voxel 40x40x40 um, phases void/solid>"
    )
    request = tb.Request(24, mask=np.ones((24, 24, 24), bool), target={"porosity": 0.5})
    assert (
        repr(request)
        == "Request(shape=(24, 24, 24), mask=<array 24x24x24 bool>, target={'porosity': 0.5})"
    )
    assert repr(model.plan(tb.Request(24))).startswith("<Plan ") and "of memory" in repr(
        model.plan(tb.Request(24))
    )


def test_a_model_says_its_name_and_every_method_shows_itself(tmp_path, bone):
    path = tb.method("noise", reach=6).fit(tb.crop(bone, 24)).save(tmp_path / "mine.model")
    assert repr(tb.load_model(path)).startswith("<Model 'mine.model': noise of ")
    for name in methods():
        assert repr(tb.method(name)) == f"<Method {name}: default settings>"


@pytest.mark.parametrize("measured", ["fabric", "orientation", "skeleton_graph"])
def test_figures_with_arrays_take_few_lines(measured, bone):
    shown = repr(getattr(tb.measure, measured)(tb.crop(bone, 24)))
    assert len(shown.splitlines()) <= 30 and len(shown) < 1500

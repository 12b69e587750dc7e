"""Intervals hold the material's own value as often as they say, and shrink with the scan."""

import json
import math
from importlib import import_module

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import confidence
from trabecula.measure.confidence import local_fields, window_spread
from trabecula.measure.mean_variance import SpatialCovariance
from trabecula.measure.registry import DESCRIPTORS
from trabecula.measure.subdivision import variance_share

confidence_module = import_module("trabecula.measure.confidence")


def foam(seed, shape, width=2.0, level=0.0):
    noise = np.random.default_rng(seed).standard_normal(shape)
    field = ndimage.gaussian_filter(noise, width, mode="wrap")
    return tb.Image(field > level * field.std(), "labels", spacing=(0.5,) * len(shape), unit="mm")


def windows(image, side):
    for corner in np.ndindex(*(length // side for length in image.shape)):
        part = tuple(slice(side * at, side * (at + 1)) for at in corner)
        yield tb.Image(image.values[part], "labels", spacing=image.spacing, unit=image.unit)


def test_local_fields_have_the_descriptors_as_means():
    image = foam(0, (30, 26, 34))
    for name, local in local_fields(image, level="quick"):
        one = DESCRIPTORS[name]
        assert local.value == pytest.approx(one.measure(image), rel=1e-6), name
        if name != "chord_length":
            assert local.field.mean() == pytest.approx(local.value, rel=1e-4), name
    assert len(local.field.shape) == 3
    flat = foam(1, (40, 50))
    for name, local in local_fields(flat, level="quick"):
        assert local.value == pytest.approx(DESCRIPTORS[name].measure(flat), rel=1e-6), name


def test_ratios_are_linear_in_small_changes():
    # a ratio over one of two halves differs from that over both by the field's mean there
    image = foam(2, (120, 240))
    chord = dict(local_fields(image, level="quick"))["chord_length"]
    half = tb.Image(image.values[:, :120], "labels", spacing=image.spacing, unit="mm")
    moved = tb.measure.chord_length(half) - chord.value
    assert chord.field[:, :119].mean() == pytest.approx(moved, abs=0.2 * abs(moved) + 1e-3)


@pytest.mark.whole
@pytest.mark.parametrize("name", ["porosity", "specific_surface", "euler_density", "chord_length"])
def test_coverage_of_pictures(name):
    large = foam(3, (1280, 1280), width=3.0, level=0.5)
    truth = DESCRIPTORS[name].measure(large)
    found = [confidence(part, names=[name])[name] for part in windows(large, 128)]
    inside = np.mean([one.low <= truth <= one.high for one in found])
    assert 0.89 <= inside <= 0.99


def test_pore_size_is_freed_from_the_faces():
    large = foam(4, (512, 512))
    truth = tb.measure.pore_size(large)
    parts = list(windows(large, 64))
    plain = np.mean([tb.measure.pore_size(part) for part in parts])
    freed = np.mean([DESCRIPTORS["pore_size"].field(part).value for part in parts])
    assert abs(freed - truth) < 0.7 * abs(plain - truth)


def test_a_larger_scan_has_the_width_that_was_foretold():
    small, large = foam(5, (160, 160)), foam(6, (640, 640))
    first = confidence(small, names=["porosity"])["porosity"]
    second = confidence(large, names=["porosity"])["porosity"]
    assert first.side_for(second.relative) == pytest.approx(640 * 0.5, rel=0.25)
    assert second.side_for(second.relative) == pytest.approx(640 * 0.5, rel=0.01)
    assert second.half_width < first.half_width / 2


def test_phases_without_a_void_have_intervals_of_their_fractions():
    values = np.digitize(foam_field(7, (128, 128)), [-0.4, 0.4])
    image = tb.Image(values, "labels", phases=("a", "b", "c"))
    found = confidence(image)
    assert set(found) == {"fraction_a", "fraction_b", "fraction_c"}
    for name, one in found.items():
        share = np.mean(values == image.phases.index(name[-1]))
        assert one.value == pytest.approx(share)
        assert one.low < share < one.high


def foam_field(seed, shape):
    noise = np.random.default_rng(seed).standard_normal(shape)
    field = ndimage.gaussian_filter(noise, 2.0, mode="wrap")
    return field / field.std()


def test_a_short_image_gets_a_sentence():
    one = confidence(foam(8, (40, 40, 40), width=8.0), names=["porosity"])["porosity"]
    assert one.low is one.high is one.half_width is one.relative is one.side_for(0.1) is None
    assert "too short" in one.note and "scan a side of at least" in one.note
    assert json.loads(json.dumps(one.to_json(), allow_nan=False))["low"] is None
    solid = confidence(np.ones((20, 20), np.uint8))
    assert all("same all over" in one.note for one in solid.values())
    assert solid["pore_size"].value is None


def test_intervals_of_solvers(monkeypatch):
    with pytest.raises(InputError, match="48 voxels a side"):
        confidence(foam(9, (40, 40, 40)), level="full", names=["diffusivity"])
    monkeypatch.setattr(confidence_module, "LEAST_SIDE", 24)
    image = foam(9, (24, 24, 24), width=1.0)
    found = confidence(image, level="full", names=["diffusivity", "diffusivity_z"])
    whole = [tb.measure.diffusivity(image, axis=axis).value for axis in range(3)]
    assert found["diffusivity"].value == pytest.approx(np.mean(whole))
    assert found["diffusivity_z"].value == pytest.approx(whole[0])
    assert found["diffusivity"].by == "subdivision" and found["diffusivity"].freedom == 7
    assert 0 < found["diffusivity"].relative < 0.4


def test_independent_octants_share_the_variance_in_eight():
    grains = np.random.default_rng(0).random((64, 64, 64)) < 0.5
    assert variance_share(SpatialCovariance.of([grains])) == pytest.approx(1 / 8, rel=0.05)
    alike = foam(10, (64, 64, 64), width=4.0).values == 0
    assert variance_share(SpatialCovariance.of([alike])) > 0.14


def test_windows_spread_as_the_theory_says():
    image = foam(11, (96, 96, 96))
    local = dict(local_fields(image, level="quick"))["porosity"]
    spread = window_spread(image, local)
    some = slice(6)
    assert spread.measured[some] == pytest.approx(spread.expected[some], rel=0.12)
    assert len(spread.expected) == 72


def test_wrong_questions():
    image = foam(12, (40, 40))
    with pytest.raises(InputError, match="coverage"):
        confidence(image, coverage=1)
    with pytest.raises(InputError, match="name"):
        confidence(image, names=["porosty"])
    with pytest.raises(InputError, match="no scan reaches"):
        confidence(image)["porosity"].side_for(0)
    assert math.isinf(confidence(image)["mean_curvature"].bounds[0])


def test_a_box_has_the_axes_of_the_fields():
    fields = np.random.default_rng(0).random((1, 40, 40))
    with pytest.raises(InputError, match="has 3 numbers: give one"):
        tb.measure.variance_of_means(fields, (4, 4, 4))

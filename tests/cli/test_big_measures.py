"""`measure` and `export` with --memory: slabs where the whole does not fit, and it says so."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import attempt, trabecula


def smooth_noise(shape):
    noise = np.random.default_rng(5).random(shape)
    for axis in range(3):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    return noise > np.median(noise)


@pytest.fixture
def foam(tmp_path):
    image = tb.Image(smooth_noise((70, 40, 44)), "labels", spacing=2.0, unit="um")
    return tb.write(image, tmp_path / "foam.zarr")


def test_a_volume_that_does_not_fit_is_measured_in_slabs(foam):
    whole = json.loads(trabecula("measure", foam, "--json", "--quick").out)
    slabs = trabecula("measure", foam, "--json", "--quick", "--memory", 0.002)
    assert json.loads(slabs.out) == whole
    assert any("slab by slab" in line and "2.0 MiB" in line for line in slabs.lines)
    assert not trabecula("measure", foam, "--quick").lines


def test_what_is_left_out_is_named(foam):
    found = json.loads(trabecula("measure", foam, "--json", "--memory", 0.002).out)
    assert found["thickness"] is None and any("thickness" in note for note in found["notes"])


def test_a_crop_of_what_does_not_fit_is_measured_as_a_whole(foam):
    crop = ("--crop", 20, "--json")
    assert trabecula("measure", foam, "--memory", 0.002, *crop).out == trabecula("measure", foam, *crop).out


def test_less_memory_than_a_plane_is_refused_in_one_line(foam):
    told = attempt("measure", foam, "--quick", "--memory", 0.0001)
    assert told.status == 2 and "--crop" in told.lines[-1]


def test_the_surface_of_what_does_not_fit_is_the_same_file(tmp_path):
    column = tb.write(tb.Image(smooth_noise((400, 24, 24)), "labels"), tmp_path / "column.zarr")
    whole = trabecula("export", column, "--out", tmp_path / "whole.stl")
    slabs = trabecula("export", column, "--out", tmp_path / "slabs.stl", "--memory", 0.01)
    assert (tmp_path / "slabs.stl").read_bytes() == (tmp_path / "whole.stl").read_bytes()
    assert slabs.out.splitlines()[0].split(": ")[1] == whole.out.splitlines()[0].split(": ")[1]
    assert "not checked" in slabs.out and any("slab by slab" in line for line in slabs.lines)

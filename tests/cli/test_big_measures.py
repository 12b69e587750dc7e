"""`measure` and `export` with --memory: slabs where the whole does not fit, and it says so."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import attempt, refused, trabecula


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


@pytest.mark.whole
def test_what_is_left_out_is_named(foam):
    found = json.loads(trabecula("measure", foam, "--json", "--memory", 0.002).out)
    assert found["anisotropy"] is None and any("anisotropy" in note for note in found["notes"])
    whole = json.loads(trabecula("measure", foam, "--json").out)
    assert found["thickness"] == pytest.approx(whole["thickness"], rel=1e-6)


def test_a_crop_of_what_does_not_fit_is_measured_as_a_whole(foam):
    crop = ("--crop", 20, "--json")
    assert (
        trabecula("measure", foam, "--memory", 0.002, *crop).out
        == trabecula("measure", foam, *crop).out
    )


def test_less_memory_than_a_plane_is_refused_in_one_line(foam):
    told = attempt("measure", foam, "--quick", "--memory", 0.0001)
    assert told.status == 2 and "--crop" in told.lines[-1]


@pytest.mark.whole
def test_the_surface_of_what_does_not_fit_is_the_same_file(tmp_path):
    column = tb.write(tb.Image(smooth_noise((400, 24, 24)), "labels"), tmp_path / "column.zarr")
    whole = trabecula("export", column, "--out", tmp_path / "whole.stl")
    slabs = trabecula("export", column, "--out", tmp_path / "slabs.stl", "--memory", 0.01)
    assert (tmp_path / "slabs.stl").read_bytes() == (tmp_path / "whole.stl").read_bytes()
    assert slabs.out.splitlines()[0].split(": ")[1] == whole.out.splitlines()[0].split(": ")[1]
    assert "not checked" in slabs.out and any("slab by slab" in line for line in slabs.lines)


def test_what_does_not_fit_is_finished_in_slabs_as_the_whole(foam, tmp_path, monkeypatch):
    words = ("finish", foam, "--connect", "--floaters", "--fill")
    whole = trabecula(*words, "--out", tmp_path / "whole.zarr")
    monkeypatch.setattr("trabecula.finish.slabs.in_core_bytes", lambda *words: 1 << 60)
    slabs = trabecula(*words, "--out", tmp_path / "slabs.zarr")
    assert slabs.out.splitlines()[1:] == whole.out.splitlines()[1:] and "connect.joins" in slabs.out
    assert slabs.out.splitlines()[0].split(": ")[1] == whole.out.splitlines()[0].split(": ")[1]
    one, other = (tb.read(tmp_path / name) for name in ("whole.zarr", "slabs.zarr"))
    assert (
        np.array_equal(one.values, other.values) and one.recipe.to_json() == other.recipe.to_json()
    )
    assert any("slab by slab" in line for line in slabs.lines)
    assert trabecula("rerun", tmp_path / "slabs.zarr").sha256 == one.recipe.steps[-1]["sha256"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--connect", "--thicken", 3, "--out", "x.zarr"), "--thicken cannot go slab by slab"),
        (("--smooth", 1, "--prune", "--out", "x.zarr"), "--prune, --smooth cannot go slab by slab"),
        (("--connect", "--out", "x.npy"), "write a .zarr"),
    ],
)
def test_what_cannot_be_finished_in_slabs_says_what_to_do(
    foam, tmp_path, monkeypatch, words, message
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    line = refused("finish", foam, *words, "--memory", 0.0001)
    assert message in line and "raise --memory" in line and "as a whole" in line
    assert sorted(tmp_path.iterdir()) == before


def test_a_finish_that_was_interrupted_is_gone_on_with_by_its_own_command(
    foam, tmp_path, monkeypatch
):
    # As if the whole took more memory than there is; a slab of a volume that is so small does not
    # take less.
    monkeypatch.setattr("trabecula.finish.slabs.in_core_bytes", lambda *words: 1 << 60)

    def stopped(*words, **more):
        raise KeyboardInterrupt

    words = ("finish", foam, "--connect", "--out", tmp_path / "x.zarr")
    with monkeypatch.context() as patch:
        patch.setattr("trabecula.engine.blocks.digest_of", stopped)
        left = attempt(*words)
    assert left.status == 130 and "resumes from x.zarr.part (by the same command)" in left.err
    assert "the same command (trabecula finish ...)" in refused(
        "generate", "--resume", tmp_path / "x.zarr"
    )
    assert "resuming from x.zarr.part" in trabecula(*words).err

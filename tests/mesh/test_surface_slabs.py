"""Writing a surface slab by slab: the same file as of the whole."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trabecula as tb
from trabecula.engine.lazy_volume import as_slabs
from trabecula.mesh.check import check
from trabecula.mesh.files import read_mesh, write_mesh
from trabecula.mesh.slabs import count_layers, export_slabs
from trabecula.mesh.stl import Writer
from trabecula.mesh.surface import mesh


def foam(shape, seed, share=0.5):
    noise = np.random.default_rng(seed).random(shape)
    for axis in range(3):
        noise = noise + np.roll(noise, 1, axis)
    return tb.Image(
        noise >= np.quantile(noise, 1 - share), "labels", spacing=(2.0, 1.0, 1.5), unit="um"
    )


def both_files(folder, image, **how):
    depth = how.pop("depth", None)
    whole = write_mesh(mesh(image, **how), folder / "whole.stl").read_bytes()
    export_slabs(as_slabs(image), folder / "slabs.stl", depth=depth, **how)
    return whole, (folder / "slabs.stl").read_bytes()


@settings(max_examples=40)
@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 6), st.integers(1, 6)),
    seed=st.integers(0, 2**32),
    share=st.sampled_from([0.05, 0.3, 0.6, 1.0]),
    depth=st.integers(1, 12),
    rounds=st.integers(0, 4),
)
def test_slabs_give_the_file_of_the_whole_byte_for_byte(
    tmp_path_factory, shape, seed, share, depth, rounds
):
    image = foam(shape, seed, share)
    whole, slabs = both_files(tmp_path_factory.getbasetemp(), image, depth=depth, smooth=rounds)
    assert slabs == whole


def test_the_usual_smoothing_of_a_named_phase(tmp_path):
    image = foam((70, 12, 11), 5)
    whole, slabs = both_files(tmp_path, image, depth=9, phase="void")
    assert slabs == whole
    found = check(read_mesh(tmp_path / "slabs.stl"))
    assert found.watertight and found.unit == "mm"
    layers = count_layers(as_slabs(image), "void")
    assert (found.vertices, found.faces) == (layers.vertices.sum(), layers.faces.sum())


def test_planes_without_surface_are_left_out(tmp_path):
    values = np.zeros((60, 8, 8), np.uint8)
    values[50:54, 2:5, 2:5] = 1
    seen = []
    volume = as_slabs(tb.Image(values, "labels"))

    def read(box):
        seen.append(box[0])
        return volume.read(box)

    export_slabs(replace(volume, read=read), tmp_path / "slabs.stl", depth=8, smooth=1)
    assert seen == [(0, 60), (44, 59)]  # all planes to count, then those of one slab and its halo


def test_the_forecast_bounds_what_is_taken(tmp_path):
    image = foam((64, 40, 40), 1)
    layers = count_layers(as_slabs(image))
    need = layers.need(16, 4, 42 * 42, Writer.memory)
    tracemalloc.start()
    export_slabs(as_slabs(image), tmp_path / "slabs.stl", depth=16, smooth=2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 0.3 * need.peak < peak < need.peak


def test_what_cannot_be_written_is_refused_and_leaves_what_was_there(tmp_path):
    volume = as_slabs(foam((12, 8, 8), 2))
    path = tmp_path / "part.stl"
    path.write_bytes(b"old")
    empty = as_slabs(tb.Image(np.zeros((4, 4, 4), np.uint8), "labels"))
    for refused, how, word in (
        (volume, {"memory": 1000}, "memory"),
        (empty, {}, "empty"),
        (volume, {"smooth": -1}, "rounds"),
    ):
        with pytest.raises(tb.errors.TrabeculaError, match=word):
            export_slabs(refused, path, **how)
    with pytest.raises(tb.errors.InputError, match="depth"):
        export_slabs(volume, path, depth=0)
    with pytest.raises(tb.errors.InputError, match=r"2\*\*32"):
        Writer.check_count(2**32)
    with pytest.raises(tb.errors.InputError, match="stl"):
        export_slabs(volume, tmp_path / "part.ply")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_a_run_that_breaks_off_leaves_no_half_of_a_file(tmp_path):
    volume = as_slabs(foam((40, 8, 8), 2))

    calls = []

    def read(box):
        calls.append(box)
        if len(calls) > 3:
            raise OSError(28, "No space left on device")
        return volume.read(box)

    with pytest.raises(tb.errors.FileError, match="No space"):
        export_slabs(replace(volume, read=read), tmp_path / "part.stl", depth=8)
    assert not list(tmp_path.iterdir())

"""Finishing slab by slab, memory-mapped: the voxels, reports and recipe of the whole."""

from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.engine import blocks, memmap
from trabecula.engine.lazy_volume import as_slabs
from trabecula.errors import InputError, MemoryBudgetError, UnknownNameError
from trabecula.finish import OPERATIONS, connect
from trabecula.finish import slabs as finishing
from trabecula.finish.slabs import finish_slabs
from trabecula.io.lazy import open_slabs
from trabecula.measure import near_joins, runs


def grains(shape, seed=1, phases=2):
    """Return grains, many of them loose, with holes in them, and specks."""
    noise = np.random.default_rng(seed).random(shape)
    for axis in range(3):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    values = (noise > np.quantile(noise, 0.75)).astype(np.uint8)
    if phases == 3:
        values[:, :, shape[2] // 2 :] *= 2
    return values


@pytest.fixture
def thin(monkeypatch):
    """Map every array into memory, in slabs of three planes, on two threads."""
    monkeypatch.setattr(runs, "_MANY", 1)
    monkeypatch.setenv("TRABECULA_THREADS", "2")
    monkeypatch.setattr(memmap, "SMALLEST", 1)
    mapped = partial(memmap.map_large_arrays, thickest=3)
    monkeypatch.setattr(finishing.memmap, "map_large_arrays", mapped)
    monkeypatch.setattr(near_joins, "SIDE", 9)


CASES = {
    "connect": [("connect", {})],
    "connect near": [("connect", {"reach": 5})],
    "connect far": [("connect", {"reach": 12, "brush": 1, "min_size": 0, "connectivity": 26})],
    "pores": [("connect", {"phase": "void", "reach": 3})],
    "floaters": [("remove_floaters", {"smaller_than": 40})],
    "fill": [("fill_trapped", {"connectivity": 6})],
    "all": [
        ("connect", {"reach": 2, "min_size": 5}),
        ("remove_floaters", {}),
        ("fill_trapped", {}),
    ],
}


@pytest.mark.parametrize("name", CASES)
def test_the_store_is_that_of_the_whole(thin, tmp_path, name):
    tb.write(tb.Image(grains((37, 30, 41)), "labels", (2.0, 1.0, 1.0), "um"), tmp_path / "in.zarr")
    image = tb.read(tmp_path / "in.zarr")
    for operation, given_settings in CASES[name]:
        image = OPERATIONS[operation](image, **given_settings)
        assert sum(value for value in image.recipe.steps[-1]["report"].values()) > 0, (
            "nothing to do"
        )
    recipe = finish_slabs(open_slabs(tmp_path / "in.zarr"), tmp_path / "out.zarr", CASES[name])
    found = tb.read(tmp_path / "out.zarr")
    assert np.array_equal(found.values, image.values)
    assert recipe.to_json() == found.recipe.to_json() == image.recipe.to_json()
    assert (found.spacing, found.unit, found.phases) == (image.spacing, image.unit, image.phases)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.zarr", "out.zarr"]


@pytest.mark.whole
def test_one_phase_of_three_and_coarser_levels(thin, tmp_path):
    image = tb.Image(grains((40, 30, 300), phases=3), "labels", phases=("void", "a", "b"))
    finish_slabs(
        as_slabs(image),
        tmp_path / "out.zarr",
        [("connect", {"phase": "a"}), ("fill_trapped", {"phase": "b"})],
    )
    whole = tb.finish.fill_trapped(connect(image, phase="a"), phase="b")
    tb.write(whole, tmp_path / "whole.zarr")
    for level in (0, 1):
        values = tb.read(tmp_path / "out.zarr", level=level).values
        assert np.array_equal(values, tb.read(tmp_path / "whole.zarr", level=level).values)


def test_pores_between_two_phases_need_the_whole(thin, tmp_path):
    image = tb.Image(grains((20, 20, 20), phases=3), "labels", phases=("void", "a", "b"))
    with pytest.raises(InputError, match="pores among a, b take the nearest"):
        finish_slabs(as_slabs(image), tmp_path / "out.zarr", [("fill_trapped", {})])
    assert not list(tmp_path.iterdir())


@pytest.mark.whole
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=4, max_side=12)),
    st.integers(0, 2**32),
    st.integers(1, 5),
    st.integers(1, 4),
)
def test_the_shortest_join_does_not_depend_on_the_blocks_it_is_sought_in(solid, seed, reach, side):
    # Beside hypothesis' own, volumes of few large parts: two halves with a rough gap between.
    rng = np.random.default_rng(seed)
    rough = rng.random(solid.shape) < 0.3
    gap = solid.shape[-1] // 2
    apart = np.arange(solid.shape[-1]) != gap
    for values in (solid, ~rough & apart, rough | solid):
        if values.any():
            wanted = {"reach": reach, "brush": 1, "min_size": 0}
            whole = connect(values, **wanted)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(near_joins, "SIDE", side)
                found = connect(values, **wanted)
            assert np.array_equal(found.values, whole.values)
            assert found.recipe.steps[-1] == whole.recipe.steps[-1]


def test_a_run_that_was_interrupted_writes_the_rest(tmp_path, monkeypatch):
    image = tb.Image(grains((40, 150, 30)), "labels")
    real, done = blocks.do_task, []

    def stop(task, *words, **more):
        if len(done) == 1:
            raise KeyboardInterrupt
        done.append(task)
        real(task, *words, **more)

    monkeypatch.setattr(blocks, "do_task", stop)
    with pytest.raises(KeyboardInterrupt):
        finish_slabs(as_slabs(image), tmp_path / "out.zarr", CASES["connect"])
    assert [path.name for path in tmp_path.iterdir()] == ["out.zarr.part"]
    monkeypatch.setattr(
        blocks,
        "do_task",
        lambda task, *words, **more: (done.append(task), real(task, *words, **more)),
    )
    finish_slabs(as_slabs(image), tmp_path / "out.zarr", CASES["connect"])
    assert len(done) == len(set(done)) == 2
    assert np.array_equal(tb.read(tmp_path / "out.zarr").values, connect(image).values)


def test_refusals_leave_nothing(tmp_path):
    volume = as_slabs(tb.Image(grains((40, 30, 30)), "labels"))
    for steps, path, error, words in (
        ([("thicken", {})], "out.zarr", UnknownNameError, "operation in slabs"),
        ([("connect", {"far": 3})], "out.zarr", UnknownNameError, "setting of connect"),
        ([("connect", {"reach": -1})], "out.zarr", InputError, "reach -1"),
        ([], "out.zarr", InputError, "nothing to do"),
        (CASES["connect"], "out.npy", InputError, "name it so"),
    ):
        with pytest.raises(error, match=words):
            finish_slabs(volume, tmp_path / path, steps)
    with pytest.raises(MemoryBudgetError, match="--level 1"):
        finish_slabs(volume, tmp_path / "out.zarr", CASES["connect"], memory=1 << 16)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_told_and_nothing_left(tmp_path, monkeypatch):
    def full(*words):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memmap, "SMALLEST", 1)
    monkeypatch.setattr(memmap.os, "posix_fallocate", full, raising=False)
    with pytest.raises(
        tb.errors.FileError, match="No space left on device; scratch files of up to six times"
    ):
        finish_slabs(
            as_slabs(tb.Image(grains((40, 30, 30)), "labels")),
            tmp_path / "out.zarr",
            CASES["connect"],
        )
    assert not list(tmp_path.iterdir())

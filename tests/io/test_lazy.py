"""Stores read plane by plane mean what they mean when read as a whole."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import FileError
from trabecula.io.lazy import open_slabs, volume_shape


@pytest.fixture
def foam() -> tb.Image:
    values = np.random.default_rng(2).integers(0, 3, (70, 9, 8)).astype(np.uint8)
    return tb.Image(
        values, "labels", spacing=(2.0, 1.0, 1.0), unit="um", phases=("void", "solid", "binder")
    )


def whole_of(volume):
    return np.concatenate([slab.values for slab in volume.slabs(volume.grain)])


def check_same(volume, image):
    assert np.array_equal(whole_of(volume), image.values)
    for name in ("shape", "spacing", "unit", "phases"):
        assert getattr(volume, name) == getattr(image, name)
    assert volume.recipe.to_json() == image.recipe.to_json()


@pytest.mark.parametrize(
    "options", [{}, {"spacing": 3.0, "unit": "mm"}, {"phases": ("void", "bone", "glue")}]
)
def test_a_store_of_ours(foam, tmp_path, options):
    path = tb.write(foam, tmp_path / "foam.zarr")
    check_same(open_slabs(path, **options), tb.read(path, **options))
    assert volume_shape(path) == (70, 9, 8) and volume_shape(tmp_path) is None


def test_a_coarser_level(tmp_path):
    values = np.random.default_rng(4).integers(0, 2, (300, 9, 8)).astype(np.uint8)
    path = tb.write(tb.Image(values, "labels", spacing=2.0, unit="um"), tmp_path / "foam.zarr")
    check_same(open_slabs(path, level=1), tb.read(path, level=1))
    assert volume_shape(path, level=1) == (150, 5, 4)


@pytest.mark.parametrize("levels", [(0, 255), (0, 100, 255), (-1, 7, 300)])
@pytest.mark.parametrize("lead", [(), (1, 1)])
def test_a_store_of_another_program(foam, tmp_path, levels, lead):
    import zarr

    values = np.array(levels, np.int16 if min(levels) < 0 else np.uint8)[foam.values % len(levels)]
    zarr.save_array(str(tmp_path / "foam.zarr"), values.reshape(lead + values.shape))
    check_same(open_slabs(tmp_path / "foam.zarr"), tb.read(tmp_path / "foam.zarr"))


@pytest.mark.parametrize("chunks", [(3, 5, 7), (16, 4, 4), (70, 9, 1)])
@pytest.mark.parametrize("depth", [4, 17])
def test_figures_depend_neither_on_chunks_nor_on_slabs(foam, tmp_path, chunks, depth):
    import zarr

    values = (foam.values > 0).astype(np.uint8)
    array = zarr.create_array(
        str(tmp_path / "foam.zarr"), shape=values.shape, dtype=values.dtype, chunks=chunks
    )
    array[...] = values
    volume = open_slabs(tmp_path / "foam.zarr")
    assert tb.measure.describe_slabs(volume, depth=depth, level="quick") == tb.describe(
        values, level="quick"
    )


def test_truth_values_are_labels(foam, tmp_path):
    import zarr

    zarr.save_array(str(tmp_path / "foam.zarr"), foam.values > 0)
    check_same(open_slabs(tmp_path / "foam.zarr"), tb.read(tmp_path / "foam.zarr"))


def test_only_labels_of_one_volume_are_read_so(foam, tmp_path):
    grey = tb.write(
        tb.Image(np.random.default_rng(0).random((6, 5, 4)), "grey"), tmp_path / "grey.zarr"
    )
    few = tb.write(tb.Image(foam.values, "grey"), tmp_path / "few.zarr")
    flat = tb.write(tb.Image(foam.values[0], "labels"), tmp_path / "flat.zarr")
    colour = tb.write(
        tb.Image(np.zeros((6, 5, 4, 3), np.uint8), "colour"), tmp_path / "colour.zarr"
    )
    for path, word in ((grey, "segment"), (few, "segment"), (flat, "volume"), (colour, "volume")):
        with pytest.raises(tb.errors.InputError, match=word):
            open_slabs(path)
    assert volume_shape(flat) is None and volume_shape(colour) is None
    assert open_slabs(few, kind="labels").phases == ("void", "solid", "phase2")
    with pytest.raises(tb.errors.InputError, match="Zarr"):
        open_slabs(tb.write(foam, tmp_path / "foam.npy"))


def test_a_missing_chunk_is_told_before_anything_is_measured(foam, tmp_path):
    path = tb.write(foam, tmp_path / "foam.zarr")
    next(file for file in (path / "0" / "c").rglob("*") if file.is_file()).unlink()
    with pytest.raises(tb.errors.FileError, match="missing"):
        open_slabs(path)


def test_a_lost_chunk_is_not_read_as_zeros(foam, tmp_path):
    path = tb.write(foam, tmp_path / "foam.zarr")
    next(file for file in (path / "0" / "c").rglob("*") if file.is_file()).unlink()
    with pytest.raises(FileError, match="chunks are missing"):
        open_slabs(path)

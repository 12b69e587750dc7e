"""Zarr stores: as zarr and OME see them, and what a store says that is not finished."""

import json

import numpy as np
import pytest
import zarr

import trabecula as tb
from trabecula.core.errors import FileError
from trabecula.engine import store

VALUES = np.arange(3 * 130 * 5, dtype=np.uint16).reshape(3, 130, 5)


def written(tmp_path, values=VALUES, kind="grey"):
    return tb.write(tb.Image(values, kind, spacing=(2.5, 0.1, 0.3), unit="um"), tmp_path / "x.zarr")


def test_as_zarr_and_ome_see_it(tmp_path):
    path = written(tmp_path)
    group = zarr.open_group(path, mode="r")
    assert group.metadata.zarr_format == 3
    np.testing.assert_array_equal(group["0"][...], VALUES)
    assert group["0"].chunks == (3, 128, 5) and group["0"].metadata.dimension_names == ("z", "y", "x")
    multiscale = group.attrs["ome"]["multiscales"][0]
    assert group.attrs["ome"]["version"] == "0.5"
    assert multiscale["axes"] == [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    assert multiscale["datasets"] == [
        {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [2.5, 0.1, 0.3]}]}
    ]
    assert group.attrs["trabecula"]["complete"] is True


def test_colour_is_a_channel_before_space(tmp_path):
    values = np.arange(2 * 3 * 4 * 3, dtype=np.uint8).reshape(2, 3, 4, 3)
    group = zarr.open_group(written(tmp_path, values, "colour"), mode="r")
    np.testing.assert_array_equal(group["0"][...], np.moveaxis(values, -1, 0))
    multiscale = group.attrs["ome"]["multiscales"][0]
    assert [axis["type"] for axis in multiscale["axes"]] == ["channel", "space", "space", "space"]
    assert multiscale["datasets"][0]["coordinateTransformations"][0]["scale"] == [1.0, 2.5, 0.1, 0.3]


def test_a_store_without_our_mark_or_unfinished_is_refused(tmp_path):
    fields = {"kind": "grey", "spacing": [1, 1, 1], "unit": "voxel", "phases": [], "recipe": []}
    group, array = store.create(
        tmp_path / "x.zarr", (2, 3, 4), np.dtype("u1"), scale=(1, 1, 1), unit=None, fields=fields
    )
    array[...] = 7
    with pytest.raises(FileError, match="did not finish"):
        tb.read(tmp_path / "x.zarr")
    store.finish(group)
    assert tb.read(tmp_path / "x.zarr").values.sum() == 7 * 24
    zarr.create_array(tmp_path / "group.zarr/0", shape=(2, 2), dtype="u1")
    zarr.create_group(tmp_path / "group.zarr")
    with pytest.raises(FileError, match="nothing says that it is complete"):
        tb.read(tmp_path / "group.zarr")


def test_a_lost_chunk_is_not_read_as_zeros(tmp_path):
    path = written(tmp_path)
    (path / "0" / "c" / "0" / "1" / "0").unlink()
    with pytest.raises(FileError, match="1 of its 2 chunks are missing"):
        tb.read(path)


def test_chunks_of_zeros_are_written(tmp_path):
    path = written(tmp_path, np.zeros_like(VALUES))
    assert len(list((path / "0" / "c").rglob("*"))) == 1 + 2 + 2  # folders along z and y, and a file each


def test_a_store_is_replaced_whole(tmp_path):
    written(tmp_path)
    path = written(tmp_path, VALUES[:, :5])
    assert tb.read(path).shape == (3, 5, 5)
    assert json.loads((path / "zarr.json").read_text())["zarr_format"] == 3
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]

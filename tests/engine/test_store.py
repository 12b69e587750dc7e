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


def test_an_unfinished_store_is_refused(tmp_path):
    fields = {"kind": "grey", "spacing": [1, 1, 1], "unit": "voxel", "phases": [], "recipe": []}
    group, array = store.create(
        tmp_path / "x.zarr", (2, 3, 4), np.dtype("u1"), scale=(1, 1, 1), unit=None, fields=fields
    )
    array[...] = 7
    with pytest.raises(FileError, match="did not finish"):
        tb.read(tmp_path / "x.zarr")
    store.finish(group)
    assert tb.read(tmp_path / "x.zarr").values.sum() == 7 * 24


def voxels():
    return np.random.default_rng(0).integers(0, 3, (4, 5, 6)).astype(np.uint8)


def test_a_plain_array_of_somebody_else_is_read(tmp_path):
    zarr.create_array(tmp_path / "a.zarr", data=voxels(), chunks=(2, 2, 2))
    image = tb.read(tmp_path / "a.zarr", spacing=2, unit="um")
    assert np.array_equal(image.values, voxels())
    assert (image.kind, image.spacing, image.unit) == ("labels", (2, 2, 2), "um")


@pytest.mark.parametrize(("version", "form"), [("0.4", 2), ("0.5", 3)])
def test_ome_zarr_of_somebody_else_keeps_its_scale(version, form, tmp_path):
    axes = [{"name": "c", "type": "channel"}] + [
        {"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"
    ]
    datasets = [
        {"path": path, "coordinateTransformations": [{"type": "scale", "scale": [1, 4 * f, 2 * f, 3 * f]}]}
        for path, f in (("fine", 1), ("coarse", 2))
    ]
    ome = {"version": version, "multiscales": [{"axes": axes, "datasets": datasets}]}
    group = zarr.create_group(tmp_path / "o.zarr", zarr_format=form, attributes={"ome": ome} if form == 3 else ome)
    group.create_array("fine", data=voxels()[None], chunks=(1, 2, 3, 4))
    group.create_array("coarse", data=voxels()[None, ::2, ::2, ::2], chunks=(1, 2, 3, 4))
    image = tb.read(tmp_path / "o.zarr")
    assert np.array_equal(image.values, voxels())
    assert (image.spacing, image.unit) == ((4, 2, 3), "um")


def test_what_is_open_in_somebody_elses_store_is_said(tmp_path):
    group = zarr.create_group(tmp_path / "two.zarr")
    group.create_array("one", data=voxels())
    group.create_array("two", data=voxels())
    with pytest.raises(FileError, match="one, two"):
        tb.read(tmp_path / "two.zarr")
    zarr.create_array(tmp_path / "times.zarr", data=np.stack([voxels()] * 2))
    with pytest.raises(FileError, match="times or channels"):
        tb.read(tmp_path / "times.zarr")


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

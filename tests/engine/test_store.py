"""Zarr stores: as zarr and OME see them, and what a store says that is not finished."""

import json

import numpy as np
import pytest
import zarr

import trabecula as tb
from trabecula.core.errors import FileError, InputError
from trabecula.engine import store
from trabecula.engine.multiscale import halve_resolution

VALUES = np.arange(3 * 130 * 5, dtype=np.uint16).reshape(3, 130, 5)


def written(tmp_path, values=VALUES, kind="grey"):
    return tb.write(tb.Image(values, kind, spacing=(2.5, 0.1, 0.3), unit="um"), tmp_path / "x.zarr")


def test_as_zarr_and_ome_see_it(tmp_path):
    path = written(tmp_path)
    group = zarr.open_group(path, mode="r")
    assert group.metadata.zarr_format == 3
    np.testing.assert_array_equal(group["0"][...], VALUES)
    assert group["0"].shards == (3, 128, 5) and group["0"].chunks == (3, 64, 5)
    assert group["0"].metadata.dimension_names == ("z", "y", "x")
    multiscale = group.attrs["ome"]["multiscales"][0]
    assert group.attrs["ome"]["version"] == "0.5"
    assert multiscale["axes"] == [
        {"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"
    ]
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
    assert multiscale["datasets"][0]["coordinateTransformations"][0]["scale"] == [
        1.0,
        2.5,
        0.1,
        0.3,
    ]


def test_an_unfinished_store_is_refused(tmp_path):
    fields = {"kind": "grey", "spacing": [1, 1, 1], "unit": "voxel", "phases": [], "recipe": []}
    group, (array,) = store.create(
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
        {
            "path": path,
            "coordinateTransformations": [{"type": "scale", "scale": [1, 4 * f, 2 * f, 3 * f]}],
        }
        for path, f in (("fine", 1), ("coarse", 2))
    ]
    ome = {"version": version, "multiscales": [{"axes": axes, "datasets": datasets}]}
    group = zarr.create_group(
        tmp_path / "o.zarr", zarr_format=form, attributes={"ome": ome} if form == 3 else ome
    )
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
    # folders along z and y, and a file each
    assert len(list((path / "0" / "c").rglob("*"))) == 1 + 2 + 2


def test_a_store_is_replaced_whole(tmp_path):
    written(tmp_path)
    path = written(tmp_path, VALUES[:, :5])
    assert tb.read(path).shape == (3, 5, 5)
    assert json.loads((path / "zarr.json").read_text())["zarr_format"] == 3
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def levelled(tmp_path, values, kind, chunk, monkeypatch):
    monkeypatch.setattr(store, "CHUNK", chunk)
    return tb.write(tb.Image(values, kind, spacing=(2.0, 1.0, 3.0), unit="um"), tmp_path / "x.zarr")


def test_levels_as_zarr_and_ome_see_them(tmp_path, monkeypatch):
    path = levelled(tmp_path, np.zeros((9, 70, 33), np.uint8), "labels", 16, monkeypatch)
    group = zarr.open_group(path, mode="r")
    assert [group[str(level)].shape for level in range(3)] == [(9, 70, 33), (5, 35, 17), (3, 18, 9)]
    assert len(list(group.arrays())) == 3
    datasets = group.attrs["ome"]["multiscales"][0]["datasets"]
    assert [one["path"] for one in datasets] == ["0", "1", "2"]
    for level, one in enumerate(datasets):
        scale, *shift = one["coordinateTransformations"]
        assert scale == {"type": "scale", "scale": [2.0 * 2**level, 1.0 * 2**level, 3.0 * 2**level]}
        # The corner of the volume, half a voxel before the centre of its first, is the same of
        # every level.
        centre = np.array(shift[0]["translation"] if shift else [0, 0, 0])
        assert (centre - np.array(scale["scale"]) / 2).tolist() == [-1.0, -0.5, -1.5]


@pytest.mark.parametrize("kind", ["labels", "grey", "colour"])
def test_a_level_is_read_as_an_image_of_larger_voxels(tmp_path, monkeypatch, kind):
    shape = (20, 40, 34, 3) if kind == "colour" else (20, 40, 34)
    values = np.random.default_rng(0).integers(0, 3, shape).astype(np.uint8)
    path = levelled(tmp_path, values, kind, 16, monkeypatch)
    image = tb.read(path, level=1)
    assert (image.shape, image.kind, image.spacing, image.unit) == (
        (10, 20, 17),
        kind,
        (4, 2, 6),
        "um",
    )
    channels = np.moveaxis(values, -1, 0) if kind == "colour" else values[None]
    expected = np.stack([halve_resolution(one, labels=kind == "labels") for one in channels])
    assert np.array_equal(
        image.values, np.moveaxis(expected, 0, -1) if kind == "colour" else expected[0]
    )
    assert (image.recipe.steps[-1]["verb"], image.recipe.steps[-1]["options"]) == (
        "read",
        {"level": 1},
    )
    assert np.array_equal(tb.read(path).values, values) and not tb.read(path).recipe.steps[-1].get(
        "options"
    )


def test_a_level_that_is_not_there_is_refused(tmp_path, monkeypatch):
    path = levelled(tmp_path, np.zeros((20, 40, 34), np.uint8), "labels", 16, monkeypatch)
    with pytest.raises(InputError, match=r"levels 0 \(the finest\) to 1: got level 2"):
        tb.read(path, level=2)
    for level in (-1, 0.5, "1"):
        with pytest.raises(InputError, match="level"):
            tb.read(path, level=level)
    tb.write(tb.read(path), tmp_path / "x.npy")
    with pytest.raises(InputError, match=r"NumPy, which has no coarser levels"):
        tb.read(tmp_path / "x.npy", level=1)
    zarr.create_array(tmp_path / "a.zarr", data=voxels())
    with pytest.raises(InputError, match="one level, 0: got level 1"):
        tb.read(tmp_path / "a.zarr", level=1)


def test_a_level_of_somebody_elses_image(tmp_path):
    datasets = [
        {
            "path": path,
            "coordinateTransformations": [{"type": "scale", "scale": [4 * f, 2 * f, 3 * f]}],
        }
        for path, f in (("fine", 1), ("coarse", 2))
    ]
    axes = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    ome = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": datasets}]}
    group = zarr.create_group(tmp_path / "o.zarr", attributes={"ome": ome})
    group.create_array("fine", data=voxels())
    group.create_array("coarse", data=voxels()[::2, ::2, ::2])
    image = tb.read(tmp_path / "o.zarr", level=1)
    assert np.array_equal(image.values, voxels()[::2, ::2, ::2]) and image.spacing == (8, 4, 6)


def test_a_store_that_is_not_there_yet_is_said_to_be_unfinished(tmp_path):
    (tmp_path / "x.zarr.part").mkdir()
    with pytest.raises(FileError, match=r"x\.zarr is not finished: trabecula generate --resume"):
        tb.read(tmp_path / "x.zarr")

"""Missing, empty, truncated, huge by their header, half-written: one line of ours, never half a
file.
"""

import json
import struct
import zlib

import nibabel
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from io_images import VOLUMES, same

import trabecula as tb
from trabecula.core.errors import FileError, InputError, MemoryBudgetError, TrabeculaError
from trabecula.core.recipe import Recipe

RNG = np.random.default_rng(3)
LABELS = RNG.integers(0, 3, (4, 6, 7)).astype(np.uint8)
WIDE = RNG.integers(0, 2**30, (4, 6, 7)).astype(np.int32)


def volume(values=LABELS, kind="labels"):
    return tb.Image(
        values,
        kind,
        spacing=(3, 2, 1),
        unit="um",
        recipe=Recipe().then("made", values, note="n" * 50),
    )


def picture(kind):
    return (
        tb.Image(LABELS[0], "labels")
        if kind == "labels"
        else tb.Image(np.dstack([WIDE[0] % 256] * 3).astype(np.uint8), "colour")
    )


CASES = {
    f"{kind} x{suffix}": (image, f"x{suffix}")
    for kind, image in {"labels": volume(), "int32": volume(WIDE, "grey")}.items()
    for suffix in VOLUMES
}
CASES |= {
    f"{kind} {name}": (picture(kind), name)
    for kind in ("labels", "colour")
    for name in ("x.png", "x.bmp")
}
CASES |= {"colour x.jpg": (picture("colour"), "x.jpg"), "slices": (volume(), "x/")}


@pytest.mark.parametrize("case", CASES)
def test_truncated_anywhere(case, tmp_path):
    """Cut any file at any byte: an error of ours in one line, or exactly the same image."""
    image, name = CASES[case]
    path = f"{tmp_path}/{name}"
    tb.write(image, path)
    whole = tb.read(path)
    files = sorted(file for file in tmp_path.rglob("*") if file.is_file())
    contents = {file: file.read_bytes() for file in files}

    @settings(
        max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
    )
    @given(st.data())
    def cut(data):
        file = data.draw(st.sampled_from(files))
        length = data.draw(st.integers(0, len(contents[file]) - 1))
        file.write_bytes(contents[file][:length])
        try:
            same(tb.read(path), whole)
        except TrabeculaError as error:
            assert "\n" not in str(error) and len(str(error)) > 20
        finally:
            file.write_bytes(contents[file])

    cut()


@pytest.mark.parametrize("case", [case for case in CASES if case.startswith("labels")])
def test_any_byte_changed(case, tmp_path):
    """Change one byte: a voxel or the meaning may differ, but no library's exception comes out."""
    image, name = CASES[case]
    path = f"{tmp_path}/{name}"
    tb.write(image, path)
    files = sorted(file for file in tmp_path.rglob("*") if file.is_file())
    contents = {file: file.read_bytes() for file in files}

    @settings(
        max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
    )
    @given(st.data())
    def change(data):
        file = data.draw(st.sampled_from(files))
        bytes_ = bytearray(contents[file])
        bytes_[data.draw(st.integers(0, len(bytes_) - 1))] = data.draw(st.integers(0, 255))
        file.write_bytes(bytes_)
        try:
            assert tb.read(path).values.dtype.kind in "uif"
        except TrabeculaError as error:
            assert "\n" not in str(error)
        finally:
            file.write_bytes(contents[file])

    change()


def test_not_there(tmp_path):
    np.save(tmp_path / "femur.npy", LABELS)
    with pytest.raises(FileError, match=r"did you mean femur\.npy\?"):
        tb.read(tmp_path / "femut.npy")
    with pytest.raises(FileError, match="no folder"):
        tb.read(tmp_path / "nowhere" / "x.tif")
    with pytest.raises(tb.errors.UnknownNameError, match=r"did you mean '\.tiff?'"):
        tb.write(LABELS, tmp_path / "x.tff")
    with pytest.raises(tb.errors.UnknownNameError, match="ends in '/'"):
        tb.write(LABELS, tmp_path / "x")


@pytest.mark.parametrize("suffix", [*VOLUMES, ".png", ".jpg", ".bmp"])
def test_empty_foreign_or_of_the_other_sort(suffix, tmp_path):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"")
    with pytest.raises(FileError, match="is empty"):
        tb.read(path)
    path.write_bytes(b"a letter to nobody, long enough to be a header of one kind or another" * 20)
    with pytest.raises(FileError, match=r"cannot read .* as "):
        tb.read(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(FileError, match="cannot read"):
        tb.read(path)


def npy(shape):
    header = str({"descr": "<u2", "fortran_order": False, "shape": shape}).ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + b"\0" * 64


def png(side):
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    pixels = b"IDAT" + zlib.compress(b"\0" * 64)
    chunks = [
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in (head, pixels, b"IEND")
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def tif(side):
    entries = [
        (256, 4, 1, side),
        (257, 4, 1, side),
        (258, 3, 1, 8),
        (259, 3, 1, 8),
        (262, 3, 1, 1),
        (273, 4, 1, 8),
        (277, 3, 1, 1),
        (278, 4, 1, side),
        (279, 4, 1, 64),
    ]
    return (
        b"II*\0"
        + struct.pack("<I", 72)
        + b"\0" * 64
        + struct.pack("<H", len(entries))
        + b"".join(struct.pack("<HHII", *entry) for entry in entries)
        + b"\0" * 4
    )


def nii():
    header = nibabel.Nifti1Header()
    header.set_data_shape((30000, 30000, 30000))
    header.set_data_dtype(np.int16)
    header["magic"], header["vox_offset"] = b"n+1", 352
    return header.binaryblock + b"\0" * 100


VTI = (
    '<VTKFile type="ImageData" byte_order="LittleEndian"><ImageData WholeExtent="{0}"><Piece '
    'Extent="{0}"><CellData>'
    '<DataArray type="Float64" '
    'format="binary">AAAA</DataArray></CellData></Piece></ImageData></VTKFile>'
)
SIDES = b"100000 100000 100000"
HUGE = {
    "x.npy": npy((10**5, 10**5, 10**5)),
    "x.png": png(2**31 - 1),
    "x.tif": tif(2**31),
    "x.nii": nii(),
    "x.nrrd": b"NRRD0004\ntype: short\ndimension: 3\nsizes: "
    + SIDES
    + b"\nendian: little\nencoding: gzip\n\n\x1f\x8b",
    "x.mha": b"NDims = 3\nDimSize = "
    + SIDES
    + b"\nElementType = MET_SHORT\nCompressedData = True\nElementDataFile = LOCAL\nxx",
    "y.mha": b"NDims = 3\nDimSize = 100 100 100\nElementType = MET_SHORT\nElementDataFile = "
    b"LOCAL\nxx",
    "x.vti": VTI.format("0 100000 0 100000 0 100000").encode(),
}


@pytest.mark.parametrize("name", HUGE)
def test_huge_by_its_header(name, tmp_path, monkeypatch):
    """Refuse it before anything of that size is allocated."""

    def record(shape, *args, **options):
        raise AssertionError(f"allocated {shape}")

    (tmp_path / name).write_bytes(HUGE[name])
    monkeypatch.setattr(np, "empty", record)
    monkeypatch.setattr(np, "zeros", record)
    with pytest.raises((FileError, MemoryBudgetError), match=r"claims|greater than file size"):
        tb.read(tmp_path / name)


def test_more_than_the_memory_that_is_free(tmp_path, monkeypatch):
    paths = [tb.write(volume(), f"{tmp_path}/x{suffix}") for suffix in (*VOLUMES, "/")]
    monkeypatch.setattr("trabecula.io.guard.available_memory", lambda: LABELS.nbytes - 1)
    for path in paths:
        with pytest.raises(MemoryBudgetError, match="only 167 B of memory are free"):
            tb.read(path)


@pytest.mark.parametrize("suffix", [*VOLUMES, ".png", ".bmp", "/"])
def test_an_interrupted_write_leaves_the_old_file(suffix, tmp_path, monkeypatch):
    flat = suffix in (".png", ".bmp")
    old = (
        tb.Image(LABELS[0], "labels", recipe=Recipe().then("made", LABELS[0])) if flat else volume()
    )
    path = f"{tmp_path}/x{suffix}"
    tb.write(old, path)
    before = sorted(entry.name for entry in tmp_path.rglob("*"))

    class StoppedError(Exception):
        pass

    def stop(source, target):
        raise StoppedError

    # The last moment at which a write can die: everything is written, nothing is in place.
    monkeypatch.setattr("trabecula.engine.files.put_in_place", stop)
    with pytest.raises(StoppedError):
        tb.write(tb.Image(1 - np.minimum(old.values, 1), "labels"), path)
    monkeypatch.undo()
    assert sorted(entry.name for entry in tmp_path.rglob("*")) == before
    same(tb.read(path), old)


@pytest.mark.parametrize("suffix", [*VOLUMES, "/"])
def test_a_disk_that_fills_up(suffix, tmp_path, monkeypatch):
    def full(self, *args, **options):
        raise OSError(28, "No space left on device")

    for owner in (
        "pathlib.Path.write_text",
        "pathlib.Path.open",
        "nrrd.write",
        "tifffile.TiffWriter.write",
    ):
        monkeypatch.setattr(owner, full)
    monkeypatch.setattr("nibabel.Nifti1Image.to_filename", full)
    monkeypatch.setattr("trabecula.engine.store.create", full)
    with pytest.raises(FileError, match="No space left"):
        tb.write(volume(), f"{tmp_path}/x{suffix}")
    monkeypatch.undo()
    assert not list(tmp_path.rglob("*x*"))


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileError, match="cannot write"):
        tb.write(LABELS, tmp_path / "file" / "x.tif")
    (tmp_path / "taken.tif").mkdir()
    (tmp_path / "taken.zarr").mkdir()
    for name in ("taken.tif", "taken.zarr"):
        (tmp_path / name / "thesis.txt").write_text("years")
        with pytest.raises(FileError, match="choose another name"):
            tb.write(LABELS, tmp_path / name)
    with pytest.raises(FileError, match="holds other files"):
        tb.write(LABELS, f"{tmp_path}/")  # a folder of results is never replaced by slices
    assert (tmp_path / "taken.zarr" / "thesis.txt").read_text() == "years"


def test_a_sidecar_of_other_voxels(tmp_path):
    path = tb.write(volume(), tmp_path / "x.npy")
    np.save(path, LABELS[::-1])
    with pytest.raises(FileError, match="describes other voxels"):
        tb.read(path)
    (tmp_path / "x.npy.json").unlink()
    assert tb.read(path).kind == "labels"


def test_metadata_that_make_no_sense(tmp_path):
    path = tb.write(volume(), tmp_path / "x.npy")
    sidecar = tmp_path / "x.npy.json"
    good = json.loads(sidecar.read_text())
    for name, value in {"kind": "pink", "recipe": [1], "spacing": "one", "unit": None}.items():
        sidecar.write_text(json.dumps({**good, "trabecula": {**good["trabecula"], name: value}}))
        with pytest.raises(FileError, match="metadata are damaged"):
            tb.read(path)
    sidecar.write_text(json.dumps({**good, "trabecula": {**good["trabecula"], "spacing": [1, 2]}}))
    with pytest.raises(InputError, match="spacing"):
        tb.read(path)

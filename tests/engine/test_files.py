"""`replacing`: a file or a folder appears whole or not at all, and nothing else stays behind."""

import errno
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from trabecula.engine.files import read_npz, replacing
from trabecula.errors import FileError, InputError


def tree(folder):
    """Every file below a folder with its text."""
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def fill_file(path, text="new"):
    path.write_text(text)


def fill_folder(path, text="new"):
    path.mkdir()
    (path / "chunk").write_text(text)


def test_the_temporary_name_is_beside_and_keeps_the_suffix(tmp_path):
    with replacing(tmp_path / "bone.nii.gz") as temporary:
        assert (
            temporary.parent == tmp_path
            and temporary.name.endswith("bone.nii.gz")
            and not temporary.exists()
        )
        temporary.write_text("voxels")
        assert not (tmp_path / "bone.nii.gz").exists()
    assert tree(tmp_path) == {"bone.nii.gz": "voxels"}


@pytest.mark.parametrize("fill", [fill_file, fill_folder])
def test_the_old_stays_until_the_new_is_whole(tmp_path, fill):
    target = tmp_path / "x"
    fill(target, "old")
    old = tree(tmp_path)
    with replacing(target) as temporary:
        fill(temporary)
        assert {
            name: text for name, text in tree(tmp_path).items() if not name.startswith(".")
        } == old
    assert tree(tmp_path) == {name: "new" for name in old}


@pytest.mark.parametrize("fill", [fill_file, fill_folder])
@pytest.mark.parametrize("error", [InputError("no"), KeyboardInterrupt(), ZeroDivisionError()])
def test_a_body_that_fails_leaves_the_old_alone(tmp_path, fill, error):
    target = tmp_path / "x"
    fill(target, "old")
    old = tree(tmp_path)
    with pytest.raises(type(error)), replacing(target) as temporary:
        fill(temporary)
        raise error
    assert tree(tmp_path) == old and len(list(tmp_path.iterdir())) == 1


def test_a_body_that_fails_leaves_no_new_file(tmp_path):
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "x") as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_in_the_body_is_told_in_one_line(tmp_path):
    target = tmp_path / "x.npy"
    target.write_text("old")
    with pytest.raises(FileError) as caught, replacing(target) as temporary:
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert (
        str(caught.value) == f"cannot write {target}: No space left on device; "
        "check the folder, its rights and the space left"
    )
    assert tree(tmp_path) == {"x.npy": "old"}


def test_a_files_own_error_is_passed_on_as_it_is(tmp_path):
    with pytest.raises(FileError, match=r"^cannot hold it$"), replacing(tmp_path / "x"):
        raise FileError("cannot hold it")


@pytest.mark.parametrize("old", [None, "old"])
def test_a_disk_that_fills_up_at_the_renaming(tmp_path, monkeypatch, old):
    target = tmp_path / "x"
    if old:
        target.write_text(old)

    def full(*names):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(FileError, match="No space left"), replacing(target) as temporary:
        temporary.write_text("new")
    assert tree(tmp_path) == ({"x": old} if old else {})


def test_a_folder_whose_renaming_fails_gets_its_old_back(tmp_path, monkeypatch):
    target = tmp_path / "x.zarr"
    fill_folder(target, "old")
    rename, renamed = Path.rename, []

    def failing(self, to):
        renamed.append(self)
        if len(renamed) == 2:  # the old is set aside, now the new comes
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(FileError, match="Input/output error"), replacing(target) as temporary:
        fill_folder(temporary)
    assert tree(tmp_path) == {"x.zarr/chunk": "old"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_a_file_never_takes_the_place_of_a_folder(tmp_path):
    fill_folder(tmp_path / "part.stl", "precious")
    with (
        pytest.raises(FileError, match="a folder of that name is there"),
        replacing(tmp_path / "part.stl") as temporary,
    ):
        temporary.write_text("surface")
    assert tree(tmp_path) == {"part.stl/chunk": "precious"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["part.stl"]


def test_a_folder_never_takes_the_place_of_a_file(tmp_path):
    (tmp_path / "x.zarr").write_text("precious")
    with (
        pytest.raises(FileError, match="cannot write"),
        replacing(tmp_path / "x.zarr") as temporary,
    ):
        fill_folder(temporary)
    assert tree(tmp_path) == {"x.zarr": "precious"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_a_file_on_the_way_is_told(tmp_path):
    (tmp_path / "folder").write_text("no folder")
    with (
        pytest.raises(FileError, match="cannot write"),
        replacing(tmp_path / "folder" / "x") as temporary,
    ):
        temporary.write_text("new")
    assert tree(tmp_path) == {"folder": "no folder"}


def test_missing_folders_are_made(tmp_path):
    with replacing(tmp_path / "a" / "b" / "x") as temporary:
        temporary.write_text("new")
    assert tree(tmp_path) == {"a/b/x": "new"}


def test_a_body_that_writes_nothing_is_told(tmp_path):
    with pytest.raises(FileError, match="cannot write"), replacing(tmp_path / "x"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_array_longer_than_it_says_is_damaged(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file, file.open("a.npy", "w") as member:
        header = {"descr": "<i8", "fortran_order": False, "shape": (2,)}
        np.lib.format.write_array_header_1_0(member, header)
        member.write(np.arange(3).tobytes())
    with pytest.raises(ValueError, match=r"a\.npy does not end"):
        read_npz(tmp_path / "a.npz")

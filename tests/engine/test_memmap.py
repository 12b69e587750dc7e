"""Arrays in scratch files: the same values, where they lie, and that they go."""

import errno
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from trabecula.engine import memmap
from trabecula.engine.files import read_npz, write_npz
from trabecula.engine.parallel import for_slabs, sum_slabs, threads


@pytest.fixture
def spilled(tmp_path):
    with memmap.map_large_arrays(tmp_path / "s", memory=1 << 16, thickest=3):
        yield tmp_path / "s"


def test_outside_arrays_are_in_memory():
    assert not memmap.is_active()
    assert memmap.empty((3, 4), np.int16).base is None
    assert not memmap.zeros((300, 400), np.int16).any()
    assert memmap.slab_thickness(40, 2) == 40


def test_large_arrays_lie_in_files_and_go_with_them(spilled):
    array = memmap.zeros((20, 30, 40), np.int16)
    small = memmap.zeros(8, np.int16)
    assert [file.stat().st_size for file in spilled.iterdir()] == [array.nbytes]
    assert type(array) is np.ndarray and not array.any() and memmap.file_of(small) is None
    part = array[3:9, ::2]
    del array
    part[...] = 7
    memmap.release_pages()
    assert (part == 7).all()
    del part
    assert not list(spilled.iterdir())


def test_a_view_is_opened_by_its_place(spilled):
    array = memmap.empty((20, 30, 40), np.int16)
    array[...] = np.arange(array.size).reshape(array.shape)
    for view in (array, array[4:, 3], array[:, ::-1], np.moveaxis(array, 2, 0)[5:9]):
        assert np.array_equal(memmap.open_file(memmap.file_of(view)), view)
    other = memmap.open_file(memmap.file_of(array[2]))
    other[...] = -1
    assert (array[2] == -1).all() and (array[3] >= 0).all()


def test_a_file_that_is_kept_stays(spilled):
    array = memmap.empty((20, 30, 40), np.uint8)
    array[...] = 5
    place = memmap.keep_file(array)
    other = memmap.empty((20, 30, 40), np.uint8)
    for part in (np.zeros(4), other[1], other[1:]):
        with pytest.raises(ValueError, match="scratch file"):
            memmap.keep_file(part)
    del array, other, part
    assert (memmap.open_file(place) == 5).all() and list(spilled.iterdir()) == [place.path]


def test_a_full_disk_leaves_no_file(spilled, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space"):
        memmap.empty((20, 30, 40), np.uint8)
    assert not list(spilled.iterdir())


def test_a_disk_that_cannot_be_asked_is_looked_at(spilled, monkeypatch):
    def unable(*_):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(os, "posix_fallocate", unable)
    assert not memmap.zeros((20, 30, 40), np.uint8).any()
    with pytest.raises(OSError, match="No space"):
        memmap.empty((1 << 20, 1 << 20, 1 << 20), np.uint8)
    assert not list(spilled.iterdir())


@pytest.mark.parametrize("count", [1, 2])
def test_slabs_are_no_thicker_than_allowed_and_cover_everything(spilled, count):
    array = memmap.zeros((50, 40, 40), np.uint8)
    seen = []

    def work(start, stop):
        seen.append(stop - start)
        array[start:stop] += 1

    with threads(count):
        for_slabs(work, 50)
        assert max(seen) <= 3 and (array == 1).all()
        assert sum_slabs(lambda a, b: int(array[a:b].sum()), 50) == array.size


def test_slabs_are_a_share_of_all_arrays(tmp_path):
    with memmap.map_large_arrays(tmp_path, memory=1 << 20):
        kept = [memmap.empty((64, 256, 256), np.uint8) for _ in range(2)]
        assert memmap.slab_thickness(64, 1) == 64 // 8 and memmap.slab_thickness(64, 2) == 64 // 16
        assert memmap.slab_thickness(1000, 1) == 125
        del kept[0]
        assert memmap.slab_thickness(64, 1) == 64 // 4


@pytest.mark.skipif(sys.platform != "linux", reason="the system tells what is resident")
def test_pages_that_are_touched_in_no_order_are_released(tmp_path):
    with memmap.map_large_arrays(tmp_path, memory=1 << 20):
        values = memmap.empty((256, 256, 256), np.uint8)
        values[...] = 1
        memmap.release_pages()
        for plane in np.random.default_rng(0).permutation(256):
            values[plane, 100, 100] += 1
            memmap.count_scattered(1)
        assert _resident(tmp_path) <= 1 << 20
        assert (values[:, 100, 100] == 2).all() and values.sum(dtype=np.int64) == values.size + 256
        assert _resident(tmp_path) == values.nbytes  # they would stay


def _resident(folder):
    """Bytes of the files in a folder that this process holds."""
    maps = re.split(r"\n(?=[0-9a-f]+-)", Path("/proc/self/smaps").read_text())
    ours = [one for one in maps if str(folder) in one]
    return sum(1024 * int(re.search(r"Rss: +(\d+)", one)[1]) for one in ours)


@pytest.mark.parametrize("many", [True, False])
def test_states_hold_arrays_of_every_kind(tmp_path, monkeypatch, many):
    monkeypatch.setattr("trabecula.engine.files._AT_ONCE", 700 if many else 1 << 24)
    rng = np.random.default_rng(0)
    given = {
        "levels": rng.integers(0, 200, (9, 20, 30)).astype(np.uint8),
        "votes": rng.integers(-9, 9, (2, 9, 20, 30)).astype(np.int16)[:, ::2],
        "none": np.zeros((0, 3), np.float32),
        "number": np.asarray(3.5),
        "marks": rng.random((5, 40)) < 0.5,
    }
    write_npz(tmp_path / "state", given)
    with np.load(tmp_path / "state") as stored:
        assert sorted(stored.files) == sorted(given)
        assert all(np.array_equal(stored[name], array) for name, array in given.items())
    found = read_npz(tmp_path / "state")
    with memmap.map_large_arrays(tmp_path / "s", memory=1 << 16):
        inside = read_npz(tmp_path / "state", "v")
        assert memmap.file_of(inside["otes"]) is not None
        assert np.array_equal(inside["otes"], given["votes"])
    assert list(found) == list(given)
    for name, array in given.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)
        found[name][...] = 0  # the caller's to write into


def test_a_damaged_state_is_found_out(tmp_path):
    write_npz(tmp_path / "state", {"levels": np.arange(5000)})
    whole = bytearray((tmp_path / "state").read_bytes())
    whole[3000] ^= 1
    (tmp_path / "state").write_bytes(whole)
    with pytest.raises(Exception, match="CRC"):
        read_npz(tmp_path / "state")

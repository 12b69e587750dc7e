"""Volumes made as a whole in scratch files: going on after any end, where the files lie, and that
nothing is lost.
"""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import ClusterError, FileError
from trabecula.core.progress import listen
from trabecula.core.recipe import digest
from trabecula.engine import checkpoint, memmap
from trabecula.pipeline.generate import generate_to, resume
from trabecula.synth.texture.method import TextureModel

REQUEST = tb.Request((34, 40, 38), seed=4)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("scan") / "scan.npy"
    np.save(path, tb.crop(tb.sample("bone"), 40).values)
    return path


@pytest.fixture(scope="module")
def model(scan):
    return tb.method("texture", preset="fast").fit(tb.read(scan))


@pytest.fixture(scope="module")
def sha256(model):
    return digest(model.generate(REQUEST).values)


@pytest.fixture(autouse=True)
def often(monkeypatch):
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)


def stopped(model, path, at, **more):
    """A run that is interrupted when the listener is called for the `at`-th time; what it said."""
    said, count = [], iter(range(at))

    def interrupt(label, done):
        said.append(label)
        if next(count, None) is None:
            raise KeyboardInterrupt

    with listen(interrupt), pytest.raises(KeyboardInterrupt):
        generate_to(model, REQUEST, path, **more)
    return said


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.whole
def test_a_run_begun_in_memory_goes_on_in_blocks(model, sha256, tmp_path):
    path = tmp_path / "x.zarr"
    stopped(model, path, 12)
    assert names(tmp_path) == ["x.zarr.part"] and (tmp_path / "x.zarr.part").is_file()
    said = []
    with listen(lambda label, done: said.append(label)):
        assert generate_to(model, REQUEST, path, chunks=16).sha256 == sha256
    assert any("resuming from state" in line for line in said)
    assert names(tmp_path) == ["x.zarr"]


@pytest.mark.whole
def test_a_run_begun_in_blocks_goes_on_with_more_memory(model, sha256, tmp_path):
    path = tmp_path / "x.zarr"
    said = stopped(model, path, 12, chunks=16)
    assert [line for line in said if "--resume" in line] == [
        "interrupted: the same run resumes from x.zarr.part (generate --resume x.zarr)"
    ]
    assert generate_to(model, REQUEST, path).sha256 == sha256
    assert names(tmp_path) == ["x.zarr"]


@pytest.mark.whole
def test_resume_finds_the_folder_that_was_chosen(model, sha256, tmp_path):
    (tmp_path / "big").mkdir()
    path = tmp_path / "x.zarr"
    stopped(model, path, 12, chunks=16, scratch=tmp_path / "big")
    (folder,) = (tmp_path / "big").iterdir()
    assert folder.name.startswith("x.zarr.") and (folder / "state").is_file()
    assert resume(path).sha256 == sha256
    assert names(tmp_path) == ["big", "x.zarr"] and not names(tmp_path / "big")
    assert "scratch" not in json.loads((path / "zarr.json").read_text())["attributes"]["trabecula"]


@pytest.mark.whole
def test_two_results_of_one_name_do_not_share_their_files(model, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    other = tb.Request(REQUEST.shape, seed=5)
    stopped(model, tmp_path / "a" / "x.zarr", 12, chunks=16, scratch=tmp_path)
    state = [file.read_bytes() for file in tmp_path.glob("*/state")]
    generate_to(model, other, tmp_path / "b" / "x.zarr", chunks=16, scratch=tmp_path)
    assert [file.read_bytes() for file in tmp_path.glob("*/state")] == state


@pytest.mark.whole
def test_voxels_that_are_made_are_not_made_again(model, sha256, tmp_path, monkeypatch):
    path = tmp_path / "x.zarr"

    def interrupt(label, done):
        if label == "digest":
            raise KeyboardInterrupt

    with listen(interrupt), pytest.raises(KeyboardInterrupt):
        generate_to(model, REQUEST, path, chunks=16)
    assert names(tmp_path) == ["x.zarr.part", "x.zarr.scratch"]
    monkeypatch.setattr(TextureModel, "make", None)
    assert resume(path).sha256 == sha256


@pytest.mark.whole
def test_voxels_without_their_note_are_made_again_from_the_last_state(
    model, sha256, tmp_path, monkeypatch
):
    """Killed between the two: the state is still there."""
    path = tmp_path / "x.zarr"
    with monkeypatch.context() as patch:
        patch.setattr("trabecula.pipeline.out_of_core.replacing", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            generate_to(model, REQUEST, path, chunks=16)
    assert "state" in names(tmp_path / "x.zarr.scratch")
    assert resume(path).sha256 == sha256
    assert names(tmp_path) == ["x.zarr"]


@pytest.mark.whole
def test_files_that_a_kill_left_go_with_the_next_word(model, tmp_path, monkeypatch):
    """Killed between the last block and the removal of the scratch files."""
    path = tmp_path / "x.zarr"
    with monkeypatch.context() as patch:
        patch.setattr("trabecula.pipeline.out_of_core.ScratchVolume.remove", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            generate_to(model, REQUEST, path, chunks=16)
    assert names(tmp_path) == ["x.zarr", "x.zarr.scratch"]
    resume(path)
    assert names(tmp_path) == ["x.zarr"]


def test_what_workers_say_is_passed_on(model, tmp_path, monkeypatch):
    def lost(*_):
        raise ClusterError("the worker on x does not see y")

    monkeypatch.setattr(TextureModel, "make", lost)
    with pytest.raises(ClusterError, match="does not see"):
        generate_to(model, REQUEST, tmp_path / "x.zarr", chunks=16)


def test_too_small_a_disk_is_told_before_any_work(model, tmp_path, monkeypatch):
    usage = memmap.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(
        "trabecula.pipeline.out_of_core.shutil.disk_usage", lambda _: usage._replace(free=1 << 12)
    )
    monkeypatch.setattr(TextureModel, "make", None)
    with pytest.raises(FileError, match=r"scratch files are needed.*--scratch"):
        generate_to(model, REQUEST, tmp_path / "x.zarr", chunks=16)


def test_a_disk_that_fills_keeps_the_state(model, sha256, tmp_path, monkeypatch):
    """It fills in the middle of the run; what it had done is not lost."""
    path, real, room = tmp_path / "x.zarr", memmap._allocate, iter(range(30))

    def full(place, descriptor, size):
        if next(room, None) is None:
            raise OSError(28, "No space left on device")
        real(place, descriptor, size)

    monkeypatch.setattr(memmap, "SMALLEST", 256)
    with monkeypatch.context() as patch:
        patch.setattr(memmap, "_allocate", full)
        with pytest.raises(FileError, match=r"No space left.*--scratch; the same run resumes"):
            generate_to(model, REQUEST, path, chunks=16)
    assert "state" in names(tmp_path / "x.zarr.scratch")
    assert not list((tmp_path / "x.zarr.scratch").glob("*.raw"))
    assert resume(path).sha256 == sha256

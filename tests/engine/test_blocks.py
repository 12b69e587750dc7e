"""Volumes in blocks: what is finished is not made again, an unfinished store says so, and nothing
is lost on the way.
"""

import dataclasses
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import zarr

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.core.recipe import Recipe, digest
from trabecula.engine import blocks, storage, store
from trabecula.engine.blocks import StoredVolume, boxes_of, slices_of, stream
from trabecula.engine.multiscale import halve_resolution
from trabecula.errors import FileError

SHAPE = (300, 130, 257)
FIELDS = {"kind": "labels", "spacing": [2.0, 2.0, 2.0], "unit": "um", "phases": ["void", "solid"]}


def voxels(box):
    z, y, x = np.ogrid[slices_of(box)]
    return ((z * 7 + y * 5 + x * 3) % 11 < 4).astype(np.uint8)


WHOLE = voxels(tuple((0, side) for side in SHAPE))


class Maker:
    """Makes voxels, remembers which, and stops where it is told to."""

    def __init__(self, stop_at=None, error=KeyboardInterrupt):
        self.made, self.stop_at, self.error = [], stop_at, error

    def __call__(self, box):
        if len(self.made) == self.stop_at:
            raise self.error
        self.made.append(box)
        return voxels(box)


def volume(make, identity="one", shape=SHAPE):
    return StoredVolume(
        shape=shape,
        dtype=np.dtype(np.uint8),
        make=make,
        describe=lambda sha256: {
            **FIELDS,
            "recipe": Recipe().then_digest("generate", sha256).to_json(),
        },
        identity=identity,
        scale=(2.0,) * 3,
        unit="micrometer",
    )


@pytest.fixture
def run(tmp_path):
    def one(make, *, side=128, chunk=None, **fields):
        said, names = [], {"path": tmp_path / "x.zarr", "part": tmp_path / "x.zarr.part"}
        with listen(lambda label, fraction: said.append(label) if fraction < 0 else None):
            sha256 = stream(volume(make, **fields), **names, side=side, chunk=chunk)
        return sha256, said

    return one


def contents(folder):
    """Return every array's voxels, and the store's metadata without its times and sources."""
    group = zarr.open_group(folder, mode="r")
    own = {name: group.attrs["trabecula"][name] for name in (*FIELDS, "complete")}
    return {name: array[...].tobytes() for name, array in group.arrays()}, group.attrs["ome"], own


@pytest.mark.whole
@pytest.mark.parametrize(
    ("side", "chunk"), [(128, 128), (256, 128), (64, 64), (128, 64), (96, 96), (192, 96)]
)
def test_the_store_is_the_one_that_is_written_at_once(run, tmp_path, monkeypatch, side, chunk):
    make = Maker()
    sha256, _ = run(make, side=side, chunk=chunk)
    image = tb.read(tmp_path / "x.zarr")
    monkeypatch.setattr(store, "CHUNK", chunk)
    whole = tb.write(tb.Image(WHOLE, "labels", 2.0, "um"), tmp_path / "whole" / "x.zarr")
    assert contents(tmp_path / "x.zarr") == contents(whole)
    shutil.rmtree(whole.parent)
    assert np.array_equal(image.values, WHOLE) and sha256 == digest(WHOLE)
    assert (image.spacing, image.unit, image.phases) == ((2, 2, 2), "um", ("void", "solid"))
    assert image.recipe.steps[-1]["sha256"] == sha256
    assert make.made == boxes_of(SHAPE, side)
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_blocks_of_nothing_but_void_are_written_and_not_made_again(tmp_path):
    names = {"path": tmp_path / "x.zarr", "part": tmp_path / "x.zarr.part", "side": 128}
    with pytest.raises(KeyboardInterrupt):
        make = Maker(stop_at=3)
        stream(volume(lambda box: make(box) * np.uint8(0)), **names)
    make = Maker()
    stream(volume(lambda box: make(box) * np.uint8(0)), **names)
    assert make.made == boxes_of(SHAPE, 128)[3:]
    assert not tb.read(tmp_path / "x.zarr").values.any()


def test_what_is_finished_is_not_made_again(run, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(Maker(stop_at=7))
    assert not (tmp_path / "x.zarr").exists()
    with pytest.raises(FileError, match="did not finish"):
        tb.read(tmp_path / "x.zarr.part")
    second = Maker()
    sha256, said = run(second)
    assert second.made == boxes_of(SHAPE, 128)[7:]
    assert sha256 == digest(WHOLE) and said == ["resuming from x.zarr.part"]


def test_a_spoilt_or_lost_chunk_is_made_again(run, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(Maker(stop_at=5))
    chunks = tmp_path / "x.zarr.part" / "0" / "c" / "0"
    (chunks / "0" / "1").write_bytes((chunks / "0" / "1").read_bytes()[:-9])
    (chunks / "1" / "0").unlink()
    second = Maker()
    assert run(second)[0] == digest(WHOLE)
    order = boxes_of(SHAPE, 128)
    assert second.made == [order[1], order[3], *order[5:]]


@pytest.mark.parametrize("other", [{"identity": "two"}, {"shape": (300, 130, 250)}])
def test_another_runs_part_is_neither_used_nor_lost(run, tmp_path, other):
    with pytest.raises(KeyboardInterrupt):
        run(Maker(stop_at=7))
    with pytest.raises(FileError, match=r"blocks of another run, of 300x130x257 voxels.*--resume"):
        run(Maker(), **other)
    second = Maker()
    assert run(second)[0] == digest(WHOLE) and second.made == boxes_of(SHAPE, 128)[7:]


@pytest.mark.whole
def test_other_chunks_than_it_was_begun_in_are_refused(run, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(Maker(stop_at=2), side=64, chunk=64)
    with pytest.raises(
        FileError, match="begun in chunks of 64 voxels, not of 128: give --chunks 64"
    ):
        run(Maker())
    second = Maker()
    assert run(second, side=128, chunk=64)[0] == digest(WHOLE)
    assert second.made == boxes_of(SHAPE, 128), "the first block of 128 was not there as a whole"


@pytest.mark.parametrize("kind", ["file", "folder", "store"])
def test_what_is_no_part_is_left_alone(run, tmp_path, kind):
    part = tmp_path / "x.zarr.part"
    if kind == "file":
        part.write_bytes(b"mine")
    elif kind == "folder":
        part.mkdir()
        (part / "mine").touch()
    else:
        tb.write(tb.Image(WHOLE[:4, :4, :4], "labels"), tmp_path / "y.zarr").rename(part)
    before = sorted(part.rglob("*")) if part.is_dir() else part.read_bytes()
    with pytest.raises(FileError, match="something else of that name"):
        run(Maker())
    assert before == (sorted(part.rglob("*")) if part.is_dir() else part.read_bytes())


@pytest.mark.whole
def test_the_old_store_stays_until_the_new_one_is_whole(run, tmp_path):
    run(Maker())
    with pytest.raises(KeyboardInterrupt):
        run(Maker(stop_at=3), identity="two")
    assert np.array_equal(tb.read(tmp_path / "x.zarr").values, WHOLE)
    run(Maker(), identity="two")
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_a_full_disk_leaves_what_is_finished(run, tmp_path):
    with pytest.raises(FileError, match=r"No space left.*x.zarr.part"):
        run(Maker(stop_at=4, error=OSError(28, "No space left on device")))
    second = Maker()
    run(second)
    assert len(second.made) == len(boxes_of(SHAPE, 128)) - 4


def test_a_run_that_died_before_the_store_had_its_name(run, tmp_path, monkeypatch):
    def die(*names):
        raise KeyboardInterrupt

    monkeypatch.setattr(storage, "put_in_place", die)
    with pytest.raises(KeyboardInterrupt):
        run(Maker())
    monkeypatch.undo()
    second = Maker()
    assert run(second)[0] == digest(WHOLE) and second.made == []


@pytest.mark.whole
def test_planes_for_the_digest_never_fall_into_two_rows_of_chunks(run, monkeypatch):
    for at_once in (1, 5 * 130 * 257, 50 * 130 * 257, 1 << 30):
        monkeypatch.setattr(blocks, "_AT_ONCE", at_once)
        for chunk in (64, 96, 128, 192):
            depth = blocks._depth(SHAPE, np.dtype(np.uint8), chunk)
            assert chunk % depth == 0 and (depth == 1 or depth * 130 * 257 <= at_once)
    monkeypatch.setattr(blocks, "_AT_ONCE", 5 * 130 * 257)
    assert run(Maker())[0] == digest(WHOLE)


def test_blocks_that_share_chunks_are_refused(run):
    with pytest.raises(ValueError, match="share chunks"):
        run(Maker(), side=100)


@pytest.mark.whole
def test_a_coarser_cube_that_is_lost_or_spoilt_is_made_again_and_no_block(
    run, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        storage, "put_in_place", lambda *names: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    with pytest.raises(KeyboardInterrupt):
        run(Maker())
    monkeypatch.undo()
    cubes = tmp_path / "x.zarr.part" / "1" / "c"
    (cubes / "0" / "0" / "0").write_bytes(b"spoilt")
    (cubes / "1" / "0" / "1").unlink()
    make = Maker()
    run(make)
    assert make.made == []
    assert np.array_equal(
        tb.read(tmp_path / "x.zarr", level=1).values, halve_resolution(WHOLE, labels=True)
    )


@pytest.mark.whole
def test_what_a_run_left_that_was_killed_between_two_names_goes(run, tmp_path):
    run(Maker())
    (tmp_path / "x.zarr").rename(tmp_path / ".0123abcd-x.zarr")  # set aside by `put_in_place`
    (tmp_path / ".89abcdef-x.zarr.part").mkdir()  # a store that was being created
    (tmp_path / ".mine-x.zarr").mkdir()
    run(Maker())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [".mine-x.zarr", "x.zarr"]


ENDS = """
import sys
from pathlib import Path
sys.path[:0] = {paths!r}
from kills import end_at_change
from test_blocks import volume, voxels
from trabecula.engine.blocks import stream

end_at_change({number}, "x.zarr")
stream(volume(voxels), Path({path!r}), part=Path({path!r} + ".part"), side=128)
"""


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.whole)])
def test_killed_again_and_again(run, tmp_path, seed):
    """A process that is killed at any change of any file resumes until it is done; no chunk is half
    one.
    """
    path = tmp_path / "x.zarr"
    here = Path(__file__).parent
    paths = [str(here), str(here.parent)]
    rng = np.random.default_rng(seed)
    for number in (rng.integers(30, 60), rng.integers(2, 30)):  # of the 107 of a whole run
        program = ENDS.format(paths=paths, path=str(path), number=number)
        done = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True)
        assert done.returncode == -signal.SIGKILL, done.stderr
    make = Maker()
    assert run(make)[0] == digest(WHOLE) and len(make.made) < len(boxes_of(SHAPE, 128))
    assert [entry.name for entry in path.rglob("*.partial")] == []


def test_channels_go_along(tmp_path):
    """A colour volume: channels last where it is made, first in the store."""
    rng = np.random.default_rng(3)
    values = rng.integers(0, 255, (40, 34, 50, 3)).astype(np.uint8)
    volume = blocks.StoredVolume(
        shape=values.shape[:3],
        dtype=values.dtype,
        make=lambda box: values[blocks.slices_of(box)],
        describe=lambda sha256: {"kind": "colour", "sha": sha256},
        identity="one",
        scale=(1.0, 1.0, 1.0),
        unit=None,
        labels=False,
        channels=3,
    )
    part, path = tmp_path / "x.zarr.part", tmp_path / "x.zarr"
    broken = dataclasses.replace(
        volume, make=lambda box: values[blocks.slices_of(box)] if box[0][0] < 32 else 1 / 0
    )
    with pytest.raises(ZeroDivisionError):
        stream(broken, path, part=part, side=16, chunk=16)
    sha256 = stream(volume, path, part=part, side=16, chunk=16)
    assert sha256 == digest(values)
    for level in (0, 1):
        found = store.open_finished(path, level)
        assert np.array_equal(found.load(), np.moveaxis(values, -1, 0))
        values = np.moveaxis(
            halve_resolution(np.moveaxis(values, -1, 0), labels=False, axes=3), 0, -1
        )
    assert not part.exists()


@pytest.mark.whole
def test_a_second_run_of_the_same_store_is_refused_and_the_first_not_disturbed(tmp_path):
    names = {"path": tmp_path / "x.zarr", "part": tmp_path / "x.zarr.part", "side": 128}
    refused = []

    def second():
        try:
            stream(volume(voxels), **names)
        except FileError as error:
            refused.append(str(error))

    def make(box):
        if not refused:
            # with nothing of the first run's about it, as another process
            thread = threading.Thread(target=second)
            thread.start()
            thread.join()
        return voxels(box)

    assert stream(volume(make), **names) == digest(WHOLE)
    assert len(refused) == 1 and "x.zarr.part is being written by another run" in refused[0]
    assert np.array_equal(tb.read(tmp_path / "x.zarr").values, WHOLE)
    assert [path.name for path in tmp_path.iterdir()] == ["x.zarr"]


def test_a_folder_that_is_no_store_is_not_replaced(tmp_path):
    (tmp_path / "x.zarr").mkdir()
    (tmp_path / "x.zarr" / "thesis.txt").write_text("precious")
    with pytest.raises(FileError, match="a folder that is no Zarr store is there"):
        stream(volume(voxels), path=tmp_path / "x.zarr", part=tmp_path / "x.zarr.part", side=128)
    assert [path.name for path in tmp_path.rglob("*")] == ["x.zarr", "thesis.txt"]

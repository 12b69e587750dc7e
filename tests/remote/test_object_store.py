"""Volumes made into an object store: block by block, gone on with, refused while they are not
complete, read by every verb.
"""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from emulation import forget_connections, fsspec

import trabecula as tb
from commands import attempt, refused, trabecula
from trabecula.core.recipe import digest
from trabecula.engine import blocks
from trabecula.engine.multiscale import halve_resolution
from trabecula.errors import FileError, InputError
from trabecula.finish.slabs import finish_slabs

ASKED = ("--method", "bubbles", "--shape", 70, 30, 40, "--seed", 3)
BLOCKS = 3 * 1 * 2
OBJECTS = BLOCKS + 2
"""In chunks of 32, with those of the coarser level."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Make the volume of these runs on disk."""
    path = tmp_path_factory.mktemp("whole") / "foam.zarr"
    trabecula("generate", *ASKED, "--out", path, "--chunks", 32)
    return path


@pytest.fixture
def interrupted(bucket, monkeypatch):
    """Return the address of the same run, stopped by Ctrl-C after two blocks."""
    foam = f"{bucket}/foam.zarr"
    with monkeypatch.context() as patch:
        real, count = blocks.do_task, []

        def stopped(*words, **more):
            count.append(words)
            if len(count) == 3:
                raise KeyboardInterrupt
            real(*words, **more)

        patch.setattr(blocks, "do_task", stopped)
        left = attempt("generate", *ASKED, "--out", foam, "--chunks", 32)
    assert left.status == 130
    assert f"the same run resumes from {foam} (generate --resume {foam})" in left.err
    return foam


@pytest.fixture
def finished(bucket, whole):
    """Return the address of that volume, copied there."""
    fsspec.filesystem("s3").put(str(whole), f"{bucket}/foam.zarr", recursive=True)
    return f"{bucket}/foam.zarr"


@pytest.fixture
def tasks(monkeypatch):
    """List the tasks that are done."""
    real, done = blocks.do_task, []

    def told(task, *words, **more):
        done.append(task)
        real(task, *words, **more)

    monkeypatch.setattr(blocks, "do_task", told)
    return done


def sha256_of(path):
    return tb.read(path).recipe.steps[-1]["sha256"]


def test_what_was_interrupted_goes_on_and_nothing_lies_here(interrupted, whole, tasks, objects):
    assert len([name for name in objects() if "/0/c/" in name]) == 2
    done = trabecula("generate", "--resume", interrupted)
    assert f"resuming from {interrupted}" in done.err and "70x30x40 labels" in done.out
    assert done.sha256 == sha256_of(whole)
    assert len([task for task in tasks if task.level == 0]) == BLOCKS - 2, (
        "a finished block was made again"
    )
    image = tb.read(interrupted)
    assert digest(image.values) == done.sha256
    assert image.recipe.to_json() == tb.read(whole).recipe.to_json()
    assert np.array_equal(
        tb.read(interrupted, level=1).values, halve_resolution(image.values, labels=True)
    )
    assert objects() == {
        f"foam.zarr/{path.relative_to(whole).as_posix()}"
        for path in whole.rglob("*")
        if path.is_file()
    }
    assert list(Path.cwd().iterdir()) == []


def test_until_it_is_complete_every_reader_refuses(interrupted):
    goes_on = (
        "the run that makes it did not finish; "
        f"trabecula generate --resume {interrupted} resumes it"
    )
    for verb in (
        ("measure",),
        ("render", "--out", "x.png"),
        ("export", "--out", "x.npy"),
        ("rerun",),
        ("check",),
    ):
        assert goes_on in refused(verb[0], interrupted, *verb[1:])
    assert goes_on in refused("verify", "sample:foam", interrupted)
    for read in (tb.read, tb.open_slabs):
        with pytest.raises(FileError, match="did not finish"):
            read(interrupted)


def test_the_same_command_goes_on_too_and_another_seed_is_refused(interrupted, whole, tasks):
    other = ("generate", *ASKED[:-1], 4, "--out", interrupted, "--chunks", 32)
    assert "holds the blocks of another run, of 70x30x40 voxels" in refused(*other)
    assert trabecula("generate", *ASKED, "--out", interrupted).sha256 == sha256_of(whole)
    assert len(tasks) == OBJECTS - 2
    assert "another volume, of 70x30x40 voxels, is there; remove it" in refused(*other)
    assert trabecula("generate", *ASKED, "--out", interrupted).sha256 == sha256_of(whole)
    assert len(tasks) == OBJECTS - 2
    again = trabecula("generate", "--resume", interrupted, "--json")
    assert f"{interrupted} is finished" in again.err
    assert (
        json.loads(again.out)["sha256"] == sha256_of(whole)
        and json.loads(again.out)["out"] == interrupted
    )


def test_what_fits_into_memory_is_made_in_blocks_all_the_same(bucket, whole, tasks):
    assert trabecula("generate", *ASKED, "--out", f"{bucket}/foam.zarr").sha256 == sha256_of(whole)
    assert [task.level for task in tasks] == [0]


def test_every_verb_reads_it(finished, whole):
    names = {"here": str(whole), "there": finished}
    found = {
        name: trabecula("measure", path, "--quick", "--json").out for name, path in names.items()
    }
    assert found["here"] == found["there"]
    for name, path in names.items():
        trabecula("export", path, "--out", f"{name}.stl")
        trabecula("export", path, "--out", f"{name}-by-slabs.stl", "--memory", 0.005)
        trabecula("render", path, "--level", 1, "--out", f"{name}.png")
    for end in (".stl", "-by-slabs.stl"):
        assert Path(f"here{end}").read_bytes() == Path(f"there{end}").read_bytes()
    assert np.array_equal(tb.read("here.png").values, tb.read("there.png").values)
    table = json.loads(trabecula("verify", whole, finished, "--quick", "--json").out)
    assert table["metrics"]["porosity_error"]["value"] == 0
    slabs = tb.open_slabs(finished)
    assert np.array_equal(slabs.planes(11, 40).values, tb.read(whole).values[11:40])
    assert "the same voxels" in trabecula("rerun", finished).out


def test_a_volume_that_is_made_as_a_whole(bucket, monkeypatch):
    """Make it in scratch files of this machine, and then block by block into the store."""
    tb.write(tb.crop(tb.sample("bone"), 24), "scan.npy")
    asked = ("generate", "scan.npy", "--method", "quilt", "--shape", 40, "--seed", 1)
    here = trabecula(*asked, "--out", "rock.npy")
    Path("disk").mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(blocks, "digest_of", lambda *words: (_ for _ in ()).throw(KeyboardInterrupt))
        cut_off = attempt(
            *asked, "--out", f"{bucket}/rock.zarr", "--chunks", 32, "--scratch", "disk"
        )
    assert cut_off.status == 130 and list(Path("disk").rglob("*"))
    assert "did not finish" in refused("measure", f"{bucket}/rock.zarr")
    there = trabecula("generate", "--resume", f"{bucket}/rock.zarr", "--scratch", "disk")
    assert there.sha256 == here.sha256 and list(Path("disk").rglob("*")) == []
    assert {path.name for path in Path.cwd().iterdir()} == {
        "scan.npy",
        "scan.npy.json",
        "rock.npy",
        "rock.npy.json",
        "disk",
    }


def test_what_is_finished_slab_by_slab(finished, bucket):
    trabecula("finish", finished, "--floaters", "--out", "here.zarr")
    finish_slabs(tb.open_slabs(finished), f"{bucket}/there.zarr", [("remove_floaters", {})])
    assert np.array_equal(tb.read(f"{bucket}/there.zarr").values, tb.read("here.zarr").values)
    assert [path.name for path in Path.cwd().iterdir()] == ["here.zarr"]


def test_an_exemplar_at_an_address(bucket):
    tb.write(tb.crop(tb.sample("bone"), 24), f"{bucket}/scan.zarr")
    asked = (
        "--method",
        "noise",
        "--set",
        "reach=4",
        "--set",
        "corrections=2",
        "--shape",
        40,
        "--seed",
        1,
    )
    made = trabecula("generate", f"{bucket}/scan.zarr", *asked, "--out", "rock.npy")
    assert trabecula("rerun", "rock.npy").sha256 == made.sha256


def test_a_volume_made_at_once_appears_whole_and_is_not_replaced(bucket, objects):
    block = tb.Image(
        np.random.default_rng(0).integers(0, 3, (40, 30, 300), dtype=np.uint8), "labels", 0.02, "mm"
    )
    place = tb.write(block, f"{bucket}/deep/block.zarr")
    again = tb.read(place)
    assert np.array_equal(again.values, block.values)
    assert (again.spacing, again.unit, again.phases) == (block.spacing, block.unit, block.phases)
    assert np.array_equal(
        tb.read(place, level=1).values, halve_resolution(block.values, labels=True)
    )
    before = objects()
    with pytest.raises(
        FileError, match="something is there, and an object store cannot replace it"
    ):
        tb.write(block, place)
    assert "something is there" in refused(
        "export", f"{bucket}/deep/block.zarr", "--out", f"{bucket}/deep/block.zarr"
    )
    assert "something is there" in refused("generate", *ASKED, "--out", f"{bucket}/deep/block.zarr")
    assert objects() == before and np.array_equal(tb.read(place).values, block.values)


def test_an_upload_that_was_killed_leaves_nothing_that_passes_for_a_block(
    bucket, whole, tasks, monkeypatch
):
    foam = f"{bucket}/foam.zarr"
    fs = fsspec.filesystem("s3")
    fs.pipe_file(f"{foam}/0/zarr.json", b"{}")
    fs.pipe_file(f"{foam}/0/c/0/0/0", b"of a store that never got its name")
    assert trabecula("generate", *ASKED, "--out", foam, "--chunks", 32).sha256 == sha256_of(whole)
    assert len(tasks) == OBJECTS


def test_an_upload_that_fails_takes_back_what_it_wrote(bucket, objects, monkeypatch):
    service = fsspec.get_filesystem_class("s3")
    real = service._call_s3

    async def fail(self, method, *words, Key="", **more):
        if method == "put_object" and Key.endswith("block.zarr/zarr.json"):
            raise PermissionError("Access Denied")
        return await real(self, method, *words, **({"Key": Key} if Key else {}), **more)

    monkeypatch.setattr(service, "_call_s3", fail)
    with pytest.raises(FileError, match=r"cannot reach s3://.*/block\.zarr: Access Denied"):
        tb.write(tb.Image(np.eye(5, dtype=np.uint8), "labels"), f"{bucket}/block.zarr")
    assert objects() == set()


def test_what_others_keep_under_the_name_is_left_alone(bucket, objects):
    fsspec.filesystem("s3").pipe_file(f"{bucket}/foam.zarr/notes.txt", b"mine")
    assert "something is there" in refused("generate", *ASKED, "--out", f"{bucket}/foam.zarr")
    assert objects() == {"foam.zarr/notes.txt"}
    assert "there is no Zarr store at" in refused("measure", f"{bucket}/foam.zarr")


def test_a_lost_object_is_told(finished):
    fsspec.filesystem("s3").rm(f"{finished}/0/c/1/0/1")
    assert f"1 of its {BLOCKS} chunks are missing" in refused("measure", finished)


PROGRAM = """
import sys, time
from trabecula.cli.main import main
from trabecula.engine import blocks

real = blocks.do_task

def slow(*words, **more):
    time.sleep(0.2)
    real(*words, **more)

blocks.do_task = slow
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(os.name != "posix", reason="kill -9 is of POSIX")
def test_killed_and_gone_on_with(bucket, whole, tasks, objects):
    foam = f"{bucket}/foam.zarr"
    words = ["generate", *map(str, ASKED), "--out", foam, "--chunks", "32"]
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, *words], stderr=subprocess.DEVNULL)
    while process.poll() is None and len([name for name in objects() if "/0/c/" in name]) < 2:
        time.sleep(0.02)
    assert process.poll() is None
    process.kill()
    process.wait()
    assert "did not finish" in refused("measure", foam)
    assert trabecula("generate", "--resume", foam).sha256 == sha256_of(whole)
    assert len(tasks) <= OBJECTS - 2


def test_a_service_that_goes_away_and_comes_back(service, bucket, whole, monkeypatch):
    foam = f"{bucket}/foam.zarr"
    monkeypatch.setattr(fsspec.get_filesystem_class("s3"), "retries", 1)
    real, count = blocks.do_task, []

    def cut_off(*words, **more):
        count.append(words)
        if len(count) == 4:
            service.stop()
        real(*words, **more)

    with monkeypatch.context() as patch:
        patch.setattr(blocks, "do_task", cut_off)
        line = refused_after_a_start("generate", *ASKED, "--out", foam, "--chunks", 32)
    service.start()
    assert line.startswith(f"cannot reach {foam}: ") and f"(generate --resume {foam})" in line
    assert trabecula("generate", "--resume", foam).sha256 == sha256_of(whole)


def refused_after_a_start(*words):
    left = attempt(*words)
    assert left.status == 2 and len(left.lines) == 2, left.err
    return left.lines[-1].removeprefix("trabecula: ")


@pytest.mark.parametrize(
    "verb", [("generate", *ASKED, "--out"), ("measure",), ("generate", "--resume")]
)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"AWS_ACCESS_KEY_ID": None, "AWS_SECRET_ACCESS_KEY": None}, "credentials"),
        ({"AWS_ENDPOINT_URL": "http://127.0.0.1:9"}, "Could not connect"),
    ],
    ids=["keys", "network"],
)
def test_no_keys_and_no_network(bucket, monkeypatch, verb, change, message):
    for name, value in change.items():
        monkeypatch.setenv(name, value) if value else monkeypatch.delenv(name)
    forget_connections()
    monkeypatch.setattr(fsspec.get_filesystem_class("s3"), "retries", 1)
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    line = refused(*verb, f"{bucket}/foam.zarr")
    monkeypatch.undo()
    forget_connections()
    assert re.match(
        rf"cannot reach {bucket}/foam\.zarr: .*{message}.*check the address, the network", line
    ), line
    assert "AWS_ENDPOINT_URL" in line


def test_no_such_bucket(bucket):
    for verb in (("generate", *ASKED, "--out"), ("export", "sample:bone", "--out")):
        line = refused(*verb, "s3://no-such-bucket-here/foam.zarr")
        assert line.startswith(
            "cannot reach s3://no-such-bucket-here/foam.zarr: The specified bucket does not exist; "
        )
    for verb in (("measure",), ("generate", "--resume")):
        assert "s3://no-such-bucket-here/foam.zarr" in refused(
            *verb, "s3://no-such-bucket-here/foam.zarr"
        )


def test_no_right_to_write(bucket, monkeypatch):
    """Let the emulation check the rights of a key, of which ours has none."""
    from moto import settings
    from moto.core.responses import ActionAuthenticatorMixin

    monkeypatch.setattr(ActionAuthenticatorMixin, "request_count", 0)
    monkeypatch.setattr(settings, "INITIAL_NO_AUTH_ACTION_COUNT", 0)
    line = refused("generate", *ASKED, "--out", f"{bucket}/foam.zarr")
    assert re.match(rf"cannot reach {bucket}/foam\.zarr: .*(Access|denied|exist)", line), line


@pytest.mark.parametrize("name", ["foam.npy", "foam.tif", "foam", "foam.stl"])
def test_only_stores_go_to_an_address(bucket, name, objects):
    assert "only a .zarr is written to an address" in refused(
        "generate", *ASKED, "--out", f"{bucket}/{name}"
    )
    assert "only a .zarr is written to an address" in refused(
        "export", "sample:bone", "--out", f"{bucket}/{name}"
    )
    with pytest.raises(InputError, match=r"only a \.zarr"):
        tb.write(np.eye(5, dtype=np.uint8), f"{bucket}/{name}")
    assert objects() == set()


def test_pages_and_models_go_to_no_address(bucket):
    for words in (
        ("fit", "sample:bone", "--method", "noise", "--out", f"{bucket}/bone.model"),
        ("render", "sample:bone", "--out", f"{bucket}/bone.png"),
    ):
        assert "only a .zarr is written to an address" in refused(*words)
    assert list(Path.cwd().iterdir()) == []

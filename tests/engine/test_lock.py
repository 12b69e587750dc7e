"""One process at a time: others are refused, whoever dies is forgotten, and nothing is left."""

import errno
import os
import subprocess
import sys
import threading
from contextvars import copy_context

import pytest

from commands import refused
from trabecula.engine.checkpoint import kept_at
from trabecula.engine.lock import hold_lock
from trabecula.errors import FileError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

HOLD = """
import sys
from pathlib import Path
from trabecula.engine.lock import hold_lock

with hold_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another process that has the lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "x.zarr.part")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_another_process_is_refused_until_this_one_ends(tmp_path, other):
    told = rf"x.zarr.part is being written by another run \(process {other.pid} on .*wait"
    with pytest.raises(FileError, match=told), hold_lock(tmp_path / "x.zarr.part"):
        pass
    with pytest.raises(FileError, match="another run"), kept_at(tmp_path / "x.zarr.part"):
        pass
    with hold_lock(tmp_path / "y.part"):  # of something else it knows nothing
        pass
    other.communicate("")
    assert not list(tmp_path.iterdir())
    with hold_lock(tmp_path / "x.zarr.part"):
        assert [path.name for path in tmp_path.iterdir()] == [".x.zarr.part.lock"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [("--chunks", 32, "--out", "x.zarr"), ("--out", "x.zarr")])
def test_the_second_command_says_so_in_one_line_and_leaves_nothing(
    tmp_path, other, monkeypatch, words
):
    monkeypatch.chdir(tmp_path)
    command = ("generate", "--method", "bubbles", "--preset", "foam", "--shape", 40, *words)
    assert "x.zarr.part is being written by another run" in refused(*command)
    assert [path.name for path in tmp_path.iterdir()] == [".x.zarr.part.lock"]


def test_what_a_killed_process_left_means_nothing(tmp_path, other):
    other.kill()
    other.wait()
    assert (tmp_path / ".x.zarr.part.lock").exists()
    with hold_lock(tmp_path / "x.zarr.part"):
        pass
    assert not list(tmp_path.iterdir())


def test_the_same_run_may_lock_again_and_another_of_this_process_may_not(tmp_path):
    found = []

    def elsewhere():
        try:
            with hold_lock(tmp_path / "x.zarr.part"):
                found.append("locked")
        except FileError:
            found.append("refused")

    with hold_lock(tmp_path / "x.zarr.part"):
        with hold_lock(tmp_path / "." / "x.zarr.part"):
            pass
        context = copy_context()
        # the second as threads over slabs are started
        for target in (elsewhere, lambda: context.run(elsewhere)):
            thread = threading.Thread(target=target)
            thread.start()
            thread.join()
    assert found == ["refused", "locked"]
    elsewhere()
    assert found[-1] == "locked"


def test_an_error_gives_the_lock_back(tmp_path):
    with pytest.raises(ZeroDivisionError), hold_lock(tmp_path / "x.zarr.part"):
        raise ZeroDivisionError
    with hold_lock(tmp_path / "x.zarr.part"):
        pass


@pytest.mark.parametrize("where", ["open", "flock"])
@pytest.mark.skipif(fcntl is None, reason="Windows has other locks")
def test_where_nothing_can_be_locked_the_work_goes_on(tmp_path, monkeypatch, where):
    """A file system that is read-only, or knows no locks: who writes there tells what is wrong."""

    def cannot(*words):
        raise OSError(errno.EROFS if where == "open" else errno.ENOSYS, "no")

    monkeypatch.setattr(os if where == "open" else fcntl, where, cannot)
    with hold_lock(tmp_path / "x.zarr.part"):
        done = True
    assert done


@pytest.mark.skipif(fcntl is None, reason="Windows has other locks")
def test_a_file_that_was_removed_between_opening_and_locking_is_not_taken_for_the_lock(
    tmp_path, monkeypatch
):
    real, seen = fcntl.flock, []

    def late(descriptor, how):
        if not seen:
            (tmp_path / ".x.zarr.part.lock").unlink()  # its owner ends just now
        seen.append(descriptor)
        real(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with hold_lock(tmp_path / "x.zarr.part"):
        assert len(seen) == 2
        assert (tmp_path / ".x.zarr.part.lock").exists()


def test_two_threads_never_have_it_both(tmp_path):
    inside, most, done = [], [], []

    def work():
        while len(done) < 60:
            try:
                with hold_lock(tmp_path / "x.zarr.part"):
                    inside.append(1)
                    most.append(len(inside))
                    inside.pop()
                    done.append(1)
            except FileError:
                pass

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1 and not list(tmp_path.iterdir())

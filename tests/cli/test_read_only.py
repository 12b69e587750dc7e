"""Targets that cannot be written: one line, exit status 2, and nothing lost."""

import builtins
import errno
import io
import os

import numpy as np
import pytest

import trabecula as tb
from commands import attempt, contents, refused, trabecula
from trabecula.engine import blocks

BUBBLES = ("generate", "--method", "bubbles", "--preset", "foam", "--seed", 3)
COMMANDS = {
    "generate": (*BUBBLES, "--shape", 40, "--out", "closed/new.zarr"),
    "generate in blocks": (*BUBBLES, "--shape", 40, "--chunks", 32, "--out", "closed/new.zarr"),
    "generate a file": (*BUBBLES, "--shape", 40, "--out", "closed/new.npy"),
    "generate anew": (*BUBBLES, "--shape", 40, "--out", "closed/old.npy"),
    "finish": ("finish", "in.zarr", "--connect", "--out", "closed/new.zarr"),
    "finish anew": ("finish", "in.zarr", "--connect", "--out", "closed/old.zarr"),
    "export": ("export", "in.zarr", "--out", "closed/new.stl"),
    "export in slabs": ("export", "in.zarr", "--out", "closed/new.stl", "--memory", 0.01),
    "export a volume": ("export", "in.zarr", "--out", "closed/new.vti"),
    "render": ("render", "in.zarr", "--size", 64, 48, "--out", "closed/new.png"),
    "render a turn": (
        "render",
        "in.zarr",
        "--size",
        64,
        48,
        "--turntable",
        2,
        "--out",
        "closed/new.gif",
    ),
    "view": ("view", "in.zarr", "--html", "closed/new.html"),
    "verify": ("verify", "in.zarr", "in.zarr", "--quick", "--report", "closed/new.html"),
    "fit": ("fit", "in.zarr", "--method", "noise", "--set", "reach=4", "--out", "closed/new.model"),
}

REFUSED_LATE = [
    pytest.param(name, marks=pytest.mark.whole) if name == "verify" else name for name in COMMANDS
]
"""The same for what is done before the folder refuses: `verify` draws a page first."""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Make a working folder with a volume, and a folder with results that will be closed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "closed").mkdir()
    values = (np.random.default_rng(1).random((40, 40, 40)) < 0.6).astype(np.uint8)
    tb.write(values, "in.zarr")
    tb.write(values, "closed/old.zarr")
    tb.write(values, "closed/old.npy")
    return tmp_path


@pytest.fixture(params=[errno.EROFS, errno.EACCES], ids=errno.errorcode.get)
def closed_folder(place, request, monkeypatch):
    """Let nothing be made or changed in that folder, which the system reports only when it is
    tried.
    """
    folder = place / "closed"

    def guard(real, writes=lambda *words, **more: True):
        def attempt_it(path, *words, **more):
            inside = (
                isinstance(path, (str, os.PathLike)) and folder in (place / os.fspath(path)).parents
            )
            if inside and writes(*words, **more):
                raise OSError(request.param, os.strerror(request.param), os.fspath(path))
            return real(path, *words, **more)

        return attempt_it

    for_writing = lambda mode="r", *words, **more: bool(set(mode) & set("wax+"))  # noqa: E731
    for module in (builtins, io):
        monkeypatch.setattr(module, "open", guard(module.open, for_writing))
    monkeypatch.setattr(
        os,
        "open",
        guard(os.open, lambda flags, *words, **more: bool(flags & (os.O_RDWR | os.O_WRONLY))),
    )
    for name in ("mkdir", "replace", "rename", "unlink", "remove", "rmdir"):
        monkeypatch.setattr(os, name, guard(getattr(os, name)))
    return os.strerror(request.param)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_lets_nobody_write_is_told_before_the_work(place, monkeypatch, command):
    before = contents(place)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(
        "trabecula.io.files.read", lambda *words, **more: pytest.fail("the work was begun")
    )
    assert "no right to write into" in refused(*COMMANDS[command])
    assert contents(place) == before


@pytest.mark.skipif(
    hasattr(os, "geteuid") and os.geteuid() == 0, reason="root may write everywhere"
)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_without_the_right_to_write(place, command):
    before = contents(place)
    (place / "closed").chmod(0o500)
    try:
        assert "no right to write into" in refused(*COMMANDS[command])
    finally:
        (place / "closed").chmod(0o700)
    assert contents(place) == before


@pytest.mark.parametrize("command", REFUSED_LATE)
def test_a_folder_that_refuses_when_it_is_written(place, closed_folder, command):
    before = contents(place)
    told = attempt(*COMMANDS[command])
    assert told.status == 2 and closed_folder in told.lines[-1], told.err
    assert "cannot write" in told.lines[-1] and f"closed{os.sep}" in told.lines[-1]
    assert "Traceback" not in told.err
    assert contents(place) == before


@pytest.mark.parametrize("where", ["target", "scratch"])
def test_what_is_finished_in_slabs(place, closed_folder, monkeypatch, where):
    # As if the whole took more memory than there is, and no array were too small for a file.
    monkeypatch.setattr("trabecula.finish.slabs.in_core_bytes", lambda *words: 1 << 60)
    monkeypatch.setattr("trabecula.engine.memmap.SMALLEST", 1)
    before = contents(place)
    words = (
        ("--out", "closed/old.zarr", "--scratch", ".")
        if where == "target"
        else ("--out", "new.zarr", "--scratch", "closed")
    )
    told = attempt("finish", "in.zarr", "--connect", *words)
    assert (
        told.status == 2 and "cannot write" in told.lines[-1] and closed_folder in told.lines[-1]
    ), told.err
    assert ("--scratch" in told.lines[-1]) == (where == "scratch")
    assert contents(place) == before


def test_a_run_that_cannot_go_on_keeps_its_blocks(place, monkeypatch):
    real, done = blocks.do_task, []

    def stopped(*words, **more):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(words)
        real(*words, **more)

    with monkeypatch.context() as patch:
        patch.setattr(blocks, "do_task", stopped)
        assert (
            attempt(*BUBBLES, "--shape", 70, "--chunks", 32, "--out", "closed/new.zarr").status
            == 130
        )
    before = contents(place)
    with monkeypatch.context() as patch:
        patch.setattr("zarr.storage.LocalStore.set", _refuses)
        told = attempt("generate", "--resume", "closed/new.zarr")
    assert (
        told.status == 2
        and "Read-only file system" in told.lines[-1]
        and "stay in new.zarr.part" in told.lines[-1]
    )
    assert contents(place) == before
    whole = trabecula(*BUBBLES, "--shape", 70, "--out", "whole.npy")
    assert trabecula("generate", "--resume", "closed/new.zarr").sha256 == whole.sha256


async def _refuses(*words, **more):
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))

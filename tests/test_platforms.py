"""Branches for systems that are not this one, with their calls emulated."""

import io
import mmap
import os
import re
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trabecula.cli.terminal import show_certificate
from trabecula.engine import lock, memmap, parallel
from trabecula.exemplar import fetch
from trabecula.view.page import server

PACKAGE = Path(memmap.__file__).resolve().parents[1]
BRANCH = r"os\.name\b|sys\.platform|platform\.system|MADV_|posix_fallocate|sched_getaffinity"


class WithoutCalls:
    """A module of which some names are missing and others differ."""

    def __init__(self, module, *missing, **other):
        self._module, self._missing, self._other = module, missing, other

    def __getattr__(self, name):
        if name in self._missing:
            raise AttributeError(name)
        return self._other.get(name, getattr(self._module, name, None))


def test_every_branch_is_named_here():
    found = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if re.search(BRANCH, path.read_text(encoding="utf-8"))
    }
    assert found == {
        "cli/terminal.py",
        "engine/lock.py",
        "engine/memmap.py",
        "engine/parallel.py",
        "exemplar/fetch.py",
        "view/page/server.py",
    }


@pytest.mark.parametrize(
    ("system", "variable", "folder"),
    [
        ("win32", "LOCALAPPDATA", "trabecula"),
        ("darwin", "HOME", "Library/Caches/trabecula"),
        ("linux", "XDG_CACHE_HOME", "trabecula"),
        ("linux", "HOME", ".cache/trabecula"),
    ],
)
def test_the_cache_is_where_a_system_has_it(tmp_path, monkeypatch, system, variable, folder):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(fetch.sys, "platform", system)
    monkeypatch.setenv(variable, str(tmp_path))
    assert fetch.cache_folder() == tmp_path / folder


@pytest.mark.parametrize("system", ["posix", "nt"])
def test_the_file_of_a_lock_goes_also_where_an_open_file_cannot(tmp_path, monkeypatch, system):
    """Windows refuses to remove an open file: it has to be removed after the release."""
    file = tmp_path / ".x.lock"
    file.write_text("process 1")
    order, unlink = [], Path.unlink
    held = SimpleNamespace(release=lambda: order.append("release"))

    def refuse(path, missing_ok=False):
        order.append("unlink")
        if system == "nt" and "release" not in order:
            raise PermissionError(13, "used by another process")
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse)
    monkeypatch.setattr(lock, "os", WithoutCalls(os, name=system))
    lock._release(held, file)
    assert not file.exists()
    # elsewhere a second removal would take the file of the next who locks
    assert order == ["unlink", "release", "unlink"][: 3 if system == "nt" else 2]


def test_a_locked_file_that_cannot_be_signed_is_locked_all_the_same(tmp_path, monkeypatch):
    def refuse(*words, **named):
        raise PermissionError(13, "locked")

    monkeypatch.setattr(Path, "write_text", refuse)
    with lock.hold_lock(tmp_path / "x.zarr.part"):
        assert (tmp_path / ".x.zarr.part.lock").exists()


def test_pages_stay_where_the_system_cannot_be_told_to_drop_them(tmp_path, monkeypatch):
    monkeypatch.setattr(memmap, "mmap", WithoutCalls(mmap, "MADV_DONTNEED"))
    with memmap.map_large_arrays(tmp_path / "s", memory=1 << 16, thickest=3):
        array = memmap.zeros((20, 30, 40), np.int16)
        array[:] = 7
        memmap.release_pages()
        assert (array == 7).all()
        del array


@pytest.mark.parametrize("free, fits", [(1 << 40, True), (10, False)])
def test_a_system_that_cannot_reserve_a_file_looks_at_the_free_space(
    tmp_path, monkeypatch, free, fits
):
    monkeypatch.setattr(memmap, "os", WithoutCalls(os, "posix_fallocate"))
    monkeypatch.setattr(memmap.shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    with (tmp_path / "x").open("wb") as file:
        if fits:
            memmap._allocate(tmp_path / "x", file.fileno(), 1 << 20)
        else:
            with pytest.raises(OSError, match=re.escape(os.strerror(28))):
                memmap._allocate(tmp_path / "x", file.fileno(), 1 << 20)


def test_cores_are_counted_where_no_process_is_bound_to_some(monkeypatch):
    monkeypatch.delenv("TRABECULA_THREADS", raising=False)
    for count, threads in ((12, 12), (None, 1)):
        emulated = WithoutCalls(os, "sched_getaffinity", cpu_count=lambda count=count: count)
        monkeypatch.setattr(parallel, "os", emulated)
        assert parallel.thread_count() == threads


@pytest.mark.parametrize(
    "system, terminal, colour", [("nt", None, False), ("nt", "1", True), ("posix", None, True)]
)
def test_a_console_that_shows_the_codes_of_colours_gets_none(monkeypatch, system, terminal, colour):
    class Screen(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("trabecula.cli.terminal.os", WithoutCalls(os, name=system))
    for name in ("NO_COLOR", "TERM", "WT_SESSION"):
        monkeypatch.delenv(name, raising=False)
    if terminal:
        monkeypatch.setenv("WT_SESSION", terminal)
    with redirect_stdout(Screen()) as screen:
        show_certificate("part: PASS")
    assert ("\033" in screen.getvalue()) == colour


@pytest.mark.parametrize(
    "system, display, shown",
    [
        ("darwin", False, True),
        ("win32", False, True),
        ("linux", False, False),
        ("linux", True, True),
    ],
)
def test_a_window_opens_on_linux_only_with_a_display(monkeypatch, system, display, shown):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    monkeypatch.setattr(server, "sys", SimpleNamespace(platform=system))
    assert server.has_display() == shown

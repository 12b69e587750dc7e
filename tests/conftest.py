"""Fixtures for every room's tests, and how processes share the work (`pytest -n`)."""

import functools
import os
import random
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

import trabecula as tb
from trabecula.engine import memmap

DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(autouse=True)
def small_work_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Send the small arrays of tests to other processes as well, where there are any."""
    monkeypatch.setattr(memmap, "WORTH_SENDING", 0)


@pytest.fixture
def data() -> Path:
    """Return the folder of real scans; skip tests that need it where it is not there."""
    if not DATA.is_dir():
        pytest.skip("the folder of real scans (../shared/data) is not here")
    return DATA


@pytest.fixture(scope="session")
def bone() -> tb.Image:
    """Return the package's own sample, made once."""
    return tb.sample("bone")


# A first call may compile a kernel, so a time limit on one example says nothing. The suite tries
# the same examples every time; HYPOTHESIS_EXAMPLES=1000 looks for new ones.
_SEARCH = os.environ.get("HYPOTHESIS_EXAMPLES")
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=int(_SEARCH or 100))
settings.load_profile("search" if _SEARCH else "same")


def pytest_addoption(parser):
    parser.addoption("--shuffle", type=int, help="run files, and tests of a file, in random order")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Shuffle tests by the seed that `--shuffle` gives, keeping those of a file together."""
    seed = config.getoption("shuffle")
    if seed is not None:
        rank = random.Random(seed)
        rank.shuffle(items)
        files = sorted({item.path for item in items})
        rank.shuffle(files)
        place = {file: number for number, file in enumerate(files)}
        items.sort(key=lambda item: place[item.path])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give a process the tests of a file one after the other, and of the contract those of a
    method: they share fixtures.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByFixtures(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file, _, test = nodeid.partition("::")
            if file.endswith("contract/test_methods.py"):
                return test.partition("[")[2].partition("-")[0]
            return file

    return ByFixtures(config, log)


def _compile_in_one_process() -> None:
    """Let a process wait for a kernel that another compiles, and load it from the cache."""
    compile_alone = Dispatcher.compile
    folder = Path(__file__).resolve().parents[1] / "build" / "compiling"
    folder.mkdir(parents=True, exist_ok=True)

    @functools.wraps(compile_alone)
    def compile_or_wait(self, signature):
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        # First the lock of this process, as within a compilation: no two wait for each other.
        with global_compiler_lock, FileLock(folder / name):
            return compile_alone(self, signature)

    Dispatcher.compile = compile_or_wait


if "PYTEST_XDIST_TESTRUNUID" in os.environ:
    os.environ.setdefault("TRABECULA_THREADS", "1")  # each process has its core
    _compile_in_one_process()

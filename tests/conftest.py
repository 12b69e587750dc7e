"""Fixtures for every room's tests."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

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
# the same examples every
# time; HYPOTHESIS_EXAMPLES=1000 looks for new ones.
_SEARCH = os.environ.get("HYPOTHESIS_EXAMPLES")
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=int(_SEARCH or 100))
settings.load_profile("search" if _SEARCH else "same")

"""One browser for all tests of a process."""

import chromium
import pytest


@pytest.fixture(scope="session")
def browser():
    running = chromium.Chromium()
    yield running
    running.close()

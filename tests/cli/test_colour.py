"""Verdicts have a colour on a terminal alone."""

import io
from contextlib import redirect_stdout

import pytest

from trabecula.cli.terminal import show_certificate

TEXT = (
    "part.zarr: FAIL in 2 of 40 figures\nporosity  0.7  pass\nthickness  3  FAIL\nwhat a pass means"
)


class Screen(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("WT_SESSION", "1")


def shown(text, screen):
    with redirect_stdout(screen):
        show_certificate(text)
    return screen.getvalue()


def test_verdicts_are_red_and_green():
    text = shown(TEXT, Screen())
    assert text.count("\033[31mFAIL\033[0m") == 2 and "  \033[32mpass\033[0m\n" in text
    assert text.endswith("what a pass means\n")
    assert shown("part: PASS, all", Screen()) == "part: \033[32mPASS\033[0m, all\n"


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_colour_can_be_refused(monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    assert shown(TEXT, Screen()) == TEXT + "\n"


def test_an_empty_no_color_refuses_nothing(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "")
    assert "\033" in shown("FAIL", Screen())


def test_a_pipe_has_no_colour():
    assert shown(TEXT, io.StringIO()) == TEXT + "\n"

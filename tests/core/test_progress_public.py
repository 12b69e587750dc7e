"""`tb.progress`: a function, or a line that is rewritten."""

import pytest

import trabecula as tb
from trabecula.core.progress import Fraction, ProgressLine, notify, track


def test_a_function_hears_stages_and_lines():
    heard = []
    with tb.progress(lambda label, fraction: heard.append((label, fraction))):
        list(track(range(2), "layers"))
        notify("a notice")
    assert heard == [("layers", 0), ("layers", 0.5), ("layers", 1), ("a notice", -1)]
    list(track(range(2), "outside"))
    assert len(heard) == 4


def test_an_error_of_the_listener_ends_the_work():
    class CancelledError(Exception):
        pass

    def cancel(label, fraction):
        if fraction >= 0.5:
            raise CancelledError

    done = []
    with pytest.raises(CancelledError), tb.progress(cancel):
        for n in track(range(4), "layers"):
            done.append(n)
    assert done == [0, 1]


def test_the_line_has_percent_and_time_left_and_goes(capsys):
    now = iter([0.0, 0.0, 0.0, 10.0, 10.0, 10.0])
    line = ProgressLine(lambda: next(now))
    line("layers", Fraction(0, 4))
    line("layers", Fraction(1, 4))
    assert capsys.readouterr().err.split("\r")[-1] == "layers  25%, 30 s left"
    line.end()
    assert capsys.readouterr().err.endswith("\r")
    line.end()
    assert capsys.readouterr().err == ""


def test_without_a_function_it_writes_beside_the_output(capsys):
    with tb.progress():
        list(track(range(3), "layers"))
        notify("a notice")
    shown = capsys.readouterr()
    assert shown.out == "" and "layers" in shown.err and "a notice" in shown.err


def test_what_cannot_be_called_is_refused():
    with pytest.raises(tb.errors.InputError, match="a function of a label"), tb.progress(3):
        pass

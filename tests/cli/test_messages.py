"""What is shown of a run, and what its log holds."""

import io
import re

import pytest

import trabecula as tb
from commands import attempt, refused, trabecula
from trabecula.cli import messages
from trabecula.cli.messages import Messages, brief_time, messages_shown, note
from trabecula.core.progress import Fraction, listen, notify, part, report, track, whole_run

MADE = ("generate", "--method", "noise", "--shape", 16, "--out")


class Screen(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self):
        return True


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def work():
    for _ in track(range(4), "layers"):
        note("a notice")


def test_quiet_leaves_results_and_errors(here):
    usual = trabecula("samples")
    quiet = trabecula("samples", "--quiet")
    assert quiet.out == usual.out and quiet.err == ""
    assert "unknown sample" in refused("inspect", "sample:bon", "--quiet")


def test_quiet_holds_back_notices(capsys):
    with messages_shown(quiet=True):
        work()
        notify("compiling")
        messages.fail("an error")
    assert capsys.readouterr().err == "trabecula: an error\n"


def test_verbose_times_every_stage(here):
    lines = trabecula(*MADE, "a.npy", "--verbose").lines
    assert re.fullmatch(r"trabecula: done: [\d.]+ s", lines[-1])
    with messages_shown(verbose=True):
        pass


def test_a_stage_has_one_line_at_its_end(capsys):
    with messages_shown(verbose=True):
        list(track(range(3), "layers"))
    assert re.fullmatch(r"trabecula: layers: [\d.]+ s\n", capsys.readouterr().err)


def test_the_log_has_dates_and_grows(here):
    for name in ("a.npy", "b.npy"):
        assert trabecula(*MADE, name, "--quiet", "--log", "log.txt").lines == []
    refused(*MADE, "c.doc", "--log", "log.txt")
    lines = (here / "log.txt").read_text().splitlines()
    assert all(re.match(r"20\d\d-\d\d-\d\d \d\d:\d\d:\d\d \w", line) for line in lines)
    assert sum(" done: " in line for line in lines) == 2 and "unknown format" in lines[-1]


def test_a_log_that_cannot_be_written_is_refused(here):
    assert "--log no/log.txt: No such file" in refused(*MADE, "a.npy", "--log", "no/log.txt")
    assert not (here / "a.npy").exists()


def test_quiet_and_verbose_exclude_each_other():
    assert "not allowed with" in attempt("samples", "--quiet", "--verbose").err


def test_kinds_of_a_verb_take_them_before_and_after(here):
    field = ("ramp", "--shape", 8, "--from", 0, "--to", 1, "--out", "f.npy")
    before = attempt("field", "--log", "one.txt", *field)
    after = attempt("field", *field, "--log", "two.txt")
    assert before.status == after.status == 0
    assert (here / "one.txt").exists() and (here / "two.txt").exists()


def test_without_a_terminal_a_line_says_how_far_it_is(capsys, monkeypatch):
    monkeypatch.setattr(messages, "_PAUSE", 0.0)
    with messages_shown():
        for layer in track(range(4), "layers"):
            capsys.readouterr() if layer < 3 else None
        report("training", 0.5)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "trabecula: layers 3 of 4, 0.0 s left"
    assert lines[1] == "trabecula: training 50%"


def test_lines_are_far_apart(capsys):
    with messages_shown():
        list(track(range(1000), "layers"))
    assert capsys.readouterr().err == ""


def test_a_bar_says_the_time_left(monkeypatch):
    screen = Screen()
    monkeypatch.setattr("sys.stderr", screen)
    now = iter((0.0, 60.0))
    shown = Messages()
    shown.clock._now = lambda: next(now)
    shown("layers", Fraction(0, 4))
    shown.drawn = 0.0
    shown("layers", Fraction(1, 4))
    bar = screen.getvalue().split("\r")[-1]
    assert bar.startswith("layers  ") and "[#####..............." in bar and "25% 3 min left" in bar
    assert len(bar) < 80
    shown.clear()
    assert screen.getvalue().endswith("\r")


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.04, "0.0 s"), (42, "42 s"), (130, "2 min"), (9000, "2.5 h")]
)
def test_times_are_brief(seconds, text):
    assert brief_time(seconds) == text


def test_a_run_has_one_bar(monkeypatch):
    screen = Screen()
    monkeypatch.setattr("sys.stderr", screen)
    shown = Messages()
    monkeypatch.setattr(shown, "drawn", -1.0)
    with listen(shown), whole_run("reading"), part(0.5, 1):
        shown.drawn = -1.0
        report("making", 0.5)
    assert "reading" in screen.getvalue() and " 75%" in screen.getvalue()


def test_a_log_says_how_far_the_run_is(capsys, monkeypatch):
    monkeypatch.setattr(messages, "_PAUSE", 0.0)
    with messages_shown(), whole_run("reading"), part(0.5, 1):
        list(track("ab", "making"))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "trabecula: reading 0%, 0% of the run"
    assert lines[2].startswith("trabecula: making 1 of 2, 75% of the run, ")


@pytest.mark.whole
@pytest.mark.parametrize("method", ["texture", "kopf"])
def test_the_bar_of_a_method_never_restarts(method):
    exemplar = tb.crop(tb.sample("bone"), 32)
    if method == "kopf":
        exemplar = tb.labels(exemplar.values[16])
    places = []

    def hear(label, fraction):
        if fraction >= 0:
            places.append(fraction.run.reached)

    model = tb.method(method).fit(exemplar)
    with listen(hear):
        model.generate(20, seed=1)
    assert places == sorted(places) and places[0] == 0 and places[-1] == 1
    assert len(set(places)) > 5  # it moves in steps, not from 0 to 1

"""The help of every verb."""

import shlex

import pytest

from commands import attempt
from trabecula.cli import main
from trabecula.cli.examples import EXAMPLES


def test_every_verb_has_two_examples():
    assert list(EXAMPLES) == list(main.VERBS)
    assert all(len(lines) == 2 for lines in EXAMPLES.values())


@pytest.mark.parametrize("verb", main.VERBS)
def test_examples_have_options_that_are_there(verb):
    for line in EXAMPLES[verb]:
        words = shlex.split(line.partition(" >")[0])
        assert words[:2] == ["trabecula", verb]
        main._parser(verb)[0].parse_args(words[1:])


def test_help_ends_with_the_examples_line_by_line(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    text = attempt("finish", "--help").out
    assert text.endswith("examples:\n  " + "\n  ".join(EXAMPLES["finish"]) + "\n")
    assert all(len(line) <= 40 for line in text.partition("examples:")[0].splitlines()[:2])

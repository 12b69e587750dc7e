"""Hold the package to `docs/guide/vocabulary.md`: docstrings, names, lines, words."""

from __future__ import annotations

import argparse
import ast
import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
VOCABULARY = ROOT / "docs" / "guide" / "vocabulary.md"

IMPERATIVE, RELATIVE, PARTICIPLES = 0.85, 0.02, 0.03
"""Least share of docstrings that begin with an imperative; largest shares of docstrings that begin
with a relative clause and of functions that are named by a participle."""

WORDS = (50, 80)
"""Fewest and most words of the vocabulary."""

PLAIN = {
    "dear": "expensive",
    "dearer": "more expensive",
    "dearest": "most expensive",
    "hang together": "are connected",
    "hangs together": "is connected",
    "what is asked for": "the request",
    "what was asked for": "the request",
    "goes on": "resumes, continues",
    "went on": "resumed, continued",
    "gone on with": "resumed",
    "go on with": "resume",
    "maker": "generator",
    "told": "reported, given",
}
"""Words that mean something else in the field, or nothing, each with the plain one. "Lies",
"pieces", "bodies" and "judge" are left out: they have a usual meaning as well."""

ALLOWED = frozenset(
    {
        # (file below the repository, words)
    }
)
"""Places at which a word of `PLAIN` has its usual meaning."""


def _load_figures():
    spec = importlib.util.spec_from_file_location("language_figures", HERE / "figures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


figures = _load_figures()
PACKAGE_FILES = figures.python_files(figures.PACKAGE)


@pytest.mark.whole
def test_docstrings_begin_with_an_imperative():
    figure = figures.imperative_docstrings(PACKAGE_FILES)
    assert 1 - figure.share >= IMPERATIVE, "\n".join(figure.places)


@pytest.mark.whole
def test_docstrings_begin_with_no_relative_clause():
    figure = figures.relative_clauses(PACKAGE_FILES)
    assert figure.share <= RELATIVE, "\n".join(figure.places)


def test_functions_are_not_named_by_participles():
    figure = figures.participle_names(PACKAGE_FILES)
    assert figure.share <= PARTICIPLES, "\n".join(figure.places)


def test_no_class_name_stands_in_two_modules():
    figure = figures.shared_class_names(PACKAGE_FILES)
    assert figure.count == 0, "\n".join(figure.places)


def test_no_line_is_too_long():
    figure = figures.long_lines(PACKAGE_FILES)
    assert figure.count == 0, "\n".join(figure.places)


def test_no_two_test_files_have_one_name():
    """Pytest imports them by their names, so that the second one could not be collected."""
    counts = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert not [name for name, count in counts.items() if count > 1]


def test_vocabulary_has_one_meaning_for_each_word():
    entries = vocabulary()
    words = Counter(word for names, _ in entries for word in names.split(", "))
    assert [word for word, count in words.items() if count > 1] == []
    meanings = Counter(meaning for _, meaning in entries)
    assert [meaning for meaning, count in meanings.items() if count > 1 or not meaning] == []
    assert WORDS[0] <= len(entries) <= WORDS[1], len(entries)


def test_vocabulary_has_none_of_the_private_words():
    assert [word for names, _ in vocabulary() for word in names.split(", ") if word in PLAIN] == []


@pytest.mark.whole
def test_docstrings_use_plain_words():
    texts = {_shown(path): "\n".join(_docstrings(path)) for path in PACKAGE_FILES}
    assert _private_words(texts) == []


def test_help_uses_plain_words():
    main = importlib.import_module("trabecula.cli.main")
    texts = {f"trabecula {verb}": "\n".join(_help(main._parser(verb)[0])) for verb in main.VERBS}
    assert _private_words(texts) == []


def test_pages_use_plain_words():
    pages = [
        *sorted((ROOT / "docs" / "guide").glob("*.md")),
        *sorted((ROOT / "docs" / "howto").glob("*.md")),
        *sorted(figures.PACKAGE.rglob("*.md")),
        *(ROOT / name for name in ("docs/index.md", "README.md", "CONTRIBUTING.md")),
    ]
    assert _private_words({_shown(path): path.read_text(encoding="utf-8") for path in pages}) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a dear step", ["dear"]),
        ("The run\ngoes on.", ["goes on"]),
        ("two-dearth, makers of", []),
    ],
)
def test_private_words_are_whole_words(text, found):
    assert _private_words({"here": text}) == [
        f"here: {word!r}: say {PLAIN[word]}" for word in found
    ]


def vocabulary() -> list[tuple[str, str]]:
    """List the words of the vocabulary page with their meanings."""
    rows = re.findall(r"^\| (.+?) \| (.*?) \|$", VOCABULARY.read_text(encoding="utf-8"), re.M)
    return [(word, meaning.strip()) for word, meaning in rows if word != "word"]


def _private_words(texts: dict[str, str]) -> list[str]:
    return [
        f"{place}: {word!r}: say {plain}"
        for place, text in texts.items()
        for word, plain in PLAIN.items()
        if (place, word) not in ALLOWED
        and re.search(rf"\b{word}\b".replace(" ", r"\s+"), text, re.IGNORECASE)
    ]


def _docstrings(path: Path) -> Iterator[str]:
    """Yield every string that stands alone: docstrings, and the texts below fields."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield str(node.value.value)


def _help(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield from (parser.description or "", parser.epilog or "")
    for action in parser._actions:
        yield str(action.help or "")
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _help(inner)


def _shown(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()

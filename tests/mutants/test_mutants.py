"""The entries of `mutants.toml` still apply to the package and to its tests."""

import ast
from pathlib import Path

import pytest
from mutate import ROOT, SOURCE, read_entries

ENTRIES = read_entries()


def test_there_are_enough():
    assert len(ENTRIES) >= 150
    assert len({(entry.file, entry.old, entry.new) for entry in ENTRIES}) == len(ENTRIES)


@pytest.mark.parametrize("room", sorted({entry.room for entry in ENTRIES}))
def test_each_applies_once_and_names_tests_that_are_there(room):
    for entry in ENTRIES:
        if entry.room == room:
            text = entry.apply((SOURCE / "trabecula" / entry.file).read_text())
            if entry.file.endswith(".py"):
                ast.parse(text)
            for test in entry.tests:
                path, *name = test.partition("[")[0].split("::")
                text = Path(ROOT / path).read_text()
                assert all(f"def {part}(" in text for part in name), test

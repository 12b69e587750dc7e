"""What the package says of the versions that it works with."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def parts(requirement):
    """Name, operator, release without zeros at its end, and marker of a requirement."""
    text, _, marker = requirement.partition(";")
    name, operator, release = re.fullmatch(r"([\w.-]+?)(>=|==)([\d.]+)", text.strip()).groups()
    return name, operator, re.sub(r"(\.0)+$", "", release), re.sub(r"[\s'\"]", "", marker)


def test_the_oldest_versions_that_are_tried_are_the_lower_bounds():
    lines = (ROOT / "requirements" / "oldest.txt").read_text(encoding="utf-8").splitlines()
    tried = [parts(line) for line in lines if not line.startswith("#")]
    bounds = [parts(requirement) for requirement in PROJECT["dependencies"]]
    assert {one[1] for one in tried} == {"=="} and {one[1] for one in bounds} == {">="}
    assert [(name, release, marker) for name, _, release, marker in tried] == [
        (name, release, marker) for name, _, release, marker in bounds
    ]


def test_the_pythons_that_are_named_begin_with_the_oldest_that_is_allowed():
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert PROJECT["requires-python"] == f">={named[0]}" and named == sorted(
        named, key=lambda one: int(one[2:])
    )

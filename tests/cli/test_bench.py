"""`trabecula bench`: which cases run, from where, and what is refused."""

import json
from pathlib import Path

import pytest

import trabecula as tb
from commands import attempt

_SCRIPT = """
import os, sys
print(*sys.argv[1:], os.environ.get("TRABECULA_BENCH_OUT"))
sys.exit(3)
"""


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder like a checkout that the package is installed from, with benchmarks that only
    print their arguments.
    """
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "run.py").write_text(_SCRIPT)
    monkeypatch.setattr(tb, "__file__", str(tmp_path / "src" / "trabecula" / "__init__.py"))
    return tmp_path


@pytest.mark.whole
def test_a_word_stands_for_every_case_that_begins_so(capfd):
    output = attempt("bench", "--list", "texture")
    names = [line.split()[0] for line in capfd.readouterr().out.splitlines()]
    assert output.status == 0
    assert {"texture_fidelity", "texture_speed"} <= set(names)
    assert all(name.startswith("texture") for name in names)


@pytest.mark.whole
def test_every_case_is_listed_once_with_what_it_shows(capfd):
    attempt("bench", "--list")
    rows = [line.split(maxsplit=1) for line in capfd.readouterr().out.splitlines()]
    assert len({row[0] for row in rows}) == len(rows)
    assert all(len(row) == 2 for row in rows)


@pytest.mark.whole
def test_an_unknown_case_is_refused_with_the_nearest(capfd):
    output = attempt("bench", "texture_sped")
    told = capfd.readouterr()
    assert output.status == 2
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert "did you mean 'texture_speed'?" in told.err


def test_cases_and_folder_are_passed_on_and_the_status_comes_back(checkout, capfd):
    output = attempt("bench", "one", "two", "--out", checkout / "pictures")
    assert output.status == 3
    assert capfd.readouterr().out.split() == ["one", "two", str(checkout / "pictures")]


def test_parts_of_a_case_are_passed_on(checkout, monkeypatch, capfd):
    """Pass them by name, so that a case need not be run whole."""
    script = (
        "import json, os; print(json.dumps({name[16:]: value for name, value in os.environ.items() "
        "if name.startswith('TRABECULA_BENCH_')}))"
    )
    (checkout / "benchmarks" / "run.py").write_text(script)
    monkeypatch.delenv("TRABECULA_BENCH_OUT", raising=False)
    attempt("bench", "image", "--only", "bread 2", "rods", "--methods", "mrf:fast", "--side", 32)
    told = json.loads(capfd.readouterr().out)
    assert told == {"ONLY": "bread 2;rods", "METHODS": "mrf:fast", "SIDE": "32"}
    attempt("bench", "papers", "--run", "weights", "repeat")
    assert json.loads(capfd.readouterr().out) == {"RUN": "weights;repeat"}


def test_an_installed_package_says_where_the_benchmarks_are(checkout):
    (checkout / "benchmarks" / "run.py").unlink()
    output = attempt("bench")
    assert output.status == 2
    assert len(output.lines) == 1
    assert "repository" in output.lines[0]

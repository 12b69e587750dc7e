"""The list of quoted figures: its words stand in their files, and what moved is found."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def quoted():
    place = ROOT / "benchmarks" / "quoted.py"
    spec = importlib.util.spec_from_file_location("quoted", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_words_and_figures_stand_in_their_files(quoted):
    for entry in quoted.read():
        assert entry["measure"] in quoted.MEASURES
        assert quoted.compare(entry, entry["figures"]) == []
        numbers = [float(one) for one in re.findall(r"\d+(?:\.\d+)?", entry["text"])]
        assert set(entry["figures"].values()) <= set(numbers)


def test_what_moved_is_found(quoted, tmp_path):
    (tmp_path / "a.md").write_text("It takes 10 s.")
    entry = {"file": "a.md", "text": "takes 10 s", "figures": {"seconds": 10}, "within": 0.1}
    assert quoted.compare(entry, {"seconds": 10.9}, tmp_path) == []
    (fault,) = quoted.compare(entry, {"seconds": 11.2}, tmp_path)
    assert "quoted as 10, and 11.2 was measured" in fault
    (tmp_path / "a.md").write_text("It takes 12 s.")
    (fault,) = quoted.compare(entry, {"seconds": 10}, tmp_path)
    assert "does not say" in fault


def test_what_is_read_from_files(quoted):
    assert quoted.measure_extras() == {"lowest": 2.6, "pinned": 2.13}


def test_every_row_of_the_readme_is_measured(quoted):
    table = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Figures")[2]
    rows = [line for line in table.partition("## ")[0].splitlines() if line.startswith("| ")]
    texts = [entry["text"] for entry in quoted.read() if entry["file"] == "README.md"]
    for row in rows[1:]:
        assert any(text in row for text in texts), row


def test_the_table_of_materials_is_summed_up(quoted):
    assert quoted.sum_materials() == {
        "materials": 14,
        "figures": 3399,
        "percent": 98.7,
    }

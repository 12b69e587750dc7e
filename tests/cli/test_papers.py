"""The page "The five papers, reproduced": its results, its inventory, and that it is what the
command writes.
"""

import importlib
import json
import re
import socket
from pathlib import Path

import pytest

from trabecula.core.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "benchmarks"
RESULTS = sorted((BENCHMARKS / "results" / "papers").glob("*.json"))
PICTURES = ROOT / "docs" / "images" / "papers"
PAGE = ROOT / "docs" / "guide" / "papers.md"


@pytest.fixture
def module(monkeypatch):
    """Return what imports a module of the benchmarks."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_result_says_where_it_comes_from(path):
    found = json.loads(path.read_text())
    assert found["name"] == path.stem
    assert found["command"] == f"trabecula bench papers --run {path.stem}"
    assert re.fullmatch(r"[0-9a-f]{7,40}\+?", found["commit"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", found["date"])
    assert {"processor", "cores", "memory_gib", "threads", "python"} <= set(found["machine"])
    assert found["seconds"]["wall" if "gpu" in found["machine"] else "processor"] > 0
    assert any(table["rows"] for table in found["tables"])
    for table in found["tables"]:
        assert {len(row) for row in table["rows"]} <= {len(table["heads"])}


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_a_result_names_no_machine_and_no_folder(path):
    text = path.read_text()
    assert socket.gethostname() not in text
    assert not re.search(r"/(home|root|tmp|work|Users)/", text)


def test_the_page_is_what_the_command_writes(module):
    written = module("papers_page").page()
    assert PAGE.read_text(encoding="utf-8") == written, (
        "write it again: trabecula bench papers --out docs/guide"
    )


def test_the_inventory_leaves_no_table_and_no_figure_out(module):
    papers = module("papers_inventory").PAPERS
    assert [paper.method for paper in papers] == ["texture", "gan", "mrf", "quilt", "bubbles"]
    for paper in papers:
        names = [item.name for item in paper.items]
        assert len(set(names)) == len(names)
        figures = {f"figure {number}" for number in range(1, paper.figures + 1)}
        tables = {f"table {number}" for number in range(1, paper.tables + 1)}
        numbered = {name for name in names if name.startswith(("figure", "table"))}
        assert numbered == figures | tables


def test_what_is_measured_has_a_run_and_what_is_not_a_reason(module):
    inventory = module("papers_inventory")
    for paper in inventory.PAPERS:
        for item in paper.items:
            assert item.state in inventory.STATES
            assert bool(item.runs) == (item.state in (inventory.MEASURED, inventory.DRAWN))
            if item.state in (inventory.NOT_MEASURED, inventory.NOT_COMPARABLE):
                assert item.note


def test_every_run_of_the_inventory_is_saved_and_no_other(module):
    papers = module("papers_inventory").PAPERS
    named = {run for paper in papers for item in paper.items for run in item.runs}
    assert named == {path.stem for path in RESULTS}


@pytest.mark.whole
def test_every_saved_run_can_be_made_again(module):
    assert {path.stem for path in RESULTS} == set(module("papers_runs").RUNS)


def test_every_picture_is_shown_and_small(module):
    shown = re.findall(r"images/papers/([\w-]+\.png)", PAGE.read_text(encoding="utf-8"))
    assert len(set(shown)) == len(shown)
    assert set(shown) == {path.name for path in PICTURES.glob("*")}
    assert sum(path.stat().st_size for path in PICTURES.glob("*")) < 1.5e6


def test_a_run_that_was_never_saved_is_named_with_its_command(module, monkeypatch, tmp_path):
    saved = module("papers_saved")
    monkeypatch.setattr(saved, "FOLDER", tmp_path)
    with pytest.raises(InputError, match="trabecula bench papers --run weights"):
        saved.load("weights")


def test_a_row_that_is_missing_fails_the_page(module):
    common, saved = module("common"), module("papers_saved")
    one = saved.Saved("x", "", "", "", {}, {}, (common.Table(["what", "s"], [["bone", "1.5"]]),))
    assert one.cell("bone", "s") == "1.5"
    with pytest.raises(InputError, match="run it again"):
        one.cell("foam", "s")
    with pytest.raises(InputError, match="run it again"):
        one.cell("bone", "bytes")


def test_a_measured_run_keeps_what_the_case_printed(module, monkeypatch, tmp_path, capsys):
    common, saved = module("common"), module("papers_saved")
    monkeypatch.setattr(saved, "FOLDER", tmp_path)

    def case():
        row = common.table("what", "s")
        row("bone", 1.5)

    saved.measure("one", case)
    found = saved.load("one")
    assert found.tables[0].heads == ["what", "s"]
    assert found.tables[0].rows == [["bone", "1.5"]]
    assert found.cell("bone", "s", table="what") == "1.5"
    assert "bone" in capsys.readouterr().out


def test_outside_of_a_record_nothing_is_kept(module):
    common = module("common")
    with common.recorded() as tables:
        pass
    common.table("what", "s")("bone", 1)
    assert tables == []


@pytest.mark.parametrize(
    ("paper", "ours", "wanted", "verdict"),
    [
        ("8.97", "5.2 (4.4 - 5.6)", "less", "better"),
        ("8.97", "12.1", "less", "worse"),
        (".998", "0.99", "more", "worse"),
        ("5.0", "5.0", "less", "alike"),
        ("8.97", "not measured", "less", ""),
        ("8.97", "5.2", "", ""),
    ],
)
def test_verdicts(module, paper, ours, wanted, verdict):
    row = module("papers_rows").Row("bone: D2", paper, ours, wanted=wanted)
    assert row.verdict == verdict

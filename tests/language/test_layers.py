"""Who imports whom, file by file: no circle, no arrow up. Imports inside functions count as well.

import-linter checks the rooms; a circle among the files of one room it does not see.
"""

import tomllib

import pytest
from figures import PACKAGE, ROOT, circles, imports, module_name, python_files

BESIDE = {"trabecula", "trabecula.__main__", "trabecula.errors", "trabecula.models"}
"""Modules outside the layers: they hold names and files, and no work."""


@pytest.fixture(scope="module")
def graph():
    """Return the modules that each module of the package imports."""
    return imports(python_files(PACKAGE))


def layers():
    """List the layers of the import contract, the highest first, each as its rooms."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    found = next(one["layers"] for one in contracts if one["type"] == "layers")
    return [[room.strip() for room in row.split("|")] for row in found]


def room_of(module):
    """Return the room (trabecula.ROOM) of a module."""
    return ".".join(module.split(".")[:2])


def arrows_up(graph, rows):
    """List the imports that go to a higher layer, or to another room of the same one."""
    height = {room: len(rows) - number for number, row in enumerate(rows) for room in row}
    return [
        f"{module} -> {target}"
        for module, targets in sorted(graph.items())
        for target in sorted(targets)
        if room_of(module) in height
        and room_of(target) in height
        and room_of(module) != room_of(target)
        and height[room_of(target)] >= height[room_of(module)]
    ]


def test_no_files_import_each_other_in_a_circle(graph):
    assert circles(graph) == []


def test_no_import_goes_up(graph):
    assert arrows_up(graph, layers()) == []


def test_every_module_belongs_to_a_layer(graph):
    rooms = {room for row in layers() for room in row}
    strays = {module for module in graph if room_of(module) not in rooms} - BESIDE
    assert not strays, "add its room to the layers in pyproject.toml"


def test_the_check_finds_a_circle_and_an_arrow_up():
    rows = [["p.top"], ["p.left", "p.right"], ["p.low"]]
    graph = {
        "p.top.a": {"p.left.a", "p.low"},
        "p.left.a": {"p.right.a", "p.left.b"},
        "p.left.b": {"p.left.a"},
        "p.right.a": {"p.low"},
        "p.low": {"p.top.a"},
    }
    assert arrows_up(graph, rows) == ["p.left.a -> p.right.a", "p.low -> p.top.a"]
    del graph["p.low"]
    assert circles(graph) == [["p.left.a", "p.left.b"]]


@pytest.mark.parametrize("deferred", [True, False])
def test_an_import_inside_a_function_counts(tmp_path, monkeypatch, deferred):
    monkeypatch.setattr("figures.PACKAGE", tmp_path / "p")
    (tmp_path / "p").mkdir()
    for name, text in {
        "__init__": "",
        "a": "def work():\n    from p.b import x\n    return x\n",
        "b": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import p.a\nx = 1\n",
    }.items():
        (tmp_path / "p" / f"{name}.py").write_text(text)
    files = python_files(tmp_path / "p")
    assert [module_name(file) for file in files] == ["p", "p.a", "p.b"]
    graph = imports(files, deferred=deferred)
    assert graph["p.a"] == ({"p.b"} if deferred else set()) and graph["p.b"] == set()

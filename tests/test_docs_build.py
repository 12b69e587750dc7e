"""The build of the documentation: passed examples are left out, failed ones stop nothing."""

import importlib.util
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.fixture
def steps(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    for name in [name for name in sys.modules if name.partition(".")[0] == "steps"]:
        monkeypatch.delitem(sys.modules, name)
    from steps import cache, examples

    return cache, examples


def page(folder, name, code, shown):
    path = folder / name
    path.write_text(f"# Page\n\n```python\n{code}\n```\n\n```text\n{shown}\n```\n")
    return path


@pytest.fixture
def quick(steps, monkeypatch):
    monkeypatch.setattr(steps[1], "stand_ins", lambda folder: None)
    return steps


def test_a_passed_page_is_run_again_only_after_a_change(quick, tmp_path):
    cache, examples = quick
    source, count = tmp_path / "code.py", tmp_path / "count"
    source.write_text("1")
    good = page(tmp_path, "good.md", f"open({str(count)!r}, 'a').write('x')\nprint(2)", "2")

    def run():
        kept = cache.ExampleCache(tmp_path / "kept", [source])
        assert examples.run([good], home=tmp_path, cache=kept) == {}
        return len(count.read_text())

    assert [run(), run()] == [1, 1]
    good.write_text("Other words.\n\n" + good.read_text())
    assert run() == 2  # lines have moved: errors name them
    source.write_text("2")
    assert [run(), run()] == [3, 3]


def test_a_failed_page_is_named_and_the_others_run(quick, tmp_path):
    cache, examples = quick
    kept = cache.ExampleCache(tmp_path / "kept", [])
    bad = page(tmp_path, "bad.md", "print(1)", "2")
    good = page(tmp_path, "good.md", "print(2)", "2")
    for _ in range(2):  # what failed is not kept
        failures = examples.run([bad, good], home=tmp_path, cache=kept)
        assert list(failures) == ["bad.md"] and failures["bad.md"].startswith("bad.md:")
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_failure_is_shown_on_top_of_its_page(tmp_path):
    spec = importlib.util.spec_from_file_location("docs_conf", DOCS / "conf.py")
    conf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(conf)
    conf._FAILED = tmp_path / "failed.json"
    conf._FAILED.write_text('{"docs/howto/big.md": "docs/howto/big.md:9: ValueError: no"}')
    source = ["# Big"]
    conf.show_failure(None, "howto/big", source)
    assert source[0].startswith("~~~~{error}") and "ValueError: no" in source[0]
    assert source[0].endswith("# Big")
    other = ["# Other"]
    conf.show_failure(None, "howto/other", other)
    assert other == ["# Other"]


def test_links_that_lead_nowhere_and_remote_files_are_found(steps, tmp_path):
    from steps import links

    (tmp_path / "a.html").write_text(
        '<p id="top"><a href="b.html#here">b</a><a href="c.html">c</a><a href="b.html#gone">b</a>'
        '<a href="https://example.org">far</a><a href="#top">top</a>'
        '<img src="https://example.org/x.png"><img src="x.png">'
    )
    (tmp_path / "b.html").write_text('<h1 id="here">b</h1>')
    assert links.check(tmp_path.resolve()) == [
        "a.html: loads https://example.org/x.png from elsewhere",
        "a.html: c.html leads nowhere",
        "a.html: b.html#gone: there is no such place on that page",
        "a.html: x.png leads nowhere",
    ]


def test_a_tutorial_shows_what_its_cells_gave_and_is_a_notebook(quick, tmp_path):
    import json

    cache, examples = quick
    from steps import notebooks

    code = (
        "import numpy as np\nimport trabecula as tb\nprint(1 + 1)\n"
        "tb.Image(np.zeros((8, 8, 3), np.uint8), 'colour')"
    )
    folder = tmp_path / "docs" / "tutorials"
    folder.mkdir(parents=True)
    path = folder / "one.md"
    path.write_text(f"# One\n\nWords.\n\n```python\n{code}\n```\n\nMore.\n")
    kept = cache.ExampleCache(tmp_path / "kept", [])
    place = tmp_path / "docs" / "made" / "tutorials" / "one"
    for _ in range(2):  # made, and put back from the cache
        assert examples.run([path], home=tmp_path, cache=kept) == {}
        shown = notebooks.with_outputs(path.read_text(), place, "one")
        assert "```text\n2\n```" in shown and "cell-6.png)" in shown
        cells = json.loads((place / "one.ipynb").read_text())["cells"]
        assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "markdown"]
        kinds = [output["output_type"] for output in cells[1]["outputs"]]
        assert kinds == ["stream", "display_data"] and cells[1]["source"] == code
        (place / "one.ipynb").unlink()


def test_a_picture_that_no_example_made_fails_its_page(quick, tmp_path):
    _, examples = quick
    path = tmp_path / "howto" / "page.md"
    path.parent.mkdir()
    name = "../made/howto/page/shown.png"
    path.write_text(f"# Page\n\n```python\nprint(1)\n```\n\n![a picture]({name})\n")
    (failure,) = examples.run([path], home=tmp_path).values()
    assert "the page shows shown.png, which no example made" in failure

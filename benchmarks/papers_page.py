"""The page "The five papers, reproduced", from saved results: every figure of ours is a cell of
one.

`page()` returns its text; `docs/guide/papers.md` is that text, and a test compares the two.
"""

from __future__ import annotations

import papers_2014
import papers_2017
import papers_2021
import papers_baravalle
import papers_liu
from papers_inventory import DRAWN, MEASURED, NOT_COMPARABLE, NOT_MEASURED, PAPERS, Item, Paper
from papers_rows import Section, table, words
from papers_saved import Saved, load

CHAPTERS = {
    "2017": papers_2017.sections,
    "2021": papers_2021.sections,
    "2014": papers_2014.sections,
    "Liu 2016": papers_liu.sections,
    "Baravalle 2016": papers_baravalle.sections,
}


def page() -> str:
    """Return the page.

    Raises
    ------
    InputError
        A run was never saved, or has no such row.
    """
    sections = {paper.key: list(CHAPTERS[paper.key]()) for paper in PAPERS}
    parts = [_head(sections)]
    for paper in PAPERS:
        found = words(f"paper {paper.key}")
        parts.append(f"## {paper.title}: `{paper.method}`\n\n{found['words'].strip()}")
        parts += [section.text() for section in sections[paper.key]]
        parts.append(_inventory(paper))
    parts.append(_runs())
    found = words("pictures")
    parts.append(f"## {found['title']}\n\n{found['words'].strip()}")
    return "\n\n".join(parts) + "\n"


def _head(sections: dict[str, list[Section]]) -> str:
    rows = []
    for paper in PAPERS:
        found = [row.verdict for section in sections[paper.key] for row in section.rows]
        states = [item.state for item in paper.items]
        counts = [found.count(word) for word in ("better", "alike", "worse")]
        counts += [states.count(s) for s in (MEASURED, DRAWN, NOT_MEASURED, NOT_COMPARABLE)]
        name = f"`{paper.method}`, {paper.key.split()[-1]}"
        rows.append([name, *map(str, counts), words(f"paper {paper.key}")["short"]])
    heads = (
        "",
        "figures better than printed",
        "alike",
        "worse",
        "items measured",
        "drawn",
        "not measured",
        "not comparable",
        "in short",
    )
    found = words("page")
    return f"# {found['title']}\n\n{found['words'].strip()}\n\n{table(heads, rows)}"


def _inventory(paper: Paper) -> str:
    def where(item: Item) -> str:
        runs = ", ".join(f"`{run}`" for run in item.runs)
        return "; ".join(part for part in (runs, item.note) if part)

    rows = [[item.name, item.shows, item.state, where(item)] for item in paper.items]
    title = f"### All that it numbers: {paper.key.replace(' ', ', ')}"
    return f"{title}\n\n" + table(("", "shows", "here", "run, or why not"), rows)


def _runs() -> str:
    names = dict.fromkeys(run for paper in PAPERS for item in paper.items for run in item.runs)
    rows = []
    for one in map(load, names):
        seconds = (
            f"{one.seconds[clock]:.0f}" if clock in one.seconds else "not noted"
            for clock in ("processor", "wall")
        )
        rows.append([f"`{one.name}`", one.date, f"`{one.commit}`", *seconds, _machine(one)])
    found = words("runs")
    heads = ("run", "date", "commit", "s, processor", "s, wall", "machine")
    return f"## {found['title']}\n\n{found['words'].strip()}\n\n{table(heads, rows)}"


def _machine(saved: Saved) -> str:
    one = saved.machine
    libraries = (f"{name} {one[name]}" for name in ("numpy", "numba", "torch") if name in one)
    beside = f"{one['gpu']} beside " if "gpu" in one else ""
    return (
        f"{beside}{one['processor']}, {one['cores']} cores, {one['memory_gib']} GiB, "
        f"load {one['load']}; Python {one['python']}, {', '.join(libraries)}"
    )

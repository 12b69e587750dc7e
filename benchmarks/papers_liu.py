"""Tables and figures of Liu and Shapiro (2016), `quilt`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from papers_rows import LESS, Row, Section
from papers_saved import Saved, load

REPAIRS = {
    "its own fields": ("6e, repair, its own fields", "  paper, repair, own"),
    "interpolated fields": ("6f, repair, fields filled in", "  paper, repair, filled"),
}
FUNCTIONALS = ("area", "perimeter", "Euler characteristic")
LATTICES = {
    "figure 7": "cantilever",
    "figure 8, type 1": "cantilever",
    "figure 8, type 2": "type 2 (frames)",
    "figure 9": "wheel",
}
ERRORS = {
    "frac max": "volume fraction, max",
    "frac mean": "volume fraction, mean",
    "mism max": "mismatch, max",
    "mism mean": "mismatch, mean",
}
PRESET = "cantilever, paper's preset"
ANY_PHASE = "a part of it, any phase"


def sections() -> Iterator[Section]:
    """Give the sections of the page."""
    yield _section()
    yield _lattice()
    yield _cells()


def _section() -> Section:
    saved = load("section")
    same = {case: saved.cell(case, "same voxels") for case in ("5f, with its own fields",)}
    bare = saved.cell("5e, without fields", "same voxels")
    rows = [
        Row(
            "figure 5: voxels that come out the same",
            "all",
            *same.values(),
            others=f"without fields {bare}",
            then="3.4",
            now=saved.cell("5f, with its own fields", "seconds"),
        )
    ]
    for label, (case, paper) in REPAIRS.items():
        for place, (figure, which) in enumerate(product(FUNCTIONALS, ("max", "mean")), start=1):
            theirs, ours = (_at(saved, name, place) for name in (paper, case))
            rows.append(Row(f"repair, {label}: {figure}, {which}", theirs, ours, wanted=LESS))
    return Section("liu table 1", ["section"], rows)


def _at(saved: Saved, name: str, place: int) -> str:
    """Return a cell by its place, since the heads `mean` repeat."""
    return next(row for row in saved.tables[0].rows if row[0] == name)[place]


def _lattice() -> Section:
    saved, rows = load("lattice"), []
    for (figure, case), (head, words) in product(LATTICES.items(), ERRORS.items()):
        plain, turned = f"{case}, no turns", f"{case}, 48 turns"
        others = f"`preset=paper` {saved.cell(PRESET, head)}" if figure == "figure 7" else ""
        if figure == "figure 7" and head.startswith("frac"):
            others += f"; the procedure itself {saved.cell('the procedure itself', head)}"
        row = Row(
            f"{figure}: {words}",
            saved.cell(f"  paper, {figure}", head),
            saved.cell(plain, head),
            saved.cell(turned, head),
            others,
            wanted=LESS,
        )
        if head == "frac max":
            row.then = "5400"
            row.now = f"{saved.cell(plain, 'seconds')}; {saved.cell(turned, 'seconds')}"
        rows.append(row)
    values = {
        "preset": saved.cell(PRESET, "seconds"),
        "any_frac": saved.cell(ANY_PHASE, "frac mean"),
        "any_mism": saved.cell(ANY_PHASE, "mism mean"),
    }
    return Section("liu table 2", ["lattice"], rows, values=values)


def _cells() -> Section:
    saved = load("cells")
    cases = {"type 1": ("1", "type 1, +1"), "type 2": ("-4, closed 2", "type 2, -3")}
    rows = [
        Row(
            f"{name}: Euler number of a cell",
            paper,
            saved.cell(case, "Euler of pieces"),
            others=f"asked for {case.partition(', ')[2]}; held {saved.cell(case, 'held')}",
        )
        for name, (paper, case) in cases.items()
    ]
    return Section("liu figure 8", ["cells"], rows)

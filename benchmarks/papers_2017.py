"""Tables and figures of Zhang, Chen, Wang, Wang (2017), `texture`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from papers_rows import LESS, Row, Section, spread
from papers_saved import Saved, load

PAPER_D2 = {
    "bone": ("bone a", "8.97", "32.39", "43.39"),
    "foam Ni": ("sample foam", "13.67", "36.91", "44.88"),
    "foam Cu": ("sample foam", "15.98", "41.95", "47.47"),
}
"""Table 1, times 100: our exemplar, their method, Kopf's, Chen's."""

PAPER_DRIFT = ("12.43", "15.14", "11.91", "15.11")
"""Section 5.1, times 100."""

UNREPORTED = {
    "largest component": "largest",
    "thickness / exemplar's": "thickness",
    "Euler density / exemplar's": "Euler",
    "coherence(4): copying": "coherence(4)",
}

SEEDS = (0, 1, 2)

FROM_SLICES = ("kopf, paper", "chen, paper")
"""Were run on bone alone."""


def sections() -> Iterator[Section]:
    """Give the sections of the page."""
    yield _table_1()
    yield _weights()
    yield _repeat()
    yield _histogram()


def _table_1() -> Section:
    made, cut = load("by_example_2017"), load("iso_value")
    rows = []
    for name, (exemplar, theirs, kopf, chen) in PAPER_D2.items():
        here = _cells_of(made, exemplar)
        seconds = [here(what, "s") for what in ("texture, paper", "texture", "texture, best")]
        row = Row(
            f"{name}: D2",
            theirs,
            here("texture, paper"),
            f"default {here('texture')}; best {here('texture, best')}",
            f"paper: Kopf {kopf}, Chen {chen}; here: {_rivals(here)}",
            here("real elsewhere") if exemplar == "bone a" else "sample too small",
            "1200" if name == "bone" else "",
            "; ".join(seconds),
            LESS,
        )
        rows.append(row)
    for name, exemplar, error in (("bone", "bone a", "2.86"), ("foam Ni", "sample foam", "2.11")):
        for figure, paper in (("D2", PAPER_D2[name][1]), ("porosity error %", error)):
            found = [float(cut.cell(f"{exemplar}, {seed}", figure)) for seed in SEEDS[:1]]
            what = f"{name}, own iso-value: {figure}"
            rows.append(Row(what, paper, _mean(found), wanted=LESS))
    for name, exemplar in (("bone", "bone a"), ("foam", "sample foam")):
        here = _cells_of(made, exemplar)
        for figure, head in UNREPORTED.items():
            row = Row(
                f"{name}: {figure}",
                like=here("texture, paper", head),
                best=f"default {here('texture', head)}; best {here('texture, best', head)}",
                others=_rivals(here, head),
                band=here("real elsewhere", head) if exemplar == "bone a" else "",
            )
            rows.append(row)
    values = {
        "bone": made.cell("bone a, texture, paper", "pruned"),
        "foam": made.cell("sample foam, texture, paper", "pruned"),
    }
    runs = ["by_example_2017", "iso_value", "stills"]
    return Section("2017 table 1", runs, rows, values=values)


def _mean(values: Sequence[float]) -> str:
    return f"{sum(values) / len(values):.1f}"


def _cells_of(saved: Saved, exemplar: str) -> Callable[..., str]:
    """What gives a cell of an exemplar's row: D2 with its range where no head is named."""

    def cell(what: str, head: str = "") -> str:
        name = f"{exemplar}, {what}"
        if what in FROM_SLICES and not saved.has(name):
            return ""
        return saved.cell(name, head) if head else spread(saved, name)

    return cell


def _rivals(here: Callable[..., str], head: str = "") -> str:
    rivals = {"kopf": "kopf, paper", "chen": "chen, paper", "Gaussian field": "Gaussian field"}
    found = ((name, here(what, head)) for name, what in rivals.items())
    return ", ".join(f"{name} {value}" for name, value in found if value)


def _weights() -> Section:
    saved = load("weights")
    figures = (
        ("rounds, all levels and widths", "10 fewer with", "rounds"),
        ("seconds", "1200 with, 1800 without", "s"),
        ("D2", "not reported", "D2"),
        ("components", "fewer with, to the eye", "N_cc"),
        ("largest component", "not reported", "largest"),
    )
    rows = []
    for figure, paper, head in figures:
        both = (
            " ".join(saved.cell(f"{label}, {seed}", head) for seed in SEEDS)
            for label in ("with", "without")
        )
        rows.append([figure, paper, *both])
    fewer = [
        int(saved.cell(f"without, {seed}", "rounds")) - int(saved.cell(f"with, {seed}", "rounds"))
        for seed in SEEDS
    ]
    heads = ("", "paper", "ours, with", "ours, without")
    values = {"fewer": _list(fewer)}
    return Section("2017 weights", ["weights"], heads=heads, more=rows, values=values)


def _list(values: Sequence[int]) -> str:
    return ", ".join(map(str, values[:-1])) + f" and {values[-1]}"


def _repeat() -> Section:
    ours, theirs = load("repeat"), load("repeat_paper")

    def both(number: int, head: str, factor: float) -> tuple[str, str]:
        """The preset's on bone, and the default's on bone and foam."""
        bone, foam = f"bone a, {number}", f"sample foam, {number}"
        like, one, other = (
            factor * float(saved.cell(row, head).rstrip("!"))
            for saved, row in ((theirs, bone), (ours, bone), (ours, foam))
        )
        digits = 1 if factor > 1 else 2
        return f"{like:.{digits}f}", f"bone {one:.{digits}f}, foam {other:.{digits}f}"

    rows = [
        Row(f"round {number}: D2", paper, *both(number, "S2 rel", 100), wanted=LESS)
        for number, paper in enumerate(PAPER_DRIFT, start=1)
    ]
    for number in (1, 4):
        like, best = both(number, "Euler", 1)
        what = f"round {number}: Euler density / the first exemplar's"
        rows.append(Row(what, like=like, best=best))
    return Section("2017 figure 9", ["repeat", "repeat_paper"], rows)


def _histogram() -> Section:
    saved = load("histogram")
    rivals = (f"{name} {saved.cell(f'{name}, paper', 'off')}" for name in ("kopf", "chen"))
    row = Row(
        "share of voxels in the wrong bin",
        "no figure",
        saved.cell("texture, paper", "off"),
        f"default {saved.cell('texture', 'off')}",
        ", ".join(rivals),
        now=f"{saved.cell('texture, paper', 's')}; {saved.cell('texture', 's')}",
    )
    return Section("2017 figure 12", ["histogram"], [row])

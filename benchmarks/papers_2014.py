"""Figures of Urs, Da Costa, Germain (2014), `mrf`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from common import LEVEL
from papers_rows import Row, Section, three
from papers_saved import load

SETTINGS = {
    "icm, h1a": "ICM, H1a",
    "icm, h1b": "ICM, H1b",
    "icm, h2a": "ICM, H2a",
    "icm, h2b": "ICM, H2b: `preset=paper`",
    "as written, h2b": "ICM, H2b, to the letter",
    "annealing, h2b": "annealing, H2b",
    "icm, h2b, shares": "ICM, H2b, shares controlled (ours)",
    "default": "the default of `mrf` (ours)",
}
PICTURES = ("ceramics", "composite", "gravel")
COOLING = {"-1, 100 %": "", "-3, 100 %": "18", "-3, 95 %": "6", "-8, 95 %": ""}
"""xi and stop, and the paper's iterations, "roughly"."""


def sections() -> Iterator[Section]:
    """Give the sections of the page."""
    yield _heuristics()
    yield _cooling()
    ways = ("9 x 9, 8/8", "9 x 9, 1/8", "11 x 11, 1/8")
    yield _ways("2014 figure 6", "upsampling", "ceramics", ways)
    ways = ("icm, h2b", "annealing, h2b", "default")
    yield _ways("2014 figure 7", "relaxations", "gravel", ways)
    yield _colour()
    yield _indicators()
    yield _views()


def _heuristics() -> Section:
    saved, rows = load("heuristics"), []
    for key, words in SETTINGS.items():
        names = [f"{name}: {key}" for name in PICTURES]
        rows.append(
            [words, *(three(saved, name) if saved.has(name) else "refused" for name in names)]
        )
    heads = ("setting", *PICTURES)
    return Section("2014 figure 4", ["heuristics"], heads=heads, more=rows)


def _cooling() -> Section:
    saved, rows = load("cooling"), []
    for way, paper in COOLING.items():
        sweeps, counted, seconds = (saved.cell(way, head) for head in ("sweeps", "in all", "s"))
        rows.append([way, paper, sweeps, counted, three(saved, way), seconds])
    heads = ("xi, stop", "paper", "sweeps, finest scale first", "in all", "indicators", "s")
    return Section("2014 figure 5", ["cooling"], heads=heads, more=rows)


def _ways(key: str, run: str, picture: str, ways: Sequence[str]) -> Section:
    saved, rows = load(run), []
    for way in ways:
        name = f"{picture}, {way}"
        more = (saved.cell(name, head) for head in ("levels", "contrast", "s"))
        rows.append([way, three(saved, name), *more])
    heads = ("", "indicators", "levels kept", "contrast / picture's", "s")
    return Section(key, [run], heads=heads, more=rows)


def _colour() -> Section:
    saved = load("colour")
    row = Row(
        "64^2 to 32^3 (the paper: 64^3), colour, 11 x 11, 3 scales: indicators",
        "no figure",
        best=three(saved, "bread 2, mrf"),
        others=f"`kopf` {three(saved, 'bread 2, kopf')}, in {saved.cell('bread 2, kopf', 's')} s "
        "(the paper's: a few minutes)",
        then="172,800 (48 hours)",
        now=saved.cell("bread 2, mrf", "s"),
    )
    return Section("2014 figure 8", ["colour"], [row])


def _indicators() -> Section:
    rows: list[list[str]] = []
    wins = 0
    for run, size in (("indicators", "32^3"),):
        saved = load(run)
        found = [row[0] for row in saved.tables[0].rows if row[0].endswith(": real")]
        for name in (one.removesuffix(": real") for one in found):
            ours, theirs = (three(saved, f"{name}: {way}").split() for way in ("mrf", "kopf"))
            pairs = zip(ours, theirs, strict=True)
            won = sum(float(here) < float(there) + LEVEL for here, there in pairs)
            wins += won == len(ours)
            indicators = (three(saved, f"{name}: {way}") for way in ("real", "mrf", "kopf"))
            seconds = (saved.cell(f"{name}: {way}", "s") for way in ("mrf", "kopf"))
            rows.append([f"{name}, {size}", *indicators, str(won), *seconds])
    heads = ("picture, size", "halves", "`mrf`", "`kopf`", "ahead in", "s, `mrf`", "s, `kopf`")
    values = {"wins": wins, "count": len(rows)}
    return Section("2014 figure 10", ["indicators"], heads=heads, more=rows, values=values)


def _views() -> Section:
    saved = load("views")
    rows = [
        [name, three(saved, name), saved.cell(name, "S2 cov"), saved.cell(name, "s")]
        for name in ("2 views, mrf", "3 views, mrf", "2 views, kopf", "3 views, kopf")
    ]
    heads = ("", "indicators", "covariance, error", "s")
    return Section("2014 figure 11", ["views"], heads=heads, more=rows)

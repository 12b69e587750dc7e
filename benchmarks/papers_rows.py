"""What the page "The five papers, reproduced" is built of: rows, sections, tables in Markdown, and
the words of `papers_words.toml`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from papers_saved import Saved, load

HEADS = (
    "",
    "paper",
    "ours, like for like",
    "ours is",
    "ours, at its best",
    "others",
    "real, elsewhere",
    "seconds, paper",
    "seconds, ours",
)

LESS, MORE = "less", "more"


@dataclass
class Row:
    """One figure of a paper beside ours."""

    what: str
    paper: str = ""
    like: str = ""
    best: str = ""
    others: str = ""
    band: str = ""
    then: str = ""
    now: str = ""
    wanted: str = ""
    """`less` or `more`, where the paper's figure and ours can be compared."""

    @property
    def verdict(self) -> str:
        """Whether ours, like for like, is better or worse than the paper's, or neither."""
        here, there = (_number(text) for text in (self.like, self.paper))
        if not self.wanted or here is None or there is None:
            return ""
        if here == there:
            return "alike"
        return "better" if (here < there) == (self.wanted == LESS) else "worse"

    def cells(self) -> list[str]:
        """Return the cells of the row."""
        return [
            self.what,
            self.paper,
            self.like,
            self.verdict,
            self.best,
            self.others,
            self.band,
            self.then,
            self.now,
        ]


def _number(text: str) -> float | None:
    found = re.search(r"-?\d*\.?\d+", text)
    return float(found.group()) if found else None


@dataclass
class Section:
    """A table of the page, with its pictures; its title and words are in `papers_words.toml`."""

    key: str
    runs: Sequence[str]
    rows: Sequence[Row] = ()
    heads: Sequence[str] = HEADS
    more: Sequence[Sequence[str]] = ()
    """Rows of another shape than `Row`, for other `heads`."""
    values: Mapping[str, object] = field(default_factory=dict)
    """What stands in braces in the words."""

    @property
    def pictures(self) -> Mapping[str, str]:
        """Files, and what is to be seen in them."""
        return words(self.key).get("pictures", {})

    def text(self) -> str:
        """Return the section in Markdown."""
        found = words(self.key)
        parts = [f"### {found['title']}"]
        rows = [row.cells() for row in self.rows] or [list(row) for row in self.more]
        if rows:
            parts.append(table(*_without_empty(self.heads, rows)))
        said = found["words"].format(**self.values).strip()
        parts.append(said + "\n\nAgain: " + "; ".join(_again(load(run)) for run in self.runs) + ".")
        for file, seen in self.pictures.items():
            parts.append(f"![{found['title']}: {file}](../images/papers/{file}.png)\n\n*{seen}*")
        return "\n\n".join(parts)


@cache
def _all_words() -> dict[str, Any]:
    path = Path(__file__).with_name("papers_words.toml")
    return tomllib.loads(path.read_text(encoding="utf-8"))


def words(key: str) -> dict[str, Any]:
    """Return title, words and captions of a section."""
    return _all_words()[key]


def _again(saved: Saved) -> str:
    clock = "processor" if "processor" in saved.seconds else "wall"
    return f"`{saved.command}` ({saved.seconds[clock]:.0f} s)"


def _without_empty(
    heads: Sequence[str], rows: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Leave out columns that no row fills."""
    kept = [at for at in range(len(heads)) if any(row[at] for row in rows)]
    return [heads[at] for at in kept], [[row[at] for at in kept] for row in rows]


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(" ".join(["|", *(f"{cell} |".lstrip() for cell in line)]) for line in lines)


def spread(saved: Saved, row: str) -> str:
    """Return D2 with its range."""
    mean, least_most = saved.cell(row, "D2"), saved.cell(row, "D2 range")
    least, most = least_most.split(" - ")
    return mean if least == most else f"{mean} ({least_most})"


def three(saved: Saved, row: str) -> str:
    """Return the three indicators of the 2014 paper."""
    return " ".join(saved.cell(row, head) for head in ("histogram", "autocorr.", "orientation"))

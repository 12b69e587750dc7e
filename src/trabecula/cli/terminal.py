"""Results on standard output, and lines beside them (`cli.messages`)."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from trabecula.cli.messages import fail, messages_shown, note, note_end

__all__ = [
    "brief",
    "fail",
    "messages_shown",
    "note",
    "note_end",
    "show_certificate",
    "show_json",
    "show_mapping",
    "show_rows",
]


_VERDICT = re.compile(r"\b(?:PASS|FAIL)\b|(?<=  )pass\b")
_GREEN, _RED, _PLAIN = "\033[32m", "\033[31m", "\033[0m"


def show_certificate(text: str) -> None:
    """Print a certificate, its verdicts in colour where standard output is a terminal that has it.

    The variable NO_COLOR switches colour off (no-color.org).
    """
    if _has_colour():
        text = _VERDICT.sub(
            lambda found: f"{_RED if found[0] == 'FAIL' else _GREEN}{found[0]}{_PLAIN}", text
        )
    print(text)


def _has_colour() -> bool:
    # a console of Windows shows the codes themselves, Windows Terminal does not
    shown = os.name != "nt" or "WT_SESSION" in os.environ
    refused = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return sys.stdout.isatty() and shown and not refused


def show_json(value: Any) -> None:
    """Print one JSON object on standard output."""
    print(json.dumps(value, indent=1, allow_nan=False))


def show_rows(rows: Sequence[Sequence[Any]]) -> None:
    """Print columns, as wide as they need to be."""
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in texts) for i in range(len(texts[0]))] if texts else []
    for row in texts:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )


def show_mapping(values: Mapping[str, Any], *, units: bool = False) -> None:
    """Print a name and a value per line; nested tables one a line, curves by their length alone.

    With `units` values of descriptors have theirs, powers of the image's unit, behind them.
    """
    rows = [[name, brief(value)] for name, value in _flatten(values)]
    if units:
        from trabecula.cli.csv_tables import unit_of

        for row in rows:
            unit = unit_of(row[0], values.get("unit"))
            row[1] += f" {unit}" if unit and "values" not in row[1] and row[1] != "-" else ""
    show_rows(rows)


def _flatten(values: Mapping[str, Any], *, inside: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping) and any(isinstance(part, Mapping) for part in value.values()):
            yield from _flatten(value, inside=f"{inside}{name}.")
        else:
            yield f"{inside}{name}", value


def brief(value: Any) -> str:
    """Return a value in a few words."""
    if value is None or value == []:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        if isinstance(value[0], str):
            return " ".join(value)
        if isinstance(value[0], list):
            return f"{len(value)} x {len(value[0])} values (--json prints them)"
        return f"{len(value)} values (--json prints them)" if len(value) > 4 else str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {brief(part)}" for key, part in value.items())
    return str(value)

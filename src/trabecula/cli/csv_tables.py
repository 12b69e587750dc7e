"""`--csv FILE`: the figures that `--json` prints, as a table that a spreadsheet reads."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trabecula.core.errors import InputError

HEAD = ("figure", "position", "value", "unit")


def add_csv(parser: argparse.ArgumentParser) -> None:
    """Add the file of the table."""
    parser.add_argument(
        "--csv", metavar="FILE", help="write the figures as a table as well: one value a line"
    )


def check_csv(path: str | None) -> None:
    """Raise before any work is done where a table cannot be written."""
    if path is not None and Path(path).suffix.lower() != ".csv":
        raise InputError(f"--csv {path}: a table should end in .csv")


def write_csv(path: str, rows: Sequence[Sequence[Any]]) -> None:
    """Write rows, the head first, so that the file appears whole or not at all."""
    from trabecula.engine.files import replacing

    with replacing(Path(path)) as temporary, temporary.open("w", newline="", encoding="utf-8") as f:
        csv.writer(f, lineterminator="\n").writerows(rows)


def write_figures(path: str | None, found: Mapping[str, Any]) -> None:
    """Write an object of figures, curves by their position; nothing where no file is named."""
    if path is not None:
        unit = found.get("unit")
        rows = [(*row, unit_of(row[0], unit)) for row in flatten(found)]
        write_csv(path, [HEAD, *rows])


def flatten(value: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield name, position and value of every plain value; names of inner tables after a point."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from flatten(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for place, part in enumerate(value):
            if isinstance(part, (Mapping, list)):
                yield from flatten(part, f"{name}.{place}")
            else:
                yield name, place, part
    else:
        yield name, "", value


def unit_of(figure: str, unit: str | None) -> str:
    """Return the unit of a descriptor by its name: a power of the image's unit, or nothing."""
    from trabecula.measure.registry import DESCRIPTORS

    words = figure.split(".")
    if figure in ("spacing", "r_max"):
        return (unit or "") if figure == "spacing" else "voxel"
    found = next((DESCRIPTORS[word] for word in reversed(words) if word in DESCRIPTORS), None)
    return spell_unit(found.power, unit) if found is not None else ""


def spell_unit(power: int, unit: str | None) -> str:
    """Write a power of a unit: um^2, 1/um."""
    if not power or not unit:
        return ""
    text = unit if abs(power) == 1 else f"{unit}^{abs(power)}"
    return text if power > 0 else f"1/{text}"

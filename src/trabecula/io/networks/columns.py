"""One table of columns: `pore.coords[0]`, ..., `throat.conns[1]`, as OpenPNM reads and writes CSV.

Columns of points and of lines stand beside each other; the shorter ones end in empty cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path

import numpy as np

from trabecula.engine.files import replacing


def write(tables: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write the columns."""
    heads, cells = [], []
    for name, values in tables.items():
        flat = values[:, None] if values.ndim == 1 else values
        for k in range(flat.shape[1]):
            heads.append(name if values.ndim == 1 else f"{name}[{k}]")
            cells.append(_texts(flat[:, k]))
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(heads) + "\n")
        for row in zip_longest(*cells, fillvalue=""):
            file.write(",".join(row) + "\n")
    return [path]


def _texts(column: np.ndarray) -> list[str]:
    """Return the shortest text of every number that reads back as the same."""
    return [repr(value) for value in column.tolist()]

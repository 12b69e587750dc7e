"""Text in surface files: units, recipes, and rows of numbers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator

import numpy as np

from trabecula.core.recipe import Recipe
from trabecula.io.units import canonical, has_length, to_metres

NO_UNIT = "voxel"

_COMMENT = 100  # characters of a line of comment
_ROWS = 1 << 15  # rows per string: one format operation for thousands of rows is fast


def recipe_json(recipe: Recipe) -> str:
    """Return the recipe on one line of ASCII."""
    return json.dumps(recipe.to_json(), separators=(",", ":"))


def recipe_lines(recipe: Recipe) -> list[str]:
    """Return the recipe in lines that are short enough for a comment: solvers read long lines in
    parts, of which the next would be no comment.
    """
    text = recipe_json(recipe)
    return [text[start : start + _COMMENT] for start in range(0, len(text), _COMMENT)]


def recipe_digest(recipe: Recipe) -> str:
    """Return sixteen hexadecimal digits that identify a recipe, for files without space for it."""
    return hashlib.sha256(recipe_json(recipe).encode()).hexdigest()[:16]


def metres(unit: str) -> float | None:
    """Return the metres in a unit, or None where it has no length ("voxel")."""
    return to_metres(unit) if has_length(unit) else None


def parse_unit(text: str | None) -> str:
    """Return the unit that a file names, as of an Image; "voxel" where it names no known one."""
    return canonical(text) if text and has_length(text) else NO_UNIT


def format_rows(template: str, values: np.ndarray, *, offset: int = 0) -> Iterator[str]:
    """Yield the rows of `values`, plus `offset`, in a %-template, many rows a string."""
    for start in range(0, len(values), _ROWS):
        chunk = values[start : start + _ROWS]
        if offset:
            chunk = chunk + offset
        yield template * len(chunk) % tuple(chunk.ravel().tolist())

"""The one table of surface formats: suffix -> (what it is, module that reads and writes it)."""

from __future__ import annotations

import hashlib
import json

from trabecula.core.recipe import Recipe
from trabecula.io.units import canonical, has_length, to_metres

FORMATS = {
    ".stl": ("binary STL, in millimetres", "trabecula.mesh.stl"),
    ".3mf": ("3D Manufacturing Format, with unit and recipe", "trabecula.mesh.threemf"),
    ".ply": ("binary PLY, unit and recipe as comments", "trabecula.mesh.ply"),
    ".obj": ("Wavefront OBJ, unit and recipe as comments", "trabecula.mesh.obj"),
}

NO_UNIT = "voxel"


def recipe_json(recipe: Recipe) -> str:
    """The recipe on one line of ASCII."""
    return json.dumps(recipe.to_json(), separators=(",", ":"))


def recipe_digest(recipe: Recipe) -> str:
    """Sixteen hexadecimal digits that name the recipe where it does not fit."""
    return hashlib.sha256(recipe_json(recipe).encode()).hexdigest()[:16]


def metres(unit: str) -> float | None:
    """Metres in a unit, or None where it has no length ("voxel")."""
    return to_metres(unit) if has_length(unit) else None


def stated_unit(text: str | None) -> str:
    """The unit that a file names, as an Image would; "voxel" where it names none that is known."""
    return canonical(text) if text and has_length(text) else NO_UNIT

"""From what a file holds to an Image: kind, levels, spacing and the first step of a recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from trabecula.core.checks import check_finite, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import KINDS, MAX_PHASES, Image, distinct_levels, labels
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe
from trabecula.io.metadata import FileContent
from trabecula.io.units import canonical, check_unit

FEW_LEVELS = 8
"""Integer data of at most so many levels are labels unless `kind` is given."""


def interpret(content: FileContent, *, source: str, options: Mapping[str, Any]) -> Image:
    """Make an Image of a file's content.

    Parameters
    ----------
    content : Content
    source : str
        The path as the user gave it, for the recipe.
    options : mapping
        What the caller of `read` gave explicitly, among kind, spacing, unit and phases, which win
        over the file, and level.
    """
    own = content.fields or {}
    values = _native_values(content.values)
    if "kind" in options:
        check_name(options["kind"], KINDS, name="kind of image")
    kind = options.get("kind") or own.get("kind") or _kind_of(values, content.colour)
    if content.colour and kind != "colour":
        values = _one_channel(values, kind)
    levels = None
    if kind == "labels" and own.get("kind") != "labels":
        values, levels = _number_levels(values, options.get("phases"))
    elif kind == "grey" and values.dtype == bool:
        values = values.view(np.uint8)
    if "unit" in options:
        check_unit(options["unit"])
    fields = {
        "spacing": options.get("spacing", own.get("spacing") or content.spacing or ()),
        "unit": canonical(options["unit"])
        if "unit" in options
        else own.get("unit") or canonical(content.unit or "voxel"),
        "phases": options.get("phases", own.get("phases", ()) if kind == own.get("kind") else ()),
    }
    image = Image(values, kind, **fields)
    if "spacing" not in options and not own.get("spacing"):
        _report_spacing(image, content, source)
    return replace(image, recipe=_recipe(image, content, source, options, levels))


def _report_spacing(image: Image, content: FileContent, source: str) -> None:
    """Report a spacing from tags that often mean something else, and tags that were ignored."""
    if content.ignored:
        notify(f"{source}: {content.ignored}")
    elif content.spacing and content.origin not in ("", "ImageJ metadata", "OME metadata"):
        edges = " x ".join(f"{edge:.6g}" for edge in image.spacing)
        notify(f"{source}: spacing {edges} {image.unit} from {content.origin}")


def _origin(content: FileContent, options: Mapping[str, Any]) -> dict[str, str]:
    """Return the fields of a step "read" on the spacing: its origin, and ignored tags."""
    own = content.fields or {}
    if "spacing" in options:
        found = "given"
    elif own.get("spacing"):
        found = "metadata of this package"
    else:
        found = (content.origin or "the file's header") if content.spacing else ""
    ignored = (
        {"ignored": content.ignored}
        if content.ignored and "spacing" not in options and not own.get("spacing")
        else {}
    )
    return {**({"spacing_from": found} if found else {}), **ignored}


def _recipe(
    image: Image, content: FileContent, source: str, options: Mapping[str, Any], levels: list | None
) -> Recipe:
    """Return the file's own recipe, followed by a step "read" where the caller's options change
    what the file says.
    """
    own = None if content.lossy else content.fields
    recipe = Recipe.from_json(own["recipe"]) if own else Recipe()
    if own and recipe and "level" not in options:
        said = {
            "kind": image.kind,
            "spacing": list(image.spacing),
            "unit": image.unit,
            "phases": list(image.phases),
        }
        if all(own[name] == value for name, value in said.items()):
            return recipe
    found: dict[str, Any] = {"levels": levels} if levels is not None else {}
    stated = _fields_in_file(content)
    if stated:
        found["stated"] = stated
    return recipe.then(
        "read",
        image.values,
        source=source,
        options=dict(options),
        **found,
        **_origin(content, options),
    )


def _fields_in_file(content: FileContent) -> list[str]:
    """List the fields that the file itself states, ours or its format's; options given to `read`
    win over them.
    """
    if content.fields:
        return [name for name in ("kind", "spacing", "unit", "phases") if content.fields.get(name)]
    format_says = {"kind": content.colour, "spacing": content.spacing, "unit": content.unit}
    return [name for name, value in format_says.items() if value]


def _native_values(values: np.ndarray) -> np.ndarray:
    """Return the values in this machine's byte order; InputError where they are no numbers."""
    if values.dtype.kind not in "biufc":
        raise InputError(f"the file holds {values.dtype} values: real numbers are needed")
    check_finite(values, name="the file")
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def _kind_of(values: np.ndarray, colour: bool) -> str:
    if colour:
        return "colour"
    if values.dtype == bool:
        return "labels"
    levels = distinct_levels(values, limit=FEW_LEVELS) if values.size else None
    if levels is None:
        return "grey"
    if values.dtype.kind == "f":
        if np.all(levels == np.round(levels)):
            raise InputError(
                f"the file holds {values.dtype} values of only {len(levels)} whole levels "
                f"{_list_levels(levels)}: "
                "labels or grey? give kind='labels' or kind='grey' (--kind)"
            )
        return "grey"
    return "labels"


def _one_channel(values: np.ndarray, kind: str) -> np.ndarray:
    if not (
        np.array_equal(values[..., 0], values[..., 1])
        and np.array_equal(values[..., 0], values[..., 2])
    ):
        raise InputError(
            f"the file is in colour, kind={kind!r} needs one channel: convert it to grey first, or "
            "give kind='colour'"
        )
    return values[..., 0]


def _number_levels(values: np.ndarray, phases: Any) -> tuple[np.ndarray, list | None]:
    """Return labels 0..n-1 and the levels that they were in the file, None where they were labels
    already.
    """
    levels = distinct_levels(values, limit=MAX_PHASES) if values.size else None
    if levels is None:
        return labels(values).values, None  # which says what is wrong
    if phases is not None and len(phases) > len(levels):
        # A crop may lack a phase. Numbers that already are labels keep their names; other levels
        # would get wrong ones.
        if values.dtype.kind in "bui" and levels[0] >= 0 and levels[-1] < len(phases):
            return values, None
        if len(levels) > 1 or len(phases) > 2:
            raise InputError(
                f"phases name {len(phases)} labels, the file holds {len(levels)} levels "
                f"{_list_levels(levels)}: name those"
            )
    numbered = np.array_equal(levels, np.arange(len(levels)))
    return labels(values).values, None if numbered else levels.tolist()


def _list_levels(levels: np.ndarray) -> str:
    return ", ".join(f"{level:g}" for level in levels)

"""Where an image's kind, phases, spacing and unit come from, as its recipe tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trabecula.core.image import Image, default_phases

FIELDS = ("kind", "phases", "spacing", "unit")


def origins_of(image: Image) -> dict[str, str]:
    """Tell of each field whether it was given, stated by the file, found in the content, or is the
    default.
    """
    found = {name: _unknown(image, name) for name in FIELDS}
    for step in image.recipe.steps:
        found.update(_of_step(step, image))
    return (
        found
        if image.kind == "labels"
        else {name: value for name, value in found.items() if name != "phases"}
    )


def _unknown(image: Image, name: str) -> str:
    if name == "phases" and image.phases == default_phases(len(image.phases)):
        return "default names"
    if (name == "spacing" and set(image.spacing) == {1.0}) or (
        name == "unit" and image.unit == "voxel"
    ):
        return "default: nothing states it"
    return "given with the array"


def _of_step(step: Mapping[str, Any], image: Image) -> dict[str, str]:
    """What a step of a recipe settles."""
    verb = step["verb"]
    if verb == "sample":
        return dict.fromkeys(FIELDS, "the sample")
    if verb == "declare":
        return dict.fromkeys(step.get("fields", {}), "given")
    if verb == "segment":
        how = step.get("found_by", "given")
        threshold = step["threshold"]
        text = (
            ", ".join(f"{number:g}" for number in threshold)
            if isinstance(threshold, list)
            else f"{threshold:g}"
        )
        found = {"kind": f"segmented at {text} ({'given' if how == 'given' else f'found: {how}'})"}
        return found | {"phases": "default names" if image.phases == ("void", "solid") else "given"}
    if verb == "generate":
        return dict.fromkeys(FIELDS, "its exemplar")
    if verb != "read":
        return {}
    found = dict.fromkeys(step.get("stated", ()), "stated in the file")
    if "kind" not in found:
        levels = step.get("levels")
        found["kind"] = (
            "the file's levels " + ", ".join(f"{level:g}" for level in levels)
            if levels
            else "few levels"
            if image.kind == "labels"
            else "more than 8 levels"
            if image.kind == "grey"
            else "three channels"
        )
    if "spacing_from" in step:
        found |= dict.fromkeys(("spacing", "unit"), step["spacing_from"])
    found |= dict.fromkeys((name for name in step.get("options", {}) if name in FIELDS), "given")
    if "ignored" in step:
        found["spacing"] = (
            f"{found.get('spacing', _unknown(image, 'spacing'))} (ignored: {step['ignored']})"
        )
    return found

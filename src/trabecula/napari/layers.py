"""Images as layers of napari, and back.

Labels are a Labels layer, grey and colour an Image layer. Spacing is the layer's scale, the unit
its units; kind, phases and recipe are in its metadata, so that what was made can be made again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe, digest
from trabecula.io.units import canonical, has_length, long_name

KEY = "trabecula"
"""Name of our entry in a layer's metadata."""


def layer_data(image: Image, name: str) -> tuple[np.ndarray, dict[str, Any], str]:
    """Return an image as napari's data, options and type of a layer."""
    about = {"kind": image.kind, "phases": list(image.phases), "recipe": image.recipe.to_json()}
    options: dict[str, Any] = {
        "name": name,
        "scale": tuple(image.spacing),
        "metadata": {KEY: {**about, "spacing": list(image.spacing), "unit": image.unit}},
    }
    unit = long_name(image.unit) if has_length(image.unit) else None
    if unit is not None:
        options["units"] = (unit,) * image.ndim
    if image.kind == "labels":
        return image.values, options, "labels"
    return image.values, {**options, "rgb": image.kind == "colour"}, "image"


def layer_image(layer: Any) -> Image:
    """Return the image that a layer shows.

    Raises
    ------
    InputError
        A layer of another type, or of several levels or times.
    """
    name = type(layer).__name__
    if name not in ("Labels", "Image"):
        raise InputError(f"layer {layer.name} is {name}: choose a Labels or an Image layer")
    data = layer.data[0] if getattr(layer, "multiscale", False) else layer.data
    options = {"metadata": dict(layer.metadata), "scale": layer.scale, "units": layer.units}
    rgb = bool(getattr(layer, "rgb", False))
    return image_of(np.asarray(data), options, "labels" if name == "Labels" else "image", rgb=rgb)


def image_of(
    data: np.ndarray, options: dict[str, Any], layer_type: str, *, rgb: bool | None = None
) -> Image:
    """Return the image of a layer's data and options, with what its metadata remember of it."""
    own = dict((options.get("metadata") or {}).get(KEY, {}))
    colour = options.get("rgb", False) if rgb is None else rgb
    kind = "labels" if layer_type == "labels" else "colour" if colour else "grey"
    ndim = data.ndim - (kind == "colour")
    if ndim > 3 and all(side == 1 for side in data.shape[: ndim - 3]):
        data = data.reshape(data.shape[ndim - 3 :])
        ndim = 3
    if ndim not in (2, 3):
        raise InputError(f"a layer of shape {data.shape} is no picture and no volume")
    spacing = tuple(float(edge) for edge in np.asarray(options.get("scale", (1.0,) * ndim)))[-ndim:]
    unit = own.get("unit", "voxel") if own.get("spacing") == list(spacing) else None
    if unit is None:
        unit = _unit(options.get("units"))
    same = own.get("kind") == kind
    recipe = Recipe.from_json(own["recipe"]) if same and own.get("recipe") else Recipe()
    if recipe and digest(data) != recipe.steps[-1].get("sha256"):
        recipe = Recipe().then("array", data)  # painted or cut since
    phases = own.get("phases", ()) if same else ()
    if kind == "labels" and len(phases) <= int(data.max(initial=0)):
        phases = ()
    return Image(np.asarray(data), kind, spacing, unit, tuple(phases), recipe)


def _unit(units: Any) -> str:
    """Return the unit of a layer's axes; "voxel" where it is no length."""
    words = [units] if isinstance(units, str) else list(units or ())
    found = canonical(str(words[-1])) if words else "voxel"
    return found if has_length(found) else "voxel"

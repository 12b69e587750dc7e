"""Unlimited material as layers: planes that a model makes when they are printed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.chunking import Box
from trabecula.engine.lazy_volume import Slabs
from trabecula.synth.api.model import Model, as_request
from trabecula.synth.api.windows import makes_boxes


def slabs_of_model(model: Model, shape: int | Sequence[int], *, seed: int, **parts: Any) -> Slabs:
    """Return a volume whose planes a model makes when they are read; nothing is kept.

    Parameters
    ----------
    model : Model
        One that makes any box of its material alone: of `noise`, `gan` or `bubbles`.
    shape : int or three ints
        As of `generate`.
    seed, **parts
        As of `generate`.

    Returns
    -------
    Slabs

    Raises
    ------
    InputError
        A model that makes no boxes, or no labels.
    """
    if not makes_boxes(model):
        raise InputError(
            f"{model.capabilities.name} makes no part of a volume alone: generate the volume as "
            ".zarr, and give that file"
        )
    request = as_request(shape, seed, parts)
    about = model.fields(request)
    if about["kind"] != "labels" or len(request.shape) != 3:
        raise InputError("layers are made of a volume of labels: segment the exemplar first")

    def read(box: Box) -> np.ndarray:
        return model.window(request, box)

    z, y, x = request.shape
    lengths = about["spacing"], about["unit"], about["phases"]
    return Slabs((z, y, x), read, *lengths, model.recipe(request, ""), model.block)

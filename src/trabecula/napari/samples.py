"""Samples of napari's menu."""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.exemplar.samples import sample
from trabecula.napari.layers import layer_data


def bone() -> list[tuple[np.ndarray, dict[str, Any], str]]:
    """Return the embedded bone as a layer."""
    return [layer_data(sample("bone"), "bone")]


def foam() -> list[tuple[np.ndarray, dict[str, Any], str]]:
    """Return the embedded foam as a layer."""
    return [layer_data(sample("foam"), "foam")]

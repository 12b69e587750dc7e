"""From what a generator makes to values of an image, voxel by voxel: windows agree because no
neighbour counts.

A field has one channel for two phases (rising into the phase of the higher label), one for grey,
and one for each phase where there are more. A calibration is plain JSON: {"kind": "labels",
"present": [0, 1], "offsets": [t]} where the higher label is given above t; {"kind": "labels",
"present": [0, 1, 2], "offsets": [a, b, c]} where the channel that is highest after its offset is
added gives the label; {"kind": "grey", "dtype": "uint8", "from": [...], "to": [...]}, rising
tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


def decode(field: np.ndarray, calibration: Mapping[str, Any]) -> np.ndarray:
    """Labels or grey values of a field.

    Parameters
    ----------
    field : (K, Z, Y, X) float32 array
    calibration : mapping

    Returns
    -------
    (Z, Y, X) uint8 array, or grey of the exemplar's dtype
    """
    if calibration["kind"] == "grey":
        dtype = np.dtype(calibration["dtype"])
        values = np.interp(field[0], calibration["from"], calibration["to"])
        return (np.rint(values) if dtype.kind in "iu" else values).astype(dtype)
    present = np.asarray(calibration["present"], np.uint8)
    offsets = np.asarray(calibration["offsets"], np.float32)
    if len(present) == 2:
        return present[(field[0] > offsets[0]).view(np.uint8)]
    best, index = field[0] + offsets[0], np.zeros(field.shape[1:], np.uint8)
    for place in range(1, len(present)):
        value = field[place] + offsets[place]
        index[value > best] = place
        np.maximum(best, value, out=best)
    return present[index]

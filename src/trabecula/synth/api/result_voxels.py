"""The size of a result's voxels: the exemplar's, or the form's where the exemplar states none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.io.units import NO_LENGTH, has_length, to_metres

_ALIKE = 1e-4
"""Relative difference of edges that are the same: files keep few digits of some."""


def result_voxels(
    request: Request, spacing: Sequence[float], unit: str
) -> tuple[tuple[float, ...], str]:
    """Return spacing and unit of the result of a request.

    Parameters
    ----------
    request : Request
    spacing : sequence of float
        Of the model's results, along as many axes as the request has.
    unit : str

    Raises
    ------
    RequestError
        The form has other voxels.
    """
    if request.voxel is None:
        return tuple(spacing), unit
    edges, named = request.voxel
    if unit == NO_LENGTH and all(edge == 1 for edge in spacing):
        return edges, named  # all that is known
    both = has_length(named) and has_length(unit)
    factor = to_metres(named) / to_metres(unit) if both else 1.0
    if np.allclose(np.array(edges) * factor, spacing, rtol=_ALIKE, atol=0):
        return (
            (tuple(spacing), unit) if has_length(unit) or not has_length(named) else (edges, named)
        )
    no_unit = (
        ""
        if has_length(named)
        else "; a surface without a unit is read with one by tb.read_mesh(..., unit=)"
    )
    raise RequestError(
        f"the mask's voxels are {_size(edges)} {named}, the result's {_size(spacing)} {unit}: "
        "voxelise the form at the result's spacing (tb.voxelise), resample it, or correct the "
        f"spacing of either (--spacing, --unit){no_unit}"
    )


def _size(edges: Sequence[float]) -> str:
    return " x ".join(f"{edge:.6g}" for edge in edges)

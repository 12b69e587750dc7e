"""Streamlines as the page holds them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError

_PARTS = 32  # of a voxel of the page, which has at most 1024 of them along an axis


def pack_lines(
    lines: Sequence[ArrayLike], shape: Sequence[int], block: Sequence[int]
) -> tuple[dict[str, Any], np.ndarray]:
    """Pack lines for the page.

    Parameters
    ----------
    lines : sequence of (N, 4) arrays
        z, y, x in voxels of the image and a speed, as `measure.streamlines` returns them.
    shape : (z, y, x)
        Of the image.
    block : (z, y, x)
        Voxels of the image that make one of the page.

    Returns
    -------
    about : dict
        Plain JSON: the number of points of each line, the "most" speed (99th percentile).
    values : uint16
        All x in 1/32 of a voxel of the page, all y, all z, all speeds (65535 is the most).

    Raises
    ------
    InputError
        Other arrays, or points outside of the image.
    """
    several = [np.asarray(line, np.float64) for line in lines]
    if not several or any(line.ndim != 2 or line.shape[1] != 4 for line in several):
        raise InputError(
            "streamlines: give a sequence of arrays (N, 4) of z, y, x and speed, at least one, as "
            "tb.measure.streamlines returns them"
        )
    points = np.concatenate(several)
    if not np.isfinite(points).all() or (points[:, 3] < 0).any():
        raise InputError("streamlines: points and speeds have to be finite, and no speed below 0")
    if (points[:, :3] < -1).any() or (points[:, :3] > np.array(shape) + 1).any():
        raise InputError(f"streamlines: points lie outside of the image of shape {tuple(shape)}")
    places = np.clip(points[:, :3] / np.array(block) * _PARTS, 0, 65535)
    most = float(np.quantile(points[:, 3], 0.99)) or 1.0
    speeds = np.clip(points[:, 3] / most, 0, 1) * 65535
    columns = [places[:, 2], places[:, 1], places[:, 0], speeds]
    values = np.rint(np.stack(columns)).astype("<u2")
    return {"points": [len(line) for line in several], "most": most, "parts": _PARTS}, values

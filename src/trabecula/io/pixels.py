"""Transparency and palettes of pictures, the same in every format that has them."""

from __future__ import annotations

import numpy as np

from trabecula.core.errors import InputError


def without_alpha(values: np.ndarray) -> np.ndarray:
    """Return grey or colour without the last channel, a pixel's opacity.

    Parameters
    ----------
    values : (..., 2) or (..., 4) array

    Raises
    ------
    InputError
        A pixel is not opaque: what shows through it is unknown.
    """
    alpha = values[..., -1]
    opaque = np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1
    clear = int(np.count_nonzero(alpha != opaque))
    if clear:
        raise InputError(
            f"{clear} of {alpha.size} pixels are transparent, so their values are open: "
            "flatten the picture onto a background first"
        )
    return values[..., 0] if values.shape[-1] == 2 else values[..., :-1]


def from_palette(indices: np.ndarray, palette: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the greys or colours that indices into a palette stand for.

    Parameters
    ----------
    indices : (...) integer array
    palette : (N, 3) uint8 array

    Returns
    -------
    values : (...) or (..., 3) uint8 array
    colour : bool
    """
    if indices.size and int(indices.max()) >= len(palette):
        raise ValueError(
            f"index {int(indices.max())} is outside its palette of {len(palette)} colours"
        )
    used = palette[np.unique(indices)]
    if np.all(used == used[:, :1]):
        return palette[:, 0][indices], False
    return palette[indices], True

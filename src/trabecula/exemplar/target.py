"""Porosities of an exemplar from place to place, which bound the targets it can serve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.target import Target, porosity_of

_WINDOWS = 4
"""A window has this fraction of every side."""


def porosity_range(exemplar: Image) -> tuple[float, float]:
    """Return the least and greatest porosity of windows of a quarter of the exemplar's sides, at
    any position.

    Parameters
    ----------
    exemplar : Image of labels, (Z, Y, X) or (Y, X)

    Returns
    -------
    low, high : float
        Shares of the phase "void" (label 0 where none has that name), 0 .. 1.

    Examples
    --------
    >>> porosity_range(Image(np.arange(64).reshape(8, 8) // 8 > 4, "labels"))
    (0.0, 1.0)
    """
    void = exemplar.values == (exemplar.phases.index("void") if "void" in exemplar.phases else 0)
    sums, size = void.astype(np.int64), 1
    for axis, side in enumerate(exemplar.shape):
        width = max(1, side // _WINDOWS)
        sums = np.insert(np.cumsum(sums, axis=axis), 0, 0, axis=axis)
        sums = sums.take(range(width, side + 1), axis) - sums.take(range(side + 1 - width), axis)
        size *= width
    return float(sums.min() / size), float(sums.max() / size)


def check_target_porosity(
    target: Mapping[str, Target],
    exemplars: Sequence[Image],
    *,
    mask: np.ndarray | None = None,
    beyond: float = 0.0,
) -> None:
    """Raise where no part of the exemplars has a target porosity (or 1 - volume_fraction).

    Parameters
    ----------
    target : mapping
        Of a `Request`.
    exemplars : sequence of Image
    mask : bool array, optional
        Of the request: a field counts inside it only.
    beyond : float
        How far outside the exemplars' range is allowed, as a share of the way to 0 and to 1, 0 ..
        1.

    Raises
    ------
    RequestError
        Exemplars that are not labels; a porosity, or a part of a field, outside every exemplar's
        `porosity_range` and what is allowed beyond.
    """
    porosity = porosity_of(target)
    if porosity is None:
        return
    if exemplars[0].kind != "labels":
        raise RequestError(
            f"a target porosity needs phases, the exemplar is {exemplars[0].kind}: segment it "
            "(tb.segment, or --threshold auto), or leave the target out"
        )
    asked = np.asarray(porosity)
    asked = asked[mask] if mask is not None and asked.ndim else asked
    ranges = [porosity_range(exemplar) for exemplar in exemplars]
    low, high = min(first for first, _ in ranges), max(last for _, last in ranges)
    # A field is float32, and 1/3 in it is above 1/3.
    least, most = low * (1 - beyond) - 1e-6, high + (1 - high) * beyond + 1e-6
    if asked.min() < least or asked.max() > most:
        what = f"{asked.min():.4g} .. {asked.max():.4g}" if asked.ndim else f"{float(asked):.4g}"
        raise RequestError(
            f"the target porosity {what} is outside what the exemplar holds: windows of a quarter "
            f"of its sides have {low:.4g} .. {high:.4g}{_and_more(least, most) if beyond else ''}; "
            "ask for one in between, or give an exemplar that holds it"
        )


def _and_more(least: float, most: float) -> str:
    return f", and {least:.4g} .. {most:.4g} can be made of it"

"""Trapped: pores that no way leads out of, where powder or resin would stay."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image, with_values
from trabecula.finish.connect import _background
from trabecula.finish.labels import repainted
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import indicator


class _Pores(NamedTuple):
    """The phase, the void around it, the void's components with their sizes, and which of them touch no face."""

    image: Image
    inside: np.ndarray
    void: np.ndarray
    labels: np.ndarray
    sizes: np.ndarray
    closed: np.ndarray


def trapped(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> dict[str, Any]:
    """Pores that do not reach a face of the image: what is in them cannot come out.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        The phase that walls them in. Default: "solid", which is every phase but "void" taken together.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Ways through the void. Default: through faces of voxels.

    Returns
    -------
    figures : dict
        `pores` (their number), `voxels`, `volume` (in unit**3, or unit**2 of a 2-D image), `share` (of the void, 0..1),
        `largest` (voxels).

    Raises
    ------
    InputError
        No such phase, another connectivity.

    Examples
    --------
    >>> ring = np.ones((5, 5), int); ring[2, 2] = 0; ring[0, 0] = 0
    >>> trapped(ring)["pores"], trapped(ring)["share"]
    (1, 0.5)
    """
    pores = _pores(image, phase, connectivity)
    held = pores.sizes[pores.closed]
    total = int(held.sum())
    return {
        "pores": len(held),
        "voxels": total,
        "volume": total * float(np.prod(pores.image.spacing)),
        "share": total / max(1, int(np.count_nonzero(pores.void))),
        "largest": int(held.max(initial=0)),
    }


def fill_trapped(image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None) -> Image:
    """Fill the pores that do not reach a face of the image.

    Parameters
    ----------
    image, phase, connectivity
        As for `trapped`.

    Returns
    -------
    image : Image
        Filled voxels take the nearest label of the phase. The recipe's step holds a `report`: `filled_pores`, `filled`
        (voxels).

    Raises
    ------
    InputError
        As `trapped`.
    """
    pores = _pores(image, phase, connectivity)
    image, sizes, closed = pores.image, pores.sizes, pores.closed
    after = pores.inside | np.concatenate([[False], closed])[pores.labels]
    values = repainted(image, pores.inside, after, _background(image, phase))
    report = {"filled_pores": np.count_nonzero(closed), "filled": int(sizes[closed].sum())}
    settings = {"phase": phase, "connectivity": connectivity}
    recipe = image.recipe.then("finish", values, operation="fill_trapped", settings=settings, report=report)
    return with_values(image, values, recipe=recipe)


def _pores(image: Image | ArrayLike, phase: str | int | None, connectivity: int | None) -> _Pores:
    image, inside = indicator(image, phase)
    void = image.values == _background(image, phase)
    labels, sizes = label_components(void, connectivity=connectivity)
    closed = np.ones(len(sizes) + 1, bool)
    for axis in range(labels.ndim):
        for end in (0, -1):
            closed[labels.take(end, axis=axis)] = False
    return _Pores(image, inside, void, labels, sizes, closed[1:])

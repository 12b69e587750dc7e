"""Closed pores, in which powder or resin is trapped: their figures, and filling them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.parallel import in_order
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, lift, relabel, with_step
from trabecula.measure.labelling import label_components, labels_at_faces
from trabecula.measure.phases import as_connectivity, indicator, members
from trabecula.measure.runs import runs_of


class _Pores(NamedTuple):
    """A phase, its void, the void's components with their sizes, and the closed ones of these."""

    image: Image
    inside: np.ndarray
    void: np.ndarray
    labels: np.ndarray
    sizes: np.ndarray
    closed: np.ndarray


def trapped(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> dict[str, Any]:
    """Measure the closed pores, those that reach no face of the image.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        The phase around them. Default: "solid", which is every phase but "void" taken
        together.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the void. Default: voxels that share a face.

    Returns
    -------
    figures : dict
        `pores` (their number), `voxels`, `volume` (in unit**3, or unit**2 of a 2-D image), `share`
        (of the void, 0..1), `largest` (voxels).

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


def fill_trapped(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: Image | ArrayLike | None = None,
) -> Image:
    """Fill the pores that do not reach a face of the image.

    Parameters
    ----------
    image, phase, connectivity
        As for `trapped`.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): what reaches outside of it is no closed
        pore, such as the cavity of a hollow form.

    Returns
    -------
    image : Image
        Filled voxels take the nearest label of the phase. The recipe's step holds a `report`:
        `filled_pores`, `filled` (voxels).

    Raises
    ------
    InputError
        As `trapped`; a mask of another shape.
    """
    image = as_image(image)
    background = background_of(image, phase)
    form = as_form(mask, image.shape)
    values = np.array(image.values, order="C")
    settings: dict[str, Any] = {"phase": phase, "connectivity": connectivity}
    if len(_labels_present(lift(values), image, phase)) <= 1:
        inside = None if form is None else lift(form)
        report = fill_trapped_in_place(lift(values), image, **settings, inside=inside)
    else:
        pores = _pores(image, phase, connectivity)
        if form is not None:
            pores.closed[_numbers_outside(pores.labels, form)] = False
        after = pores.inside | np.concatenate([[False], pores.closed])[pores.labels]
        values = relabel(image, pores.inside, after, background)
        report = {
            "filled_pores": np.count_nonzero(pores.closed),
            "filled": int(pores.sizes[pores.closed].sum()),
        }
    return with_step(image, values, "fill_trapped", settings, report, **form_recipe(mask))


def fill_trapped_in_place(
    values: np.ndarray,
    image: Image,
    *,
    phase: str | int | None,
    connectivity: int | None,
    inside: np.ndarray | None = None,
) -> dict[str, int]:
    """Fill the closed pores of labels (Z, Y, X) in place; return the report.

    The settings are those of `fill_trapped`; `image` names the phases, its values are not read.
    `inside` (bool, same shape) marks the form.

    Raises
    ------
    InputError
        The phase has several labels here: the nearest one cannot be found slab by slab.
    """
    background = background_of(image, phase)
    labels = _labels_present(values, image, phase)
    if len(labels) > 1:
        names = ", ".join(image.phases[label] for label in labels)
        raise InputError(
            f"pores among {names} take the nearest of them, which needs the whole volume in "
            "memory: name one --phase, or raise --memory"
        )
    void = np.arange(256) == background
    runs = runs_of(values, void, as_connectivity(connectivity, image.ndim))
    closed = ~runs.at_faces(tuple(range(3 - image.ndim, 3)))
    if inside is not None:
        closed[_numbers_outside(runs.labels(), inside)] = False
    if len(labels):
        runs.write(values, closed, int(labels[0]))
    return {"filled_pores": int(np.count_nonzero(closed)), "filled": int(runs.sizes[closed].sum())}


def _numbers_outside(labels: np.ndarray, form: np.ndarray) -> np.ndarray:
    """Return the components that reach outside of a form, counted from 0."""
    found = np.unique(labels[~form])
    return found[found > 0] - 1


def _labels_present(values: np.ndarray, image: Image, phase: str | int | None) -> np.ndarray:
    """Return the labels of a phase that occur in an array (Z, Y, X)."""
    counts = np.zeros(256, np.int64)

    def count(first: int, last: int) -> None:
        for plane in values[first:last]:
            counts[:] += np.bincount(plane.ravel(), minlength=256)

    in_order(count, len(values))
    return np.flatnonzero((counts > 0) & members(image, phase))


def _pores(image: Image | ArrayLike, phase: str | int | None, connectivity: int | None) -> _Pores:
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    void = image.values == background
    labels, sizes = label_components(void, connectivity=connectivity)
    closed = ~labels_at_faces(labels, len(sizes))
    return _Pores(image, inside, void, labels, sizes, closed[1:])

"""Prune: struts that end freely are removed where they are short, and grown into the next strut
where they are long.

Section 4.4 of Zhang, Chen, Wang and Wang 2017. A round:

1. Thin the phase, read the skeleton as a graph, and find the struts that end freely
(`finish.branches`).
2. Of these as many are spurious as there are more, per volume of what is filled, than in the
exemplar; the shortest
   first, but before them any that are longer than all of the exemplar's.
3. One that is shorter than theta times the perimeter of its cell is removed (`finish.cutting`), any
other grown
   (`finish.growing`).

Rounds go on while they change something, as the skeleton changes with the material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, with_values
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe
from trabecula.finish.branch_growth import Struts, grow, struts_of
from trabecula.finish.branches import Anatomy, FreeEnd, anatomy, cell_perimeters
from trabecula.finish.connect import background_of
from trabecula.finish.forms import as_form, fills_form, form_recipe
from trabecula.measure.phases import indicator

_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class _Model:
    """What an exemplar has of free ends, and its struts."""

    ends: int
    density: float
    longest: float
    struts: Struts | None


def prune(
    image: Image | ArrayLike,
    *,
    exemplar: Image | ArrayLike | None = None,
    phase: str | int | None = None,
    theta: float = 0.11,
    mask: Image | ArrayLike | None = None,
) -> Image:
    """Remove or complete struts that end freely: the connectivity pruning of Zhang, Chen, Wang and
    Wang 2017, section 4.4.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    exemplar : Image or array of labels, optional
        What the image was made from. Real materials have free ends too: no more are treated than
        the image has above the exemplar's number per volume, and what is grown is copied from the
        exemplar's struts. Without one every free end is spurious, and grown straight on with its
        own thickness. Where one of the two has no unit, their voxels are taken to be alike.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    theta : float
        0..10. A free end shorter than this share of its cell's perimeter is removed, another grown.
        The perimeter is that of the shortest loop of the skeleton through the joint from which the
        free end grows, and no less than the median of such loops.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): free ends are counted per volume of it,
        struts that its surface cuts are not judged, and nothing is grown outside of it. Default:
        the image is filled as a whole; where its recipe tells of a form, this is said.

    Returns
    -------
    image : Image
        With no more components than before: what is removed opens no loop and leaves no piece
        behind, and what is grown makes a loop (or joins two components). New voxels take the label
        at the free end; what is removed becomes void. The recipe's step holds a `report`:
        `ends_before`, `ends_after`, `ends_exemplar`, `ends_allowed` (the exemplar's number per
        volume, times the volume of the image or of the form), `removed`, `grown`, `left` (spurious
        ones for which nothing could be done: nothing within a cell's diameter ahead, or no loops at
        all), `removed_voxels`, `added`, `rounds`.

    Raises
    ------
    InputError
        The phase is empty; theta out of range; an exemplar of another number of axes, or in another
        unit; a mask of another shape.

    Notes
    -----
    Free ends at the faces are not judged, nor roughness of a surface, nor corners of plates: see
    `finish.branches`. A component that is a line of its own has no joint and is left to `connect`.
    Free ends are few: give the whole scan as the exemplar where the image was made from a crop, so
    that their number per volume means something.

    Examples
    --------
    >>> frame = np.zeros((40, 60), int)
    >>> frame[5:35, 5:55] = 1
    >>> frame[8:32, 8:52] = 0
    >>> frame[8:27, 29:31] = 1  # a strut that ends before it meets the other side
    >>> part = prune(frame)
    >>> report = part.recipe.steps[-1]["report"]
    >>> report["ends_before"], report["removed"], report["grown"], report["ends_after"]
    (1, 0, 1, 0)
    """
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    theta = as_number(theta, name="theta", low=0, high=10)
    if not inside.any():
        raise InputError(
            f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing to prune"
        )
    source = None if exemplar is None else _source(exemplar, image)
    form = as_form(mask, image.shape)
    if form is None and fills_form(image.recipe):
        notify(
            "prune: the image fills a form, and free ends are counted as if it filled its box: give the form (mask, --mask), "
            "so that they are counted per volume of it and struts that its surface cuts are left alone"
        )
    # Lengths from here on in the smallest edge: the same voxels then whatever the unit.
    scale = min(image.spacing)
    spacing = tuple(edge / scale for edge in image.spacing)
    model = _Model(0, 0.0, np.inf, None) if source is None else _model(source, phase, scale)
    values = np.array(image.values, order="C")
    closed = _lifted(((values != background) & ~inside) | (False if form is None else ~form))
    parts = anatomy(inside, spacing, form)
    report = {
        "ends_before": len(parts.ends),
        "removed": 0,
        "grown": 0,
        "removed_voxels": 0,
        "added": 0,
        "rounds": 0,
    }
    while report["rounds"] < _ROUNDS and _round(
        parts, values, background, model, theta, closed, report
    ):
        report["rounds"] += 1
        inside = parts.territories.inside[1:-1, 1:-1, 1:-1].astype(bool).reshape(values.shape)
        parts = anatomy(inside, spacing, form)
    report |= {"ends_after": len(parts.ends), "left": len(_spurious(parts, model))}
    report |= {"ends_exemplar": model.ends, "ends_allowed": round(model.density * parts.volume)}
    settings = {"phase": phase, "theta": theta}
    made = {"exemplars": [] if source is None else [source.recipe], **form_recipe(mask)}
    recipe = image.recipe.then(
        "finish", values, operation="prune", settings=settings, **made, report=report
    )
    return with_values(image, values, recipe=recipe)


def _source(exemplar: Image | ArrayLike, image: Image) -> Image:
    """The exemplar, checked; one without a recipe gets one that names its voxels."""
    source, _ = indicator(exemplar, None)
    if source.ndim != image.ndim:
        raise InputError(
            f"the exemplar has {source.ndim} axes, the image {image.ndim}: give the exemplar that the image was made from"
        )
    recipe = source.recipe if source.recipe else Recipe().then("array", source.values)
    if source.unit == image.unit:
        return with_values(source, source.values, recipe=recipe)
    if "voxel" not in (source.unit, image.unit):
        raise InputError(
            f"the exemplar is in {source.unit}, the image in {image.unit}: lengths are compared, so give both in one unit"
        )
    if source.unit != image.unit or source.spacing != image.spacing:
        notify(
            f"prune: the image is in {image.unit}, the exemplar in {source.unit}, so one voxel of both is taken for the same "
            "length: give the spacing and unit of both (--spacing, --unit) where it is not"
        )
    return with_values(source, source.values, recipe=recipe, spacing=image.spacing, unit=image.unit)


def _model(exemplar: Image, phase: str | int | None, scale: float) -> _Model:
    _, inside = indicator(exemplar, phase)
    if not inside.any():
        raise InputError(
            "the exemplar holds nothing of the phase: nothing to compare the image with"
        )
    parts = anatomy(inside, tuple(edge / scale for edge in exemplar.spacing))
    longest = max((end.length for end in parts.ends), default=0.0)
    density = len(parts.ends) / parts.volume if parts.volume else 0.0
    return _Model(len(parts.ends), density, longest, struts_of(parts))


def _lifted(marked: np.ndarray) -> np.ndarray | None:
    """With three axes and the territories' margin; None where nothing is marked."""
    if not marked.any():
        return None
    return np.pad(marked.reshape((1,) * (3 - marked.ndim) + marked.shape), 1)


def _spurious(parts: Anatomy, model: _Model) -> list[FreeEnd]:
    """The free ends to treat: as many as there are too many."""
    excess = max(0, len(parts.ends) - round(model.density * parts.volume))
    unlike = [end for end in parts.ends if end.length > model.longest]
    return (unlike[::-1] + [end for end in parts.ends if end.length <= model.longest])[:excess]


def _round(
    parts: Anatomy,
    values: np.ndarray,
    background: int,
    model: _Model,
    theta: float,
    closed: np.ndarray | None,
    report: dict[str, int],
) -> bool:
    """Treat every spurious end once, writing into `values`, the territories and the report; whether
    anything changed.
    """
    ends = _spurious(parts, model)
    perimeters = cell_perimeters(parts.graph, [end.root for end in ends])
    shape = parts.territories.inside.shape
    changed = False
    for short in (True, False):  # what is grown should not end at what is removed
        for end, perimeter in zip(ends, perimeters, strict=True):
            if not np.isfinite(perimeter) or (end.length < theta * perimeter) != short:
                continue
            space = parts.territories
            places = (
                space.cut(end.branch, end.tip)
                if short
                else grow(end, perimeter, parts, model.struts, closed)
            )
            at = tuple(np.stack(np.unravel_index(places, shape))[3 - values.ndim :] - 1)
            values[at] = background if short else values[tuple(end.tip[3 - values.ndim :] - 1)]
            report["removed" if short else "grown"] += len(places) > 0
            report["removed_voxels" if short else "added"] += len(places)
            changed |= len(places) > 0
    return changed

"""Prune: struts with a free end are removed where they are short, and extended to the next strut
where they are long.

Section 4.4 of Zhang, Chen, Wang and Wang 2017. A round:

1. Thin the phase, convert the skeleton to a graph, and find the struts with a free end
   (`finish.branches`).
2. The excess over the exemplar's number per filled volume is spurious: first the ends that are
   longer than all of the exemplar's, then the shortest ones.
3. A spurious end shorter than theta times the perimeter of its cell is removed
   (`finish.branch_removal`), any other is grown (`finish.branch_growth`).

Rounds repeat while they change something, as the skeleton changes with the material.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from trabecula.finish.forms import as_form, fills_form, form_recipe
from trabecula.finish.labels import background_of, check_present, lift, with_step
from trabecula.finish.periodic import (
    crop_margins,
    material_origin,
    pad_wrapped,
    periodic_images,
    periodic_setting,
    roll_by,
    wrap_margins,
)
from trabecula.measure.phases import as_periodic, indicator

_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class _Reference:
    """The free ends and the struts of an exemplar; lengths in the image's smallest voxel edge."""

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
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Remove or complete struts with a free end.

    The connectivity pruning of Zhang, Chen, Wang and Wang 2017, section 4.4.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    exemplar : Image or array of labels, optional
        The exemplar of the image. Real materials have free ends too: only the excess over the
        exemplar's number per volume is treated, and new struts are copied from the exemplar's.
        Without one every free end is spurious, and new struts are straight, of the thickness of the
        old one. Where one of the two has no unit, their voxels are taken to be equal.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    theta : float
        0..10. A free end shorter than this share of its cell's perimeter is removed, another grown.
        The perimeter is that of the shortest loop of the skeleton through the joint from which the
        free end grows, and no less than the median of such loops.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): free ends are counted per volume of it,
        struts that its surface cuts are not judged, and nothing is grown outside of it. Default:
        the whole image, with a notice where its recipe names a form.
    periodic : bool or one per axis
        The image continues at the opposite face: no strut is cut there, and struts grow across it.
        Takes the memory of an image with a cell more on either side.

    Returns
    -------
    image : Image
        With no more components than before: a removal opens no loop and leaves no component
        behind, and a grown strut makes a loop (or joins two components). New voxels take the label
        at the free end; removed voxels become void. The recipe's step holds a `report`:
        `ends_before`, `ends_after`, `ends_exemplar`, `ends_allowed` (the exemplar's number per
        volume, times the volume of the image or of the form), `removed`, `grown`, `left` (spurious
        ends without a remedy: no target within a cell's diameter, or no loops at all),
        `removed_voxels`, `added`, `rounds`.

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
    check_present(bool(inside.any()), phase, "to prune")
    source = None if exemplar is None else _as_exemplar(exemplar, image)
    form = as_form(mask, image.shape)
    if form is None and fills_form(image.recipe):
        notify(
            "prune: the image fills a form, and free ends are counted as if it filled its box: "
            "give the form (mask, --mask), so that they are counted per volume of it and struts "
            "that its surface cuts are left alone"
        )
    # Lengths from here on in units of the smallest edge: the voxels do not depend on the unit.
    scale = min(image.spacing)
    spacing = tuple(edge / scale for edge in image.spacing)
    reference = (
        _Reference(0, 0.0, np.inf, None) if source is None else _measure(source, phase, scale)
    )
    wraps = as_periodic(periodic, image.ndim)
    origin = material_origin(image.values, wraps)
    back = [-step for step in origin]
    inside = roll_by(inside, back)
    margins = wrap_margins(inside, wraps)
    inside = pad_wrapped(inside, margins)
    values = pad_wrapped(roll_by(image.values, back), margins)
    form = None if form is None else pad_wrapped(roll_by(form, back), margins)
    closed = _pad_marked(((values != background) & ~inside) | (False if form is None else ~form))
    parts = anatomy(inside, spacing, form, margins)
    report = {
        "ends_before": len(parts.ends),
        "removed": 0,
        "grown": 0,
        "removed_voxels": 0,
        "added": 0,
        "rounds": 0,
    }
    while report["rounds"] < _ROUNDS and _round(
        parts, values, background, reference, theta, closed, report
    ):
        report["rounds"] += 1
        inside = parts.territories.inside[1:-1, 1:-1, 1:-1].astype(bool).reshape(values.shape)
        parts = anatomy(inside, spacing, form, margins)
    values = np.ascontiguousarray(roll_by(crop_margins(values, margins), origin))
    report |= {"ends_after": len(parts.ends), "left": len(_spurious_ends(parts, reference))}
    allowed = round(reference.density * parts.volume)
    report |= {"ends_exemplar": reference.ends, "ends_allowed": allowed}
    exemplars = [] if source is None else [source.recipe]
    settings = {"phase": phase, "theta": theta, "periodic": periodic_setting(wraps)}
    return with_step(
        image, values, "prune", settings, report, exemplars=exemplars, **form_recipe(mask)
    )


def _as_exemplar(exemplar: Image | ArrayLike, image: Image) -> Image:
    """Check the exemplar; one without a recipe gets one that names its voxels."""
    source, _ = indicator(exemplar, None)
    if source.ndim != image.ndim:
        raise InputError(
            f"the exemplar has {source.ndim} axes, the image {image.ndim}: give the exemplar that "
            "the image was made from"
        )
    recipe = source.recipe if source.recipe else Recipe().then("array", source.values)
    if source.unit == image.unit:
        return with_values(source, source.values, recipe=recipe)
    if "voxel" not in (source.unit, image.unit):
        raise InputError(
            f"the exemplar is in {source.unit}, the image in {image.unit}: lengths are compared, "
            "so give both in one unit"
        )
    if source.unit != image.unit or source.spacing != image.spacing:
        notify(
            f"prune: the image is in {image.unit}, the exemplar in {source.unit}, so one voxel of "
            "both is taken for the same length: give the spacing and unit of both (--spacing, "
            "--unit) where it is not"
        )
    return with_values(source, source.values, recipe=recipe, spacing=image.spacing, unit=image.unit)


def _measure(exemplar: Image, phase: str | int | None, scale: float) -> _Reference:
    """Measure the free ends and struts of the exemplar; `scale` is the unit of length."""
    _, inside = indicator(exemplar, phase)
    if not inside.any():
        raise InputError(
            "the exemplar holds nothing of the phase: nothing to compare the image with"
        )
    parts = anatomy(inside, tuple(edge / scale for edge in exemplar.spacing))
    longest = max((end.length for end in parts.ends), default=0.0)
    density = len(parts.ends) / parts.volume if parts.volume else 0.0
    return _Reference(len(parts.ends), density, longest, struts_of(parts))


def _pad_marked(marked: np.ndarray) -> np.ndarray | None:
    """Return the array with three axes and the territories' margin; None where all is False."""
    return np.pad(lift(marked), 1) if marked.any() else None


def _spurious_ends(parts: Anatomy, reference: _Reference) -> list[FreeEnd]:
    """Return the free ends to treat: the excess over the reference's density."""
    excess = max(0, len(parts.ends) - round(reference.density * parts.volume))
    longer = [end for end in parts.ends if end.length > reference.longest]
    others = [end for end in parts.ends if end.length <= reference.longest]
    return (longer[::-1] + others)[:excess]


def _round(
    parts: Anatomy,
    values: np.ndarray,
    background: int,
    reference: _Reference,
    theta: float,
    closed: np.ndarray | None,
    report: dict[str, int],
) -> bool:
    """Remove or grow every spurious end once; return whether any voxel changed.

    Writes into `values`, the territories and the report; in margins that repeat the image, the same
    as in the image.
    """
    space = parts.territories
    ends = _spurious_ends(parts, reference)
    perimeters = cell_perimeters(parts.graph, [end.root for end in ends])
    margins = (0,) * (3 - values.ndim) + parts.margins
    changed = False
    for short in (True, False):  # remove first: no new strut should end at one that is removed
        for end, perimeter in zip(ends, perimeters, strict=True):
            if not np.isfinite(perimeter) or (end.length < theta * perimeter) != short:
                continue
            if not space.inside[tuple(end.tip)]:  # removed as its image beyond a periodic face
                continue
            places = (
                space.cut(end.branch, end.tip)
                if short
                else grow(end, perimeter, parts, reference.struts, closed)
            )
            if not len(places):
                continue
            images = periodic_images(space.places(places) - 1, margins, lift(values).shape)
            space.write(images + 1, grown=not short)
            lift(values)[tuple(images.T)] = (
                background if short else lift(values)[tuple(end.tip - 1)]
            )
            report["removed" if short else "grown"] += 1
            report["removed_voxels" if short else "added"] += len(places)
            changed = True
    return changed

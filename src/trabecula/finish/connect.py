"""Connect: one component out of many, by the cheapest joins; only specks are discarded.

1. Number the components; the largest is the body, those below a stated size are specks.
2. Join the others along a minimum spanning tree (`cheapest_joins`), at any distance. Where a reach
   is given, search from every component through the background for the body instead, at most
   `reach` voxels far (`join_near`), and repeat, since a component that has been joined may
   bring others within reach.
3. Components that are still loose become background: specks, and with a reach those farther away.

Components are stored as runs along x. With a reach, each search is confined to a box around its
component, and no array of the image's size is needed besides the image and the result; without one
three are needed. They are memory-mapped where the result is (see `finish.slabs`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import sum_slabs
from trabecula.finish.forms import as_form, form_recipe
from trabecula.finish.labels import background_of, check_present, lift, with_step
from trabecula.finish.periodic import (
    material_origin,
    periodic_setting,
    roll_by,
)
from trabecula.measure.joins import cheapest_joins
from trabecula.measure.labelling import joined_across
from trabecula.measure.near_joins import JOINED_AT_ONCE, fill_path, join_near
from trabecula.measure.phases import as_connectivity, as_periodic, members
from trabecula.measure.runs import Runs, runs_of

_SHARE = 0.005
"""Largest share of the phase that a speck may have, where `min_size` is not given."""

_MUCH = 0.01
"""Share of the phase above which discarded voxels are worth a note."""

UNJOINED = ("keep", "remove")
"""Choices for the components that are not joined."""


def connect(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    reach: int | None = None,
    brush: int = 2,
    min_size: int | None = None,
    connectivity: int | None = None,
    unjoined: str | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Connect a phase: join every component larger than a speck, discard the specks.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    reach : int, optional
        Longest join, in voxels of background passed from face to face; 0 joins nothing. Default:
        no limit; components are joined along a minimum spanning tree, which fills the fewest
        voxels.
    brush : int
        Thickness of a join, in voxels.
    min_size : int, optional
        Components of fewer voxels are specks: they are discarded and not joined. Default: a cube of
        the phase's mean chord, but no more than 0.5 % of the phase.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours of a voxel. Default: those that share a face.
    unjoined : {"keep", "remove"}, optional
        Treatment of components that are no specks and cannot be joined, since they are farther
        than `reach` or behind another phase. Default: "remove" where a reach is given, else
        "keep".
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`): joins run inside it.
    periodic : bool or one per axis
        The image continues at the opposite face: components that meet there are one, and joins run
        across it. A reach then limits the joins of the spanning tree.

    Returns
    -------
    image : Image
        No voxel of a component that is not removed has changed. Joins take the label they start
        from, and removed components become void (where the void itself is connected: the other
        phase). The recipe's step holds a `report`: `joins`, `added` (voxels that the joins fill),
        `longest` (voxels of background along the longest join), `removed_parts`, `removed`
        (components and voxels), `left_parts`, `left` (components that stay loose beside the
        largest, and their voxels), `min_size`.

    Raises
    ------
    InputError
        The phase is empty; a negative reach or size; a mask of another shape; the void of an image
        of several phases, since it is open which of them fills a removed pore.

    References
    ----------
    Mehlhorn 1988, doi:10.1016/0020-0190(88)90066-X, theorem 1: the minimum spanning tree.

    Examples
    --------
    >>> limbs = np.zeros((9, 9, 60), int)
    >>> limbs[3:6, 3:6, 2:30] = limbs[3:6, 3:6, 50:58] = 1
    >>> limbs[0, 0, 0] = 1
    >>> part = connect(limbs)
    >>> report = part.recipe.steps[-1]["report"]
    >>> report["joins"], report["longest"], report["added"], report["removed"], report["left"]
    (1, 20, 80, 1, 0)
    """
    image = as_image(image)
    wraps = as_periodic(periodic, image.ndim)
    form = as_form(mask, image.shape)
    origin = material_origin(image.values, wraps)
    back = [-step for step in origin]
    values = np.array(roll_by(image.values, back), order="C")  # a copy: the caller's array stays
    inside = None if form is None else lift(roll_by(form, back))
    settings: dict[str, Any] = {
        "phase": phase,
        "reach": reach,
        "brush": brush,
        "min_size": min_size,
        "connectivity": connectivity,
        "unjoined": unjoined,
        "periodic": periodic_setting(wraps),
    }
    report = connect_in_place(lift(values), image, **settings, inside=inside)
    values = roll_by(values, origin)
    return with_step(image, values, "connect", settings, report, **form_recipe(mask))


def connect_in_place(
    values: np.ndarray,
    image: Image,
    *,
    phase: str | int | None,
    reach: int | None,
    brush: int,
    min_size: int | None,
    connectivity: int | None,
    unjoined: str | None,
    periodic: bool | Sequence[bool],
    inside: np.ndarray | None = None,
) -> dict[str, int]:
    """Connect a phase within labels (Z, Y, X) in place; return the report.

    The settings are those of `connect`; `image` names the phases, its values are not read.
    """
    background, member = background_of(image, phase), members(image, phase)
    _check_settings(reach, brush, min_size)
    unjoined = ("keep" if reach is None else "remove") if unjoined is None else unjoined
    check_name(unjoined, UNJOINED, name="treatment of unjoined components")
    neighbours = as_connectivity(connectivity, image.ndim)
    wraps = (False,) * (3 - image.ndim) + as_periodic(periodic, image.ndim)
    again = (member, neighbours, wraps, phase)
    runs = _runs(values, *again)
    whole = int(runs.sizes.sum())
    least = _speck_size(values, member, whole) if min_size is None else min_size
    if reach is None or any(wraps):
        found = _join_all(values, runs, background, (reach, brush, least), inside, wraps)
        runs = _runs(values, *again) if found["joins"] else runs
    else:
        found, runs = join_near(
            values,
            runs,
            lambda: _runs(values, *again),
            background,
            reach=reach,
            brush=brush,
            least=least,
            inside=inside,
        )
    loose = np.arange(len(runs.sizes)) != np.argmax(runs.sizes)
    gone = loose & (runs.sizes < least) if unjoined == "keep" else loose
    runs.write(values, gone, background)
    left = loose & ~gone
    found |= {"removed_parts": int(np.count_nonzero(gone)), "removed": int(runs.sizes[gone].sum())}
    found |= {
        "left_parts": int(np.count_nonzero(left)),
        "left": int(runs.sizes[left].sum()),
        "min_size": int(least),
    }
    _notify_losses(found, whole)
    return found


def _runs(
    values: np.ndarray,
    member: np.ndarray,
    neighbours: int,
    wraps: tuple[bool, ...],
    phase: str | int | None,
) -> Runs:
    runs = joined_across(runs_of(values, member, neighbours), neighbours, wraps)
    check_present(len(runs.sizes) > 0, phase, "to connect")
    return runs


def _speck_size(values: np.ndarray, member: np.ndarray, whole: int) -> int:
    """Return the voxels of a cube of the mean chord, at most `_SHARE` of the phase.

    The mean is over the axes that have more than one voxel.
    """
    chords = sum_slabs(lambda start, stop: _count_chords(values, member, start, stop), len(values))
    axes = [side > 1 for side in values.shape]
    chord = max(1, sum(axes)) * whole / max(1, int(chords[axes].sum()))
    return max(2, round(min(chord ** sum(axes), _SHARE * whole)))


def _notify_losses(found: dict[str, int], whole: int) -> None:
    """Report the discarded components where they are many, and those that stay loose."""
    if found["removed"] > _MUCH * whole:
        notify(
            f"connect: {found['removed_parts']} components were removed, "
            f"{found['removed'] / whole:.2%} of the phase; those of {found['min_size']} voxels or "
            "more are joined where no reach is given (min_size, --min-size)"
        )
    if found["left_parts"]:
        notify(
            f"connect: {found['left_parts']} components of {found['min_size']} voxels or more "
            f"({found['left'] / whole:.2%} of the phase) could not be joined and stay loose"
        )


def _join_all(
    values: np.ndarray,
    runs: Runs,
    background: int,
    settings: tuple[int | None, int, int],
    inside: np.ndarray | None,
    wraps: tuple[bool, ...],
) -> dict[str, int]:
    """Join all components but specks along a minimum spanning tree, in place; return the counts.

    Its joins longer than a reach are left out.
    """
    reach, brush, least = settings
    worth = runs.sizes >= least
    worth[np.argmax(runs.sizes)] = True
    filled = longest = 0
    paths = cheapest_joins(values, runs, worth, background, inside, wraps)
    if reach is not None:
        paths = [path for path in paths if len(path) - 1 <= reach]
    for number, path in enumerate(paths):
        filled += fill_path(values, path, background, brush, inside, wraps)
        longest = max(longest, len(path) - 1)
        if number % JOINED_AT_ONCE == 0:
            memmap.release_pages()
    return {"joins": len(paths), "added": filled, "longest": longest}


def _check_settings(reach: int | None, brush: int, min_size: int | None) -> None:
    for name, value, least in (("reach", reach, 0), ("brush", brush, 1), ("min_size", min_size, 0)):
        if value is None and name != "brush":
            continue
        if (
            value is None
            or isinstance(value, bool)
            or not isinstance(value, (int, np.integer))
            or value < least
        ):
            raise InputError(
                f"{name} {quote(value)} must be a whole number of voxels, at least {least}"
            )


@kernel
def _count_chords(values, member, start, stop):
    """Count the runs of members along z, y and x that begin in a slab."""
    height, width = values.shape[1:]
    found = np.zeros(3, np.int64)
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                if member[values[z, y, x]]:
                    found[0] += z == 0 or not member[values[z - 1, y, x]]
                    found[1] += y == 0 or not member[values[z, y - 1, x]]
                    found[2] += x == 0 or not member[values[z, y, x - 1]]
    return found

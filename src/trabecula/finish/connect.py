"""Connect: one piece out of many, by the shortest joins.

1. Number the components; the largest is the body.
2. From every other component that is worth it, grow outwards through the background, face by face, until the body is
   met or `reach` voxels are passed; the way back is filled with a brush.
3. Again from 1, since a part that is joined may bring others within reach; until nothing is joined any more.
4. What is still loose becomes background.

A part is searched from in its own box, so the cost is that of the loose parts and not of the image. Components are kept as
runs along x: besides the image and the result no array of the image's size is needed. The result may lie in a scratch file, and
then nothing of the image's size has to be in memory (see `finish.slabs`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError, UnnamedVoidError
from trabecula.core.image import Image, as_image, check_labels, phase_index, with_values
from trabecula.engine import scratch
from trabecula.engine.compile import kernel
from trabecula.finish.joins import shortest_join
from trabecula.measure.phases import as_connectivity, members
from trabecula.measure.runs import Runs, runs_of

_SOME = 32
"""Parts that are joined before pages of scratch files are handed back."""


def connect(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    reach: int = 5,
    brush: int = 2,
    min_size: int = 30,
    connectivity: int | None = None,
) -> Image:
    """Make a phase one connected piece: join what is near the largest component, remove the rest.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    reach : int
        Longest join, in voxels of background passed from face to face. 0 joins nothing and only removes.
    brush : int
        Thickness of a join, in voxels.
    min_size : int
        Components of fewer voxels are specks: they are removed and not joined.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        What counts as connected. Default: voxels that share a face.

    Returns
    -------
    image : Image
        The phase is one component, and no voxel of its largest component has changed. Joins take the label they start
        from, and what is removed becomes void (where the void itself is connected: the other phase). The recipe's step
        holds a `report`: `joins`, `added` (voxels), `removed_parts`, `removed` (voxels).

    Raises
    ------
    InputError
        The phase is empty; a negative reach or size; the void of an image of several phases, where it is open what a
        removed pore would be filled with.
    """
    image = as_image(image)
    values = np.array(image.values, order="C")  # a copy: the caller's array stays as it is
    settings: dict[str, Any] = {
        "phase": phase,
        "reach": reach,
        "brush": brush,
        "min_size": min_size,
        "connectivity": connectivity,
    }
    report = connect_in_place(values.reshape((1,) * (3 - values.ndim) + values.shape), image, **settings)
    recipe = image.recipe.then("finish", values, operation="connect", settings=settings, report=report)
    return with_values(image, values, recipe=recipe)


def connect_in_place(
    values: np.ndarray,
    image: Image,
    *,
    phase: str | int | None,
    reach: int,
    brush: int,
    min_size: int,
    connectivity: int | None,
) -> dict[str, int]:
    """As `connect`, of labels (Z, Y, X) that are written into; `image` tells what they mean. The report."""
    background, member = background_of(image, phase), members(image, phase)
    _check_settings(reach, brush, min_size)
    neighbours = as_connectivity(connectivity, image.ndim)
    joins = added = 0
    while True:
        runs = runs_of(values, member, neighbours)
        if not len(runs.sizes):
            raise InputError(
                f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing to connect"
            )
        body = int(np.argmax(runs.sizes)) + 1
        done, filled = _join_parts(values, runs, body, background, (reach, brush, min_size))
        if not done:
            break
        joins, added = joins + done, added + filled
        del runs  # before the next
    loose = np.arange(1, len(runs.sizes) + 1) != body
    runs.write(values, loose, background)
    removed = int(runs.sizes.sum() - runs.sizes[body - 1])
    return {"joins": joins, "added": added, "removed_parts": len(runs.sizes) - 1, "removed": removed}


def _check_settings(reach: int, brush: int, min_size: int) -> None:
    for name, value, least in (("reach", reach, 0), ("brush", brush, 1), ("min_size", min_size, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise InputError(f"{name} {value!r} must be a whole number of voxels, at least {least}")


def background_of(image: Image, phase: str | int | None) -> int:
    """Return the label of what joins run through, and of what is left where a part is removed.

    Raises
    ------
    UnnamedVoidError
        No phase is named void; of two phases the other one is meant where `phase` is given.
    """
    check_labels(image)
    if "void" not in image.phases:
        if phase is None or len(image.phases) > 2:
            raise UnnamedVoidError(image.phases, phase_helps=len(image.phases) == 2)
        return 1 - phase_index(image, phase, default="solid")
    void = phase_index(image, None, default="void")
    if phase is None or phase_index(image, phase, default="solid") != void:
        return void
    if len(image.phases) > 2:
        raise InputError(
            f"the void of an image of {len(image.phases)} phases cannot be connected: it is open which phase fills a "
            "removed pore; merge the others first"
        )
    return 1 - void


def _join_parts(
    values: np.ndarray, runs: Runs, body: int, background: int, settings: tuple[int, int, int]
) -> tuple[int, int]:
    """Join every part within reach of the body, writing into `values`; joins, and voxels filled."""
    reach, brush, min_size = settings
    chosen = runs.sizes >= min_size
    chosen[body - 1] = False
    if not chosen.any() or reach == 0:
        return 0, 0
    worth = np.concatenate([[False], chosen])
    joins = filled = 0
    for number, (part, bounds) in enumerate(zip(np.flatnonzero(chosen) + 1, runs.boxes(chosen).tolist(), strict=True)):
        path = shortest_join(values, runs, bounds, part, body, background, worth, reach)
        if len(path):
            joins += 1
            filled += _fill(values, path, background, brush)
        if number % _SOME == 0:
            scratch.let_go()
    return joins, filled


@kernel
def _fill(values, path, background, brush):
    """Paint the path with a cube of side `brush` in the label of its first voxel; only background is painted over."""
    label = values[path[0, 0], path[0, 1], path[0, 2]]
    before = (brush - 1) // 2
    filled = 0
    for n in range(1, len(path)):
        first = path[n] - before
        for z in range(max(first[0], 0), min(first[0] + brush, values.shape[0])):
            for y in range(max(first[1], 0), min(first[1] + brush, values.shape[1])):
                for x in range(max(first[2], 0), min(first[2] + brush, values.shape[2])):
                    if values[z, y, x] == background:
                        values[z, y, x] = label
                        filled += 1
    return filled

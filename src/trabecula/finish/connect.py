"""Connect: one piece out of many, by the shortest joins.

1. Number the components; the largest is the body.
2. From every other component that is worth it, grow outwards through the background, face by face, until the body is
   met or `reach` voxels are passed; the way back is filled with a brush.
3. Again from 1, since a part that is joined may bring others within reach; until nothing is joined any more.
4. What is still loose becomes background.

A part is searched from in its own box, so the cost is that of the loose parts and not of the image. Components are kept as
runs along x: besides the image and the result no array of the image's size is needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, phase_index, with_values
from trabecula.engine.compile import kernel
from trabecula.engine.cuts import slices_of
from trabecula.measure.phases import as_connectivity, members
from trabecula.measure.runs import Runs, runs_of

_BODY, _LOOSE, _OPEN, _CLOSED = 1, 2, 3, 4


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
    member = members(image, phase)
    _check_settings(reach, brush, min_size)
    neighbours, background = as_connectivity(connectivity, image.ndim), _background(image, phase)
    values = np.array(image.values, order="C")  # a copy: the caller's array stays as it is
    lifted = values.reshape((1,) * (3 - values.ndim) + values.shape)
    joins = added = 0
    while True:
        runs = runs_of(lifted, member, neighbours)
        if not len(runs.sizes):
            raise InputError(
                f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing to connect"
            )
        body = int(np.argmax(runs.sizes)) + 1
        done, filled = _join_parts(lifted, runs, body, background, (reach, brush, min_size))
        if not done:
            break
        joins, added = joins + done, added + filled
    loose = np.arange(1, len(runs.sizes) + 1) != body
    runs.write(values, loose, background)
    report = {"joins": joins, "added": added, "removed_parts": len(runs.sizes) - 1}
    report["removed"] = int(runs.sizes[loose].sum())
    settings = {"phase": phase, "reach": reach, "brush": brush, "min_size": min_size, "connectivity": connectivity}
    recipe = image.recipe.then("finish", values, operation="connect", settings=settings, report=report)
    return with_values(image, values, recipe=recipe)


def _check_settings(reach: int, brush: int, min_size: int) -> None:
    for name, value, least in (("reach", reach, 0), ("brush", brush, 1), ("min_size", min_size, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise InputError(f"{name} {value!r} must be a whole number of voxels, at least {least}")


def _background(image: Image, phase: str | int | None) -> int:
    """The label of what joins run through, and of what is left where a part is removed."""
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
    parts = [part for part in np.flatnonzero(runs.sizes >= min_size) + 1 if part != body]
    if not parts or reach == 0:
        return 0, 0
    worth = np.zeros(len(runs.sizes) + 1, np.bool_)
    worth[parts] = True
    boxes = runs.boxes()
    joins = filled = 0
    for part in parts:
        low = np.maximum(boxes[part, :3] - reach - 1, 0)
        high = np.minimum(boxes[part, 3:] + reach + 1, values.shape)
        box = tuple(zip(low.tolist(), high.tolist(), strict=True))
        state = _states(runs.labels(box), values[slices_of(box)], part, body, background, worth)
        path = _shortest_path(state, reach)
        if len(path):
            joins += 1
            filled += _fill(values, path + low, background, brush)
    return joins, filled


def _states(
    labels: np.ndarray, values: np.ndarray, part: int, body: int, background: int, worth: np.ndarray
) -> np.ndarray:
    """What a voxel is to the search. Specks are open, as they will be removed; other parts and phases are closed."""
    state = np.where(worth[labels] | (values != background), np.uint8(_CLOSED), np.uint8(_OPEN))
    state[(labels > 0) & ~worth[labels]] = _OPEN
    state[labels == part] = _LOOSE
    state[labels == body] = _BODY
    return state


@kernel
def _shortest_path(state, reach):
    """Open voxels (n, 3) that lead from the loose part to the body, breadth first; before them the voxel they start
    from.

    Empty where more than `reach` would be needed.
    """
    depth, height, width = state.shape
    step = np.array([height * width, -height * width, width, -width, 1, -1])
    flat = state.copy().ravel()
    queue = np.empty(len(flat), np.int64)
    origin = np.empty(len(flat), np.int64)  # place in the queue from which a voxel was reached
    count = 0
    for at in range(len(flat)):
        if flat[at] == _LOOSE:
            queue[count] = at
            origin[count] = -1
            count += 1
    head, end, length = 0, count, 0
    while head < count:
        if head == end:
            length, end = length + 1, count
            if length > reach:
                break
        at = queue[head]
        z, y, x = at // (height * width), at // width % height, at % width
        there = (z + 1 < depth, z > 0, y + 1 < height, y > 0, x + 1 < width, x > 0)
        for side in range(6):
            if not there[side]:
                continue
            other = at + step[side]
            if flat[other] == _BODY and length > 0:
                path = np.empty((length + 1, 3), np.int64)
                k = head
                for row in range(length, -1, -1):
                    path[row] = queue[k] // (height * width), queue[k] // width % height, queue[k] % width
                    k = origin[k]
                return path
            if flat[other] == _OPEN:
                flat[other] = _CLOSED
                queue[count] = other
                origin[count] = head
                count += 1
        head += 1
    return np.empty((0, 3), np.int64)


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

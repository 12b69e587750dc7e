"""Connectivity and feature size by construction (section 4.3), followed while the output grows.

A *component* is a connected set of voxels of one class (the solid, or the void). It may still grow
as long as it has *ends*: faces towards voxels that are not made yet. A patch is accepted if

1. voxels connected outside its box before still are (seen in a window with a margin around the
   box), and
2. no component is closed, that is without an end, while there is another of its class.

So there is one component of a class in the end, beside islands of a few voxels, which may be closed
and are painted over at the end. Void that reaches a face of the volume or of the form is open: all
of it is component 0, which never closes. The components of given voxels are found some planes at a
time, so that no whole volume of labels is held.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.labelling import joined_across, pairs_across
from trabecula.measure.near_joins import join_near, search_bytes
from trabecula.measure.runs import Runs, merge_labels, run_bytes, runs_of
from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT
from trabecula.synth.quilt.connectivity_kernels import (
    ENDS,
    LINK,
    SHUT_NOW,
    WHOLE,
    ComponentTable,
    WindowComponents,
    enter_window,
    initial_ends,
    judge_window,
    label_leaders,
    label_window,
    largest_component,
    mark_islands,
    renumber,
)

FINE, TORN, CLOSED = 0, 1, 2
"""Verdicts on a patch."""

SOLID, VOID = 1, 2

_ALWAYS = 1 << 40  # ends of the open void

_MORE = 4096  # rows by which the table grows


def voxel_classes(connected: str, void: int, labels: int) -> np.ndarray:
    """Return the class of every value of a voxel, (256,) uint8; 0 where connectivity does not
    matter.
    """
    table = np.zeros(256, np.uint8)
    for label in range(labels):
        kind = VOID if label == void else SOLID
        if connected == "both" or connected == ("void" if kind == VOID else "solid"):
            table[label] = table[label + FIXED] = kind
    if connected in ("void", "both"):
        table[OUT] = VOID
    return table


class ComponentTracker:
    """The components of an output: the number of every voxel's, and a table of which numbers are
    one component, with their ends.

    Parameters
    ----------
    canvas : (Z, Y, X) uint8
        Given voxels, and voxels to make.
    numbers : (Z, Y, X) int32
        Zeros.
    wraps : three bool
    classes : (256,) uint8
        As from `voxel_classes`.

    Attributes
    ----------
    numbers : (Z, Y, X) int32
        A voxel's component; the root of its number in the table counts.
    alive : (2, 3) int64
        Components of every class that have ends, component 0 among them where void is followed;
        and those that were closed as the only one, after which none may begin.
    """

    def __init__(
        self,
        canvas: np.ndarray,
        numbers: np.ndarray,
        wraps: tuple[bool, ...],
        classes: np.ndarray,
    ) -> None:
        self.classes, self.numbers = classes, numbers
        self.parent = memmap.zeros(_MORE, np.int32)
        self.ends = memmap.zeros(_MORE, np.int64)
        self.sizes = memmap.zeros(_MORE, np.int64)
        self.mark = memmap.zeros(_MORE, np.int32)
        self.ends[0] = _ALWAYS
        self.count = 1
        self.alive = np.zeros((2, 3), np.int64)
        self.alive[0, VOID] = int(classes[OUT] == VOID)
        if any(canvas[first:last].min() < OUT for first, last in slabs(canvas.shape)):
            self._label_initial(canvas, wraps)

    def _label_initial(self, canvas: np.ndarray, wraps: tuple[bool, ...]) -> None:
        """Label the components of given voxels; those without an end are ignored."""
        for kind in (SOLID, VOID):
            member = self.classes == kind
            part, sizes = label_slabwise(canvas, member, wraps, into=self.numbers)
            self.reserve(len(sizes))
            used = slice(self.count, self.count + len(sizes))
            ends, out = np.zeros(len(sizes), np.int64), np.zeros(len(sizes), np.bool_)
            for first, last in slabs(canvas.shape):
                initial_ends(canvas, member, self.numbers, part, wraps, first, last, ends, out)
            numbers = np.arange(used.start, used.stop, dtype=np.int32)
            if kind == VOID:
                numbers[out] = 0
            self.parent[used], self.sizes[used], self.ends[used] = numbers, sizes, ends
            self.alive[0, kind] += np.count_nonzero((ends > 0) & (numbers > 0))
            component = np.concatenate([np.zeros(1, np.int32), numbers])[part]
            for first, last in slabs(canvas.shape):
                renumber(canvas[first:last], member, component, self.numbers[first:last])
            self.count += len(sizes)

    @property
    def table(self) -> ComponentTable:
        """Return the arrays that the kernels take."""
        return ComponentTable(self.parent, self.ends, self.sizes, self.mark, self.alive)

    def snapshot(self, numbers: np.ndarray) -> tuple[np.ndarray, ...]:
        """Copy the table's rows of these components, and their number."""
        kept = numbers.copy()
        return (
            kept,
            self.parent[kept],
            self.ends[kept],
            self.sizes[kept],
            self.alive.copy(),
            np.array(self.count),
        )

    def restore(self, snapshot: tuple[np.ndarray, ...]) -> None:
        """Restore a snapshot."""
        numbers, parents, ends, sizes, alive, count = snapshot
        self.parent[numbers], self.ends[numbers], self.sizes[numbers] = parents, ends, sizes
        self.alive[:], self.count = alive, int(count)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a checkpoint."""
        used = slice(self.count)
        return {
            "of": self.numbers,
            "parent": self.parent[used],
            "ends": self.ends[used],
            "sizes": self.sizes[used],
            "alive": self.alive,
        }

    def load_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the arrays of a checkpoint."""
        self.numbers, self.alive[:], self.count = arrays["of"], arrays["alive"], 0
        self.reserve(len(arrays["parent"]))
        self.count = len(arrays["parent"])
        for name in ("parent", "ends", "sizes"):
            _copy(arrays[name], getattr(self, name))

    def islands(self, most: int) -> np.ndarray:
        """Mark the components of at most `most` voxels, (count,) bool, except the largest and the
        open void.
        """
        found, parent = memmap.zeros(self.count, np.bool_), self.parent[: self.count]
        kept = 0
        # All void is open in the end; of solid the largest is the one that the others should have
        # joined.
        if (self.classes == SOLID).any():
            for first, last in slabs(parent.shape):
                kept = int(largest_component(parent, self.sizes, first, last, kept))
        for first, last in slabs(parent.shape):
            mark_islands(parent, self.sizes, most, kept, first, last, found)
        return found

    def reserve(self, more: int) -> None:
        """Enlarge the table for so many more components."""
        while self.count + more > len(self.parent):
            for name in ("parent", "ends", "sizes", "mark"):  # marks are 0 between verdicts
                before = getattr(self, name)
                longer = memmap.zeros(2 * len(before), before.dtype)
                _copy(before, longer)
                setattr(self, name, longer)


def _copy(table: np.ndarray, into: np.ndarray) -> None:
    """Copy a table to the beginning of a longer one."""

    def copy(first: int, last: int) -> None:
        into[first:last] = table[first:last]

    for_slabs(copy, len(table))


class ConnectivityCheck:
    """Check of one window after another, with arrays that all windows of a run share."""

    def __init__(self, window: tuple[int, ...], margin: tuple[int, ...], *, island: int) -> None:
        self.margin, self.island = margin, island
        count = int(np.prod(window))
        self.local = WindowComponents(
            before=np.empty(window, np.int32),
            after=np.empty(window, np.int32),
            parts=np.empty((8, count + 1), np.int64),
            seen=np.empty(count + 1, np.int64),
            stack=np.empty(count, np.int32),
            tally=np.zeros((4, 3), np.int64),
        )
        self.count = 0
        self.old_seen: np.ndarray | None = None
        self.new_seen: np.ndarray | None = None

    @property
    def growth(self) -> int:
        """Return how many components the last window adds to those that may still grow; one that it
        ends counts as two.
        """
        tally = self.local.tally
        return int((tally[1] - tally[0] + 2 * tally[2]).sum())

    def verdict(
        self, components: ComponentTracker, old: np.ndarray, new: np.ndarray, numbers: np.ndarray
    ) -> int:
        """Decide if `new` may replace the window `old`, whose components are `numbers` (uint8, and
        int32, of one shape).
        """
        local = self.local
        if old is not self.old_seen:
            label_window(old, components.classes, local.before, local.stack)
            self.old_seen = old
        self.count = count = int(label_window(new, components.classes, local.after, local.stack))
        local.parts[:, : count + 1] = 0
        self.new_seen = new
        return int(
            judge_window(
                old,
                new,
                numbers,
                self.margin,
                components.classes,
                components.table,
                local,
                count,
                self.island,
            )
        )

    def enter(
        self, components: ComponentTracker, old: np.ndarray, new: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Write a window into the table whatever the verdict, and its components into `numbers`;
        return what `ComponentTracker.restore` takes.
        """
        if new is not self.new_seen or old is not self.old_seen:
            self.verdict(components, old, new, numbers)
        components.reserve(self.count)
        seen = self.local.seen
        before = components.snapshot(seen[1 : 1 + seen[0]])
        components.count = int(
            enter_window(
                new,
                numbers,
                self.margin,
                components.classes,
                components.table,
                self.local,
                components.count,
            )
        )
        return before

    def closing_components(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the components that the last window would close.

        These are the leader of every voxel's part (int32), the leaders that would be closed, the
        smallest component first, and by number (bool) the leaders that are more than islands.
        """
        parts = self.local.parts[:, : self.count + 1]
        leaders = np.empty(self.local.after.shape, np.int32)
        label_leaders(self.local.after, self.local.parts, leaders)
        first = np.flatnonzero((parts[SHUT_NOW] > 0) & (parts[LINK] == 0))
        kept = (parts[ENDS] > 0) | (parts[WHOLE] > self.island)
        return leaders, first[np.argsort(parts[WHOLE, first], kind="stable")], kept


LABELLED_AT_ONCE = 1 << 21
"""Voxels of a slab at most: its runs and labels take some bytes each, whether scratch files are in
use or not.
"""

_FACES = 6  # neighbours of a voxel


def slabs(shape: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield the first plane and the plane after the last of slabs, to be worked on one after the
    other.
    """
    plane = int(np.prod(shape[1:], dtype=np.int64))
    thick = max(1, min(memmap.slab_thickness(shape[0], 1), LABELLED_AT_ONCE // max(1, plane)))
    for first in range(0, shape[0], thick):
        yield first, min(first + thick, shape[0])
        memmap.release_pages()


def label_slabwise(
    values: np.ndarray, member: np.ndarray, wraps: Sequence[bool], *, into: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Label the connected components of the voxels whose value is a member.

    Parameters
    ----------
    values : (Z, Y, X) uint8
    member : (256,) bool
    wraps : three bool
        Axes at whose ends voxels are neighbours.
    into : (Z, Y, X) int32, optional
        Gets a number, from 1 on, for every voxel of a member; others are left as they are.

    Returns
    -------
    part : (m + 1,) int64
        The part, 1 .. n in the order of first voxels, that a number of `into` stands for; several
        may stand for one.
    sizes : (n,) int64
        Voxels of every part.
    """
    sizes, pairs, count = [], [np.empty((0, 2), np.int64)], 0
    first = last = np.zeros(values.shape[1:], np.int64)
    for a, b in slabs(values.shape):
        runs = runs_of(np.ascontiguousarray(values[a:b]), member, _FACES)
        top, bottom = _end_layer(runs, 0, 0, count), _end_layer(runs, 0, -1, count)
        pairs.append(_touching_pairs(last, top))  # before the first slab there is nothing
        pairs += [
            _touching_pairs(_end_layer(runs, n, -1, count), _end_layer(runs, n, 0, count))
            for n in (1, 2)
            if wraps[n]
        ]
        first, last = top if a == 0 else first, bottom
        if into is not None:
            labels = runs.labels()
            np.add(labels, np.int32(count), out=into[a:b], where=labels > 0)
        sizes.append(runs.sizes)
        count += len(runs.sizes)
    if wraps[0]:
        pairs.append(_touching_pairs(last, first))
    part, merged = merge_labels(np.concatenate(sizes), np.concatenate(pairs))
    return np.concatenate([[0], part]), merged


def _end_layer(runs: Runs, axis: int, end: int, before: int) -> np.ndarray:
    """Return the numbers at one end of a slab, int64; `before` of them belong to slabs before."""
    box = [(0, side) for side in runs.shape]
    box[axis] = (runs.shape[axis] - 1, runs.shape[axis]) if end else (0, 1)
    labels = runs.labels(tuple(box)).take(0, axis).astype(np.int64)
    return np.where(labels > 0, labels + before, 0)


def _touching_pairs(far: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return (n, 2) numbers that are neighbours from a layer to the one behind it."""
    return pairs_across(far, near, _FACES, (False, False))


def thin_voxels(window: np.ndarray, margin: tuple[int, ...], size: int, solid: np.ndarray) -> int:
    """Count the voxels of a window's box in no `size`-cube of solid; voxels not made yet, or
    outside, may be solid.

    Parameters
    ----------
    window : (z, y, x) uint8
    margin : three ints
    size : int
        Voxels; along an axis of one voxel it is 1.
    solid : (256,) bool
        Which values are solid.
    """
    may_be = solid[window] | (window == EMPTY) | (window == OUT)
    sides = tuple(1 if side == 1 else size for side in window.shape)
    covered = np.zeros(window.shape, np.bool_)
    _cover_cubes(may_be, sides, covered)
    thin = solid[window] & ~covered
    return int(
        np.count_nonzero(
            thin[tuple(slice(m, s - m) for m, s in zip(margin, window.shape, strict=True))]
        )
    )


@kernel
def _cover_cubes(may_be, sides, covered):
    """Mark every voxel of every full cube; a cube may reach beyond the window."""
    depth, height, width = may_be.shape
    for z in range(1 - sides[0], depth):
        for y in range(1 - sides[1], height):
            for x in range(1 - sides[2], width):
                full = True
                for k in range(max(z, 0), min(z + sides[0], depth)):
                    for j in range(max(y, 0), min(y + sides[1], height)):
                        for i in range(max(x, 0), min(x + sides[2], width)):
                            if not may_be[k, j, i]:
                                full = False
                                break
                        if not full:
                            break
                    if not full:
                        break
                if not full:
                    continue
                for k in range(max(z, 0), min(z + sides[0], depth)):
                    for j in range(max(y, 0), min(y + sides[1], height)):
                        for i in range(max(x, 0), min(x + sides[2], width)):
                            covered[k, j, i] = True


def join_rest(
    canvas: np.ndarray,
    classes: np.ndarray,
    wraps: Sequence[bool],
    *,
    void: int,
    patch: int,
    brush: int,
    least: int,
) -> dict[str, int]:
    """Join the components of the solid that are left in the end, in place; return a report.

    Joins are the shortest ways through void that was made, at most as long as a patch;
    across periodic faces none runs.

    Parameters
    ----------
    canvas : (Z, Y, X) uint8
    classes : (256,) uint8
        As from `voxel_classes`.
    wraps : three bool
    void : int
        Label.
    patch : int
        Side of a patch, voxels.
    brush : int
        Thickness of a join, voxels.
    least : int
        Voxels of a component that is joined.

    Returns
    -------
    dict
        `joins`, their voxels as `join_voxels`, and `loose`, the voxels of components of that size
        that no join reached.
    """

    def components() -> Runs:
        return joined_across(runs_of(canvas, classes == SOLID, _FACES), _FACES, tuple(wraps))

    found, runs = join_near(
        canvas,
        components(),
        components,
        void,
        reach=patch,
        brush=brush,
        least=least,
        side=patch,
    )
    others = np.sort(runs.sizes)[:-1]
    return {
        "joins": found["joins"],
        "join_voxels": found["added"],
        "loose": int(others[others >= least].sum()),
    }


def join_bytes(shape: Sequence[int], patch: int, *, mapped: bool) -> int:
    """Return the memory of `join_rest`, at most, beside the canvas; runs may be memory-mapped."""
    return search_bytes(shape, patch, patch) + (0 if mapped else run_bytes(shape))

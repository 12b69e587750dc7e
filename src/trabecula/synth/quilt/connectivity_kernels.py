"""Kernels of connectivity: the components of a window, and the effect of a patch on the components
of the output that they belong to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT


@inline
def _in_box(z, y, x, shape, margin):
    """Return whether a voxel of a window is in its box."""
    return (
        margin[0] <= z < shape[0] - margin[0]
        and margin[1] <= y < shape[1] - margin[1]
        and margin[2] <= x < shape[2] - margin[2]
    )


@inline
def _ends_at(window, z, y, x):
    """Count the faces of a voxel towards voxels that are not made."""
    depth, height, width = window.shape
    count = 0
    if z > 0 and window[z - 1, y, x] == EMPTY:
        count += 1
    if z < depth - 1 and window[z + 1, y, x] == EMPTY:
        count += 1
    if y > 0 and window[z, y - 1, x] == EMPTY:
        count += 1
    if y < height - 1 and window[z, y + 1, x] == EMPTY:
        count += 1
    if x > 0 and window[z, y, x - 1] == EMPTY:
        count += 1
    if x < width - 1 and window[z, y, x + 1] == EMPTY:
        count += 1
    return count


class ComponentTable(NamedTuple):
    """Facts of every component, by its number; arrays as in `ComponentTracker`."""

    parent: np.ndarray
    ends: np.ndarray
    sizes: np.ndarray
    mark: np.ndarray
    alive: np.ndarray


class WindowComponents(NamedTuple):
    """Components in one window.

    before, after : (z, y, x) int32
        Parts of the old and of the new window, from 1.
    parts : (8, .) int64
        Rows below; columns are the parts of the new window. Parts of one component follow one
        leader, which holds the sums.
    seen : (.,) int64
        Number of components in the window, then their numbers.
    stack : (.,) int32
        Scratch array.
    tally : (4, 3) int64
        Per class the components that were alive here, those that will be, those that would be
        closed, and those that were.
    """

    before: np.ndarray
    after: np.ndarray
    parts: np.ndarray
    seen: np.ndarray
    stack: np.ndarray
    tally: np.ndarray


# Rows of `parts`. COMPONENT is the component's number + 1, 0 for a new one; SHUT_BEFORE counts
# voxels of components that had no end already.
LINK, COMPONENT, ENDS, SIZE, KIND, SHUT_BEFORE, WHOLE, SHUT_NOW = 0, 1, 2, 3, 4, 5, 6, 7

_ALIVE, _COMING, _SHUT, _WAS_SHUT = 0, 1, 2, 3

# Instead of ends: no longer growing, and the only component of its class. 0: an island, or given,
# or given up.
_CLOSED = -1

_GONE = -1  # instead of a part: the component was in the box alone, and none of it is left


@inline
def _leader(parts, k):
    """Return the leader of a part."""
    while parts[LINK, k] > 0:
        k = parts[LINK, k]
    return k


@inline
def _join(parts, a, b):
    """Let two parts follow one leader."""
    a, b = _leader(parts, a), _leader(parts, b)
    if a != b:
        parts[LINK, max(a, b)] = min(a, b)


@kernel
def judge_window(old, new, numbers, margin, classes, table, local, count, island):
    """Return 0 if `new` may replace `old`, 1 where it tears connected voxels apart, 2 where it
    closes a component beside others.

    `numbers`: components of the old window; `count`: parts of the new one; `island`: voxels that
    may be closed. `table.mark` is 0 before and after.
    """
    local.tally[:] = 0
    known, torn = _match_components(old, new, numbers, margin, classes, table, local)
    known = _weigh_components(old, new, numbers, margin, classes, table, local, known)
    local.seen[0] = known
    _carry_over(table, local)
    _count_leaders(local, count, island)
    for n in range(1, known + 1):
        table.mark[local.seen[n]] = 0
    if torn:
        return 1
    return 2 if _closes_beside_others(table.alive, local.tally) else 0


@inline
def _match_components(old, new, numbers, margin, classes, table, local):
    """Match the components with the new parts that continue them; return their number, and if one
    is torn.
    """
    shape, parts, sent = new.shape, local.parts, local.stack
    torn, known = False, 0
    sent[: old.size] = 0
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                mine, was = local.after[z, y, x], local.before[z, y, x]
                inside = _in_box(z, y, x, shape, margin)
                if mine > 0:
                    parts[SIZE, mine] += inside
                    parts[KIND, mine] = classes[new[z, y, x]]
                if was == 0 or (inside and old[z, y, x] < FIXED):
                    continue
                # Nothing changes here: parts connected in the old window have to be in the new.
                if sent[was - 1] == 0:
                    sent[was - 1] = mine
                elif sent[was - 1] != mine:
                    torn = True
                component = root_of(table.parent, numbers[z, y, x])
                if table.mark[component] == 0:
                    table.mark[component] = mine
                    known += 1
                    local.seen[known] = component
                elif table.mark[component] != mine:
                    _join(parts, table.mark[component], mine)
    return known, torn


@inline
def _weigh_components(old, new, numbers, margin, classes, table, local, known):
    """Count the voxels and ends that every leader gains or loses in the window; return the number
    of components, with those that disappear.
    """
    shape, parts = new.shape, local.parts
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                inside = _in_box(z, y, x, shape, margin)
                if local.after[z, y, x] > 0:
                    k = _leader(parts, local.after[z, y, x])
                    parts[ENDS, k] += _ends_at(new, z, y, x)
                    parts[WHOLE, k] += inside
                if local.before[z, y, x] == 0:
                    continue
                component = root_of(table.parent, numbers[z, y, x])
                if table.mark[component] == 0:
                    table.mark[component] = _GONE
                    known += 1
                    local.seen[known] = component
                    local.tally[_ALIVE, classes[old[z, y, x]]] += table.ends[component] > 0
                    local.tally[_WAS_SHUT, classes[old[z, y, x]]] += (
                        table.ends[component] == _CLOSED
                    )
                elif table.mark[component] > 0:
                    k = _leader(parts, table.mark[component])
                    parts[ENDS, k] -= _ends_at(old, z, y, x)
                    parts[WHOLE, k] -= inside
    return known


@inline
def _carry_over(table, local):
    """Add to the leaders the ends and voxels of the components that they continue."""
    parts, tally = local.parts, local.tally
    for n in range(1, local.seen[0] + 1):
        component = local.seen[n]
        if table.mark[component] == _GONE:
            continue
        k = _leader(parts, table.mark[component])
        parts[ENDS, k] += max(table.ends[component], 0)
        parts[WHOLE, k] += table.sizes[component]
        tally[_ALIVE, parts[KIND, k]] += table.ends[component] > 0
        tally[_WAS_SHUT, parts[KIND, k]] += table.ends[component] == _CLOSED
        if table.ends[component] == 0:  # it was closed before, not by this patch
            parts[SHUT_BEFORE, k] += table.sizes[component]
        if parts[COMPONENT, k] == 0 or component + 1 < parts[COMPONENT, k]:
            parts[COMPONENT, k] = component + 1


@inline
def _count_leaders(local, count, island):
    """Count the leaders that may go on growing, and those that would be closed."""
    parts = local.parts
    for k in range(1, count + 1):
        if parts[LINK, k] > 0:
            continue
        if parts[ENDS, k] > 0:
            local.tally[_COMING, parts[KIND, k]] += 1
        elif parts[WHOLE, k] > max(island, parts[SHUT_BEFORE, k]):
            local.tally[_SHUT, parts[KIND, k]] += 1
            parts[SHUT_NOW, k] = 1


@inline
def _closes_beside_others(alive, tally):
    """Return whether a component is closed while there is another of its class."""
    for kind in range(1, 3):
        shut = alive[1, kind] - tally[_WAS_SHUT, kind] + tally[_SHUT, kind]
        if shut > 0 and alive[0, kind] - tally[_ALIVE, kind] + tally[_COMING, kind] + shut > 1:
            return True
    return False


@kernel
def label_leaders(after, parts, found):
    """Write the leader of every voxel's part."""
    for z in range(after.shape[0]):
        for y in range(after.shape[1]):
            for x in range(after.shape[2]):
                k = after[z, y, x]
                found[z, y, x] = _leader(parts, k) if k > 0 else 0


@kernel
def enter_window(new, numbers, margin, classes, table, local, count):
    """Enter the parts as components; `count` numbers are in use before; return the numbers in use
    after.
    """
    shape, parts, tally = new.shape, local.parts, local.tally
    for n in range(1, local.seen[0] + 1):
        if local.seen[n] > 0:
            table.ends[local.seen[n]] = 0  # those that continue get their ends below
            table.sizes[local.seen[n]] = 0
    given_up = np.zeros(3, np.bool_)
    for kind in range(1, 3):
        table.alive[0, kind] += tally[_COMING, kind] - tally[_ALIVE, kind]
        table.alive[1, kind] -= tally[_WAS_SHUT, kind]
        given_up[kind] = table.alive[0, kind] + table.alive[1, kind] + tally[_SHUT, kind] > 1
        if not given_up[kind]:
            table.alive[1, kind] += tally[_SHUT, kind]
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                if local.after[z, y, x] == 0:
                    continue
                k = _leader(parts, local.after[z, y, x])
                if parts[COMPONENT, k] == 0:
                    table.parent[count] = count
                    count += 1
                    parts[COMPONENT, k] = count
                component = parts[COMPONENT, k] - 1
                if component > 0:
                    table.ends[component] = max(parts[ENDS, k], 0)
                    if parts[SHUT_NOW, k] > 0 and not given_up[parts[KIND, k]]:
                        table.ends[component] = _CLOSED
                    table.sizes[component] = parts[WHOLE, k]
                if _in_box(z, y, x, shape, margin):
                    numbers[z, y, x] = component
                else:
                    root = root_of(table.parent, numbers[z, y, x])
                    if root != component:
                        table.parent[root] = component
    return count


@inline
def root_of(parent, component):
    """Return the number that stands for all of a component."""
    while parent[component] != component:
        component = parent[component]
    return component


@kernel
def largest_component(parent, sizes, first, last, found):
    """Return the largest of the components first .. last - 1 and of `found`; of equals the
    first.
    """
    for component in range(first, last):
        if parent[component] == component and sizes[component] > sizes[found]:
            found = component
    return found


@kernel
def mark_islands(parent, sizes, most, kept, first, last, found):
    """Mark the components first .. last - 1 of up to `most` voxels, except `kept` and 0."""
    for component in range(first, last):
        root = root_of(parent, component)
        found[component] = root > 0 and root != kept and sizes[root] <= most


@kernel
def initial_ends(canvas, member, numbers, part, wraps, first, last, ends, out):
    """Count, in the layers first .. last - 1, faces of every part towards voxels to make, and mark
    the parts that touch a face of the volume or `OUT`. `part`: the part of a number, from 1.
    """
    shape = canvas.shape
    for z in range(first, last):
        for y in range(shape[1]):
            for x in range(shape[2]):
                if not member[canvas[z, y, x]]:
                    continue
                k = part[numbers[z, y, x]] - 1
                for axis in range(3):
                    for sign in (-1, 1):
                        at = [z, y, x]
                        at[axis] += sign
                        if wraps[axis]:
                            at[axis] %= shape[axis]
                        if 0 <= at[axis] < shape[axis]:
                            beside = canvas[at[0], at[1], at[2]]
                            ends[k] += beside == EMPTY
                            out[k] |= beside == OUT
                        else:
                            out[k] |= shape[axis] > 1


@kernel
def renumber(canvas, member, component, numbers):
    """Replace numbers by the components that they stand for."""
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                if member[canvas[z, y, x]]:
                    numbers[z, y, x] = component[numbers[z, y, x]]


@inline
def _unite(parent, a, b):
    """Unite two numbers of one part; return their root, the smaller of both roots; 0 is none."""
    if a == 0 or b == 0:
        return a + b
    while parent[a - 1] != a:
        a = parent[a - 1]
    while parent[b - 1] != b:
        b = parent[b - 1]
    parent[max(a, b) - 1] = min(a, b)
    return min(a, b)


@kernel
def label_window(window, classes, labels, parent):
    """Assign numbers to the connected parts of every class, from 1 in raster order; return their
    number.
    """
    depth, height, width = window.shape
    count = 0
    for z in range(depth):
        for y in range(height):
            left, left_kind = 0, 0
            for x in range(width):
                kind = classes[window[z, y, x]]
                mine = 0
                if kind > 0:
                    mine = left if left_kind == kind else 0
                    if (
                        y > 0
                        and labels[z, y - 1, x] != mine
                        and classes[window[z, y - 1, x]] == kind
                    ):
                        mine = _unite(parent, mine, labels[z, y - 1, x])
                    if (
                        z > 0
                        and labels[z - 1, y, x] != mine
                        and classes[window[z - 1, y, x]] == kind
                    ):
                        mine = _unite(parent, mine, labels[z - 1, y, x])
                    if mine == 0:
                        count += 1
                        mine = count
                        parent[count - 1] = count
                labels[z, y, x] = mine
                left, left_kind = mine, kind
    last = 0
    for k in range(count):
        if parent[k] == k + 1:
            last += 1
            parent[k] = -last
        else:
            # a root comes before all that follow it, and has its number
            parent[k] = parent[parent[k] - 1]
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if labels[z, y, x] > 0:
                    labels[z, y, x] = -parent[labels[z, y, x] - 1]
    return last

"""The kernels of `bodies`: parts of a window, and what a piece would do to the bodies that they belong to."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.marks import EMPTY, FIXED, OUT


@kernel
def islands(parent, sizes, most, but_one, found):
    """Mark bodies of up to `most` voxels, but the largest of all where `but_one`."""
    largest = 0
    for body in range(1, len(parent)):
        if but_one and parent[body] == body and sizes[body] > sizes[largest]:
            largest = body
    for body in range(1, len(parent)):
        root = _root_of(parent, body)
        found[body] = root > 0 and root != largest and sizes[root] <= most


@kernel
def first_ends(canvas, labels, wraps, ends, out):
    """Faces of every body towards voxels to make, and whether it touches a face of the volume or what is outside."""
    shape = canvas.shape
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                k = labels[z, y, x] - 1
                if k < 0:
                    continue
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


@inline
def _root_of(parent, body):
    while parent[body] != body:
        body = parent[body]
    return body


@inline
def _in_box(z, y, x, shape, margin):
    return (
        margin[0] <= z < shape[0] - margin[0]
        and margin[1] <= y < shape[1] - margin[1]
        and margin[2] <= x < shape[2] - margin[2]
    )


@inline
def _ends_at(window, z, y, x):
    """Faces of a voxel towards voxels that are not made."""
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


@kernel
def flooded(window, classes, labels, parent):
    """Number the connected parts of every class, from 1 in raster order; returns how many there are."""
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
                    for up in range(2):
                        if up == 0:
                            near = y > 0 and classes[window[z, y - 1, x]] == kind
                            other = labels[z, y - 1, x] if near else 0
                        else:
                            near = z > 0 and classes[window[z - 1, y, x]] == kind
                            other = labels[z - 1, y, x] if near else 0
                        if other == 0 or other == mine:
                            continue
                        if mine == 0:
                            mine = other
                            continue
                        a, b = mine, other
                        while parent[a - 1] != a:
                            a = parent[a - 1]
                        while parent[b - 1] != b:
                            b = parent[b - 1]
                        parent[max(a, b) - 1] = min(a, b)
                        mine = min(a, b)
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
            parent[k] = parent[parent[k] - 1]  # a root comes before all that follow it, and has its number
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if labels[z, y, x] > 0:
                    labels[z, y, x] = -parent[labels[z, y, x] - 1]
    return last


# Rows of `parts`; its columns are the parts of the new window, from 1.
_LINK, _BODY, _ENDS, _SIZE, _KIND, _SHUT_BEFORE, _WHOLE, _SHUT_NOW = 0, 1, 2, 3, 4, 5, 6, 7
_ALIVE, _COMING, _SHUT, _WAS_SHUT = 0, 1, 2, 3
_CLOSED = -1  # instead of ends: no longer growing, and the one body of its class; 0: an island, or given, or given up


@inline
def _leader(parts, k):
    while parts[_LINK, k] > 0:
        k = parts[_LINK, k]
    return k


@inline
def _joined(parts, a, b):
    a, b = _leader(parts, a), _leader(parts, b)
    if a != b:
        parts[_LINK, max(a, b)] = min(a, b)


@kernel
def judged(
    old,
    new,
    margin,
    classes,
    before,
    after,
    of,
    parent,
    ends,
    sizes,
    mark,
    alive,
    count,
    parts,
    seen,
    sent,
    tally,
    island,
):
    """Parts of one body follow one leader, which holds the body's number (+ 1; 0: a new body) and the ends it would have.

    seen[0]: how many bodies the window has; then their numbers. `mark` is 0 before and after. `tally` holds per class the
    bodies that were alive here, those that will be, those that would be shut, and those that were.
    """
    shape = new.shape
    torn = False
    known = 0
    tally[:] = 0
    sent[: old.size] = 0
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                mine, was = after[z, y, x], before[z, y, x]
                inside = _in_box(z, y, x, shape, margin)
                if mine > 0:
                    parts[_SIZE, mine] += inside
                    parts[_KIND, mine] = classes[new[z, y, x]]
                if was == 0 or (inside and old[z, y, x] < FIXED):
                    continue
                # Nothing changes here: what hung together by the old window has to by the new.
                if sent[was - 1] == 0:
                    sent[was - 1] = mine
                elif sent[was - 1] != mine:
                    torn = True
                body = _root_of(parent, of[z, y, x])
                if mark[body] == 0:
                    mark[body] = mine
                    known += 1
                    seen[known] = body
                elif mark[body] != mine:
                    _joined(parts, mark[body], mine)
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                inside = _in_box(z, y, x, shape, margin)
                if after[z, y, x] > 0:
                    k = _leader(parts, after[z, y, x])
                    parts[_ENDS, k] += _ends_at(new, z, y, x)
                    parts[_WHOLE, k] += inside
                if before[z, y, x] > 0:
                    body = _root_of(parent, of[z, y, x])
                    if mark[body] == 0:  # it was in the box alone, and goes
                        mark[body] = -1
                        known += 1
                        seen[known] = body
                        tally[_ALIVE, classes[old[z, y, x]]] += ends[body] > 0
                        tally[_WAS_SHUT, classes[old[z, y, x]]] += ends[body] == _CLOSED
                    elif mark[body] > 0:
                        k = _leader(parts, mark[body])
                        parts[_ENDS, k] -= _ends_at(old, z, y, x)
                        parts[_WHOLE, k] -= inside
    seen[0] = known
    for n in range(1, known + 1):
        body = seen[n]
        if mark[body] > 0:
            k = _leader(parts, mark[body])
            parts[_ENDS, k] += max(ends[body], 0)
            parts[_WHOLE, k] += sizes[body]
            tally[_ALIVE, parts[_KIND, k]] += ends[body] > 0
            tally[_WAS_SHUT, parts[_KIND, k]] += ends[body] == _CLOSED
            if ends[body] == 0:  # it was shut before, which is nobody's fault now
                parts[_SHUT_BEFORE, k] += sizes[body]
            if parts[_BODY, k] == 0 or body + 1 < parts[_BODY, k]:
                parts[_BODY, k] = body + 1
    for k in range(1, count + 1):
        if parts[_LINK, k] == 0:
            if parts[_ENDS, k] > 0:
                which = _COMING
            elif parts[_WHOLE, k] <= max(island, parts[_SHUT_BEFORE, k]):
                continue
            else:
                which = _SHUT
                parts[_SHUT_NOW, k] = 1
            tally[which, parts[_KIND, k]] += 1
    for n in range(1, known + 1):
        mark[seen[n]] = 0
    if torn:
        return 1
    for kind in range(1, 3):
        shut = alive[1, kind] - tally[_WAS_SHUT, kind] + tally[_SHUT, kind]
        if shut > 0 and alive[0, kind] - tally[_ALIVE, kind] + tally[_COMING, kind] + shut > 1:
            return 2
    return 0


@kernel
def entered(new, margin, classes, after, of, parent, ends, sizes, alive, count, parts, seen, tally):
    """The parts as bodies; returns how many numbers are in use."""
    shape = new.shape
    for n in range(1, seen[0] + 1):
        if seen[n] > 0:
            ends[seen[n]] = 0  # what goes on gets its ends below
            sizes[seen[n]] = 0
    given_up = np.zeros(3, np.bool_)
    for kind in range(1, 3):
        alive[0, kind] += tally[_COMING, kind] - tally[_ALIVE, kind]
        alive[1, kind] -= tally[_WAS_SHUT, kind]
        given_up[kind] = alive[0, kind] + alive[1, kind] + tally[_SHUT, kind] > 1
        if not given_up[kind]:
            alive[1, kind] += tally[_SHUT, kind]
    for z in range(shape[0]):
        for y in range(shape[1]):
            for x in range(shape[2]):
                k = after[z, y, x]
                if k == 0:
                    continue
                k = _leader(parts, k)
                if parts[_BODY, k] == 0:
                    parent[count] = count
                    count += 1
                    parts[_BODY, k] = count
                body = parts[_BODY, k] - 1
                if body > 0:
                    ends[body] = max(parts[_ENDS, k], 0)
                    if parts[_SHUT_NOW, k] > 0 and not given_up[parts[_KIND, k]]:
                        ends[body] = _CLOSED
                    sizes[body] = parts[_WHOLE, k]
                if _in_box(z, y, x, shape, margin):
                    of[z, y, x] = body
                else:
                    root = _root_of(parent, of[z, y, x])
                    if root != body:
                        parent[root] = body
    return count

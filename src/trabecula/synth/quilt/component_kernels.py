"""Kernels of connected parts: those of a window, and the bodies of a whole output that they belong
to.
"""

from __future__ import annotations

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.voxel_codes import EMPTY, OUT


@inline
def root_of(parent, body):
    """The number that stands for all of a body."""
    while parent[body] != body:
        body = parent[body]
    return body


@kernel
def largest(parent, sizes, first, last, found):
    """The largest of the bodies first .. last - 1 and of `found`; of equals the first."""
    for body in range(first, last):
        if parent[body] == body and sizes[body] > sizes[found]:
            found = body
    return found


@kernel
def islands(parent, sizes, most, kept, first, last, found):
    """Mark the bodies first .. last - 1 that are of up to `most` voxels, but `kept`; 0 is none."""
    for body in range(first, last):
        root = root_of(parent, body)
        found[body] = root > 0 and root != kept and sizes[root] <= most


@kernel
def first_ends(canvas, member, numbers, part, wraps, first, last, ends, out):
    """Of the layers first .. last - 1, faces of every part towards voxels to make, and whether it
    touches a face of the volume or what is outside. `part`: what numbers stand for, from 1."""
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
def renumbered(canvas, member, body, numbers):
    """Bodies instead of the numbers that stand for them."""
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                if member[canvas[z, y, x]]:
                    numbers[z, y, x] = body[numbers[z, y, x]]


@inline
def _united(parent, a, b):
    """The root of two numbers that turn out to be one part, the smaller of their roots; 0 is none."""
    if a == 0 or b == 0:
        return a + b
    while parent[a - 1] != a:
        a = parent[a - 1]
    while parent[b - 1] != b:
        b = parent[b - 1]
    parent[max(a, b) - 1] = min(a, b)
    return min(a, b)


@kernel
def flooded(window, classes, labels, parent):
    """Number the connected parts of every class, from 1 in raster order; returns how many there
    are.
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
                        mine = _united(parent, mine, labels[z, y - 1, x])
                    if (
                        z > 0
                        and labels[z - 1, y, x] != mine
                        and classes[window[z - 1, y, x]] == kind
                    ):
                        mine = _united(parent, mine, labels[z - 1, y, x])
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

"""Struts: where no piece keeps what is to hang together, the likeliest way to it is filled in.

A body that a piece would close lies within reach of what is still to be made, or of what goes on
there: otherwise it would have been closed before. The way to it through the place's box leads where
most of the pieces that were tried have the same class, so that a strut looks as what might have
been there; it is as thick as the exemplar's structures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.connectivity import CLOSED, FINE, SOLID, VOID, Bodies, Judge
from trabecula.synth.quilt.patch_library import Learnt, void_of
from trabecula.synth.quilt.voxel_codes import EMPTY, FIXED
from trabecula.synth.quilt.windows import box_of

_MOST = 16  # struts of a place
_DEAR, _CHEAP = 128, 8  # what a voxel costs where no piece has the class, and where all have
# by how much less than this it differs by chance, so that of equal ways none along the axes is
# taken
_CROOKED = 8
_OPEN = 512  # what a strut costs that ends at voxels to make, instead of at what it is to join
_FACES = 1.5  # faces of voxels over the area of the surface that they stand for
_NEVER = 1 << 30


@dataclass(frozen=True)
class Struts:
    """What struts of a run are like.

    Attributes
    ----------
    void, solid : int
        Labels that they are made of.
    radius : int
        Voxels around a way that are filled.
    """

    void: int
    solid: int
    radius: int

    @classmethod
    def of(cls, learnt: Learnt, feature: int) -> Struts:
        """As thick as plates of the exemplar's volume over surface, and no thinner than the least
        feature.
        """
        labels, void = learnt.stack[0], void_of(learnt.images[0].phases)
        inside = labels != void
        counts = np.bincount(labels.ravel(), minlength=void + 2)
        counts[void] = 0
        faces = sum(int(np.count_nonzero(np.diff(inside, axis=axis))) for axis in range(3))
        half = _FACES * int(inside.sum()) / max(faces, 1)
        most = max(1, learnt.overlap // 2)
        return cls(void, int(counts.argmax()), max(min(round(half - 0.5), most), feature // 2, 0))

    def laid(
        self,
        bodies: Bodies,
        judge: Judge,
        old: np.ndarray,
        new: np.ndarray,
        of: np.ndarray,
        share: np.ndarray,
    ) -> np.ndarray | None:
        """`new` with struts, so that it may stand; None where there is no way.

        Parameters
        ----------
        bodies, judge
        old, new : uint8
            The window before and after a piece was laid.
        of : int32
            Bodies of `old`.
        share : (z, y, x) float32
            Of the pieces tried, how many have solid at a voxel of the box, 0 .. 1.
        """
        new = new.copy()
        for _ in range(_MOST):
            verdict = judge.verdict(bodies, old, new, of)
            if verdict == FINE:
                return new
            if verdict != CLOSED or not self._one_more(bodies, judge, new, share):
                return None
        return None

    def _one_more(self, bodies: Bodies, judge: Judge, new: np.ndarray, share: np.ndarray) -> bool:
        """Lay a strut from the smallest body that would be shut and has a way; whether there is
        one.
        """
        leaders, shut, kept = judge.shut()
        z, y, x = np.indices(share.shape)
        crooked = (73856093 * x ^ 19349663 * y ^ 83492791 * z) % _CROOKED
        far, came = np.empty(new.size, np.int32), np.empty(new.size, np.int32)
        for k in shut:
            kind = int(bodies.classes[new.ravel()[np.argmax(leaders == k)]])
            found = share if kind == SOLID else 1 - share
            cost = np.zeros(new.shape, np.int32)
            box_of(cost, judge.margin)[...] = (
                _CHEAP + np.rint((_DEAR - _CHEAP) * (1 - found)).astype(np.int32) + crooked
            )
            end = _way(new, leaders, kept, bodies.classes, kind, int(k), cost, far, came)
            if end >= 0:
                label = self.void if kind == VOID else self.solid
                _fill(new, leaders, int(k), end, came, judge.margin, label, self.radius)
                return True
        return False


@inline
def _beside(at, way, shape):
    """The neighbour of a voxel along one of six ways, or -1 where the window ends; voxels by their
    number.
    """
    depth, height, width = shape
    x, y, z = at % width, at // width % height, at // (width * height)
    if way == 0:
        return at + 1 if x + 1 < width else -1
    if way == 1:
        return at - 1 if x > 0 else -1
    if way == 2:
        return at + width if y + 1 < height else -1
    if way == 3:
        return at - width if y > 0 else -1
    if way == 4:
        return at + width * height if z + 1 < depth else -1
    return at - width * height if z > 0 else -1


@kernel
def _way(window, leaders, kept, classes, kind, own, cost, far, came):
    """The cheapest way from a part to another of its class, or to voxels to make: its last voxel,
    or -1.

    Costs are paid in the box alone (elsewhere they are 0: nothing is laid there), and what has the
    class already is free. Distances are put right until none changes, first come first served.
    """
    values, parts, price = window.ravel(), leaders.ravel(), cost.ravel()
    queue = np.empty(len(values) + 1, np.int32)
    waits = np.zeros(len(values), np.bool_)
    head = tail = 0
    for p in range(len(values)):
        far[p], came[p] = _NEVER, -1
        if parts[p] == own:
            far[p], queue[tail], waits[p] = 0, p, True
            tail += 1
    best, end = _NEVER, -1
    while head != tail:
        p = queue[head]
        head = head + 1 if head + 1 < len(queue) else 0
        waits[p] = False
        for way in range(6):
            q = _beside(p, way, window.shape)
            if q < 0:
                continue
            if values[q] == EMPTY:
                if price[p] > 0 and far[p] + _OPEN < best:
                    best, end = far[p] + _OPEN, p
                continue
            same = classes[values[q]] == kind
            if same and parts[q] != own and kept[parts[q]]:
                if far[p] < best:
                    best, end = far[p], p
                continue
            if price[q] == 0 or values[q] >= FIXED:
                continue
            there = far[p] + (0 if same else price[q])
            if there < far[q]:
                far[q], came[q] = there, p
                if not waits[q]:
                    queue[tail], waits[q] = q, True
                    tail = tail + 1 if tail + 1 < len(queue) else 0
    return end


@kernel
def _fill(window, leaders, own, end, came, margin, label, radius):
    """Give a way and what lies around it a label, within the box."""
    depth, height, width = window.shape
    parts = leaders.ravel()
    p = end
    while p >= 0 and parts[p] != own:
        x, y, z = p % width, p // width % height, p // (width * height)
        for k in range(max(z - radius, margin[0]), min(z + radius + 1, depth - margin[0])):
            for j in range(max(y - radius, margin[1]), min(y + radius + 1, height - margin[1])):
                for i in range(max(x - radius, margin[2]), min(x + radius + 1, width - margin[2])):
                    near = (k - z) ** 2 + (j - y) ** 2 + (i - x) ** 2 <= radius * (radius + 1)
                    if near and window[k, j, i] < FIXED:
                        window[k, j, i] = label
        p = came[p]

"""The skeleton as a graph: voxels with more than two neighbours are joints, the lines between them
branches.

1. Voxels get numbers and lists of their neighbours (26; 8 in 2-D).
2. Joint voxels that are neighbours make one joint.
3. Branches are walked from free ends, then from joints; what is left are cycles without a joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.measure.phases import indicator
from trabecula.measure.skeleton.simple import CENTRE_BIT, around
from trabecula.measure.skeleton.thinning import thin_array
from trabecula.measure.union_find import join, root_of

END_END, END_JOINT, JOINT_JOINT, CYCLE = 0, 1, 2, 3


@dataclass(frozen=True, eq=False)
class SkeletonGraph:
    """Joints and branches of a skeleton; B branches, J joints, D axes. Lengths are in the image's
    unit.
    """

    skeleton: np.ndarray
    """(Z, Y, X) or (Y, X) bool."""
    voxels: np.ndarray
    """(P, D) int64: the voxels of every branch in order, with the joint voxels it starts and stops
    at.
    """
    offsets: np.ndarray
    """(B + 1,): branch b is `voxels[offsets[b]:offsets[b + 1]]`."""
    start: np.ndarray
    """(B,) joint at the first voxel; -1 where that is a free end or the branch a cycle."""
    stop: np.ndarray
    """(B,) joint at the last voxel; -1 as for `start`. A branch with one free end starts there."""
    kind: np.ndarray
    """(B,) 0 end to end, 1 end to joint, 2 joint to joint, 3 a cycle without joint (the codes of
    skan).
    """
    length: np.ndarray
    """(B,) along the voxels' centres; 0 for a voxel alone."""
    span: np.ndarray
    """(B,) straight from the first voxel to the last."""
    joints: np.ndarray
    """(J, D) mean of each joint's voxels, in voxels."""
    joint_voxels: np.ndarray
    """(V, D) int64: all voxels of all joints."""
    joint_of: np.ndarray
    """(V,) the joint that each of them belongs to."""
    spacing: tuple[float, ...]
    unit: str

    __repr__ = brief

    @property
    def branches(self) -> int:
        """Return the number of branches."""
        return len(self.length)

    @property
    def ends(self) -> int:
        """Return the number of free ends; a voxel alone has one."""
        alone = int(np.count_nonzero((self.kind == END_END) & (np.diff(self.offsets) == 1)))
        return (
            int(np.count_nonzero(self.kind == END_JOINT))
            + 2 * int(np.count_nonzero(self.kind == END_END))
            - alone
        )

    @property
    def loops(self) -> int:
        """Count the independent loops of the graph: branches - nodes + components."""
        parent = np.arange(len(self.joints))
        between = self.kind == JOINT_JOINT
        components = len(parent) - _merges(parent, self.start[between], self.stop[between])
        return (
            int(np.count_nonzero(between))
            - len(parent)
            + components
            + int(np.count_nonzero(self.kind == CYCLE))
        )

    def path(self, branch: int) -> np.ndarray:
        """Return the voxels of a branch, in order, (n, D)."""
        return self.voxels[self.offsets[branch] : self.offsets[branch + 1]]


def skeleton_graph(image: Image | ArrayLike, *, phase: str | int | None = None) -> SkeletonGraph:
    """Measure the skeleton of a phase as a graph.

    Lee, Kashyap and Chu 1994, doi:10.1006/cgip.1994.1042, section 5; the table of branches follows
    skan, Nunez-Iglesias et al. 2018, doi:10.7717/peerj.4312.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        A material, or a skeleton: thinning leaves a skeleton as it is.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    graph : SkeletonGraph
        Branches in the order of their free ends, then of their joints' neighbours (raster order).

    Raises
    ------
    InputError
        Not labels, or no such phase.

    Notes
    -----
    A joint is a cluster of neighbouring joint voxels; loops inside a cluster are not branches. The
    length of a branch ends at the joint voxel it touches, not at the cluster's centre.

    Examples
    --------
    >>> tee = np.zeros((5, 7), int)
    >>> tee[1, :], tee[1:, 3] = 1, 1
    >>> graph = skeleton_graph(tee)
    >>> graph.branches, graph.ends, graph.loops, len(graph.joints)
    (3, 3, 0, 1)
    """
    image, inside = indicator(image, phase)
    skeleton = thin_array(inside)
    lifted = skeleton.reshape((1,) * (3 - skeleton.ndim) + skeleton.shape)
    padded = np.pad(lifted, 1)
    places = np.flatnonzero(padded)
    number = np.full(padded.size, -1, np.int32)
    number[places] = np.arange(len(places), dtype=np.int32)
    first, near = _neighbours(places, number, around(padded.shape))
    joint, joints = _joints(first, near)
    path, offsets, start, stop = _walk(first, near, joint)
    at = np.stack(np.unravel_index(places, padded.shape), axis=1)[:, 3 - skeleton.ndim :] - 1
    of_joint = np.flatnonzero(joint >= 0)
    sizes = np.maximum(np.bincount(joint[of_joint], minlength=joints), 1)
    sums = [
        np.bincount(joint[of_joint], weights=column, minlength=joints) for column in at[of_joint].T
    ]
    voxels = at[path]
    length, span = _lengths(voxels, offsets, np.array(image.spacing))
    return SkeletonGraph(
        skeleton=skeleton,
        voxels=voxels,
        offsets=offsets,
        start=start,
        stop=stop,
        kind=_kinds(path, offsets, start, stop),
        length=length,
        span=span,
        joints=np.stack(sums, axis=1) / sizes[:, None],
        joint_voxels=at[of_joint],
        joint_of=joint[of_joint],
        spacing=image.spacing,
        unit=image.unit,
    )


def _lengths(
    voxels: np.ndarray, offsets: np.ndarray, spacing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the length along every branch, and straight from its first voxel to its last."""
    steps = np.linalg.norm(np.diff(voxels, axis=0) * spacing, axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    first, last = offsets[:-1], offsets[1:] - 1
    return along[last] - along[first], np.linalg.norm(
        (voxels[last] - voxels[first]) * spacing, axis=1
    )


def _kinds(
    path: np.ndarray, offsets: np.ndarray, start: np.ndarray, stop: np.ndarray
) -> np.ndarray:
    kind = (start >= 0).astype(np.uint8) + (stop >= 0)
    first, last = offsets[:-1], offsets[1:] - 1
    kind[(kind == END_END) & (path[first] == path[last]) & (last > first)] = CYCLE
    return kind.astype(np.uint8)


@kernel
def _neighbours(places, number, steps):
    """List the neighbours of voxel v: near[first[v]:first[v + 1]]."""
    first = np.zeros(len(places) + 1, np.int64)
    for v in range(len(places)):
        count = 0
        for k in range(27):
            count += k != CENTRE_BIT and number[places[v] + steps[k]] >= 0
        first[v + 1] = first[v] + count
    near = np.empty(first[-1], np.int64)
    for v in range(len(places)):
        n = first[v]
        for k in range(27):
            other = number[places[v] + steps[k]]
            if k != CENTRE_BIT and other >= 0:
                near[n] = other
                n += 1
    return first, near


@kernel
def _joints(first, near):
    """Return the joint of every voxel, -1 for the others, numbered by their first voxel; and their
    number.
    """
    voxels = len(first) - 1
    parent = np.arange(voxels)
    joint = np.full(voxels, -1, np.int64)
    for v in range(voxels):
        if first[v + 1] - first[v] > 2:
            for n in range(first[v], first[v + 1]):
                if first[near[n] + 1] - first[near[n]] > 2:
                    join(parent, v, near[n])
    count = 0
    for v in range(voxels):
        if first[v + 1] - first[v] > 2:
            root = root_of(parent, v)
            if root == v:
                joint[v] = count
                count += 1
            joint[v] = joint[root]
    return joint, count


@kernel
def _walk(first, near, joint):
    """Walk along every branch: its voxels as numbers, one after another; where each begins; the
    joints at its ends.
    """
    voxels = len(first) - 1
    path = np.empty(3 * voxels + 1, np.int64)
    offsets = np.zeros(voxels + 1, np.int64)
    start = np.full(voxels, -1, np.int64)
    stop = np.full(voxels, -1, np.int64)
    seen = joint >= 0
    count = length = 0
    for turn in range(3):
        for v in range(voxels):
            if seen[v]:
                continue
            came = -1
            if turn == 0 and first[v + 1] - first[v] > 1:
                continue
            if turn == 1:
                for n in range(first[v + 1] - 1, first[v] - 1, -1):
                    if joint[near[n]] >= 0:
                        came = near[n]
                if came < 0:
                    continue
                path[length] = came
                length += 1
                start[count] = joint[came]
            at = v
            while True:
                path[length] = at
                length += 1
                if joint[at] >= 0:
                    stop[count] = joint[at]
                    break
                if seen[at]:  # a cycle is closed by its first voxel
                    break
                seen[at] = True
                to = -1
                for n in range(first[at + 1] - 1, first[at] - 1, -1):
                    if near[n] != came:
                        to = near[n]
                if to < 0:
                    break
                came, at = at, to
            count += 1
            offsets[count] = length
    return (
        path[:length].copy(),
        offsets[: count + 1].copy(),
        start[:count].copy(),
        stop[:count].copy(),
    )


@kernel
def _merges(parent, one, other):
    """Join the pairs; return the number of them that joined two components."""
    merges = 0
    for n in range(len(one)):
        i, j = root_of(parent, one[n]), root_of(parent, other[n])
        if i != j:
            join(parent, i, j)
            merges += 1
    return merges

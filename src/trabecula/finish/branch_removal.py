"""Removal of a branch: the voxels that belong to it, removed one simple voxel after another."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.finish.labels import lift
from trabecula.measure.skeleton import SkeletonGraph
from trabecula.measure.skeleton.simple import (
    FACES,
    around,
    euler_changes,
    is_simple,
    is_simple_by_faces,
    neighbourhood,
)

_MOST = 0.8  # least share of a strut's voxels that have to be removable


class Territories:
    """The branch or joint of the skeleton that owns each voxel of a phase: the nearest one, along
    paths inside the phase.

    Owners are numbered: branches as in the graph, then joints. Volumes have three axes and a margin
    of one voxel.
    """

    def __init__(self, graph: SkeletonGraph, inside: np.ndarray, radius: np.ndarray) -> None:
        self.inside = np.pad(lift(inside), 1).astype(np.uint8)
        self.edge = np.array((max(graph.spacing),) * (3 - inside.ndim) + tuple(graph.spacing))
        self.owner = np.full(self.inside.shape, -1, np.int32)
        self.added: list[np.ndarray] = []
        """(n, 3) voxels of every strut that has been grown."""
        along, joints = tuple(self.lift(graph.voxels).T), tuple(self.lift(graph.joint_voxels).T)
        self.owner[along] = np.repeat(np.arange(graph.branches), np.diff(graph.offsets))
        # after the branches: a joint's voxels are also ends of the branches that meet there
        self.owner[joints] = graph.branches + graph.joint_of
        self.spine = self.owner >= 0
        self.radius = lift(radius)
        self._girth = float(radius[graph.skeleton].max(initial=0))
        _propagate_owners(
            self.inside.reshape(-1),
            self.owner.reshape(-1),
            np.flatnonzero(self.spine),
            around(self.inside.shape),
            self.edge,
        )
        owned = np.flatnonzero(self.owner.reshape(-1) >= 0)
        label = self.owner.reshape(-1)[owned]
        order = np.argsort(label, kind="stable")
        self._owned = owned[order]
        self._first = np.searchsorted(label[order], np.arange(graph.branches + 1))

    def lift(self, voxels: np.ndarray) -> np.ndarray:
        """Return the indices (n, 3) in the volumes of voxels (n, D) of the image."""
        return np.pad(voxels, [(0, 0), (3 - voxels.shape[1], 0)]) + 1

    def branch_voxels(self, branch: int) -> np.ndarray:
        """Return the flat indices (n,) of the voxels that belong to a branch alone.

        They are in no largest sphere around a skeleton voxel of another branch or joint.
        """
        flat = self._owned[self._first[branch] : self._first[branch + 1]]
        if not len(flat):
            return flat
        at = self.places(flat)
        reach = int(np.ceil(self._girth / self.edge.min()))
        low = np.maximum(at.min(axis=0) - reach, 0)
        box = tuple(slice(a, b) for a, b in zip(low, at.max(axis=0) + reach + 1, strict=True))
        near = np.argwhere(self.spine[box] & (self.owner[box] != branch)) + low
        return flat[_in_no_sphere(at, near, self.radius[tuple(near.T - 1)], self.edge)]

    def places(self, flat: np.ndarray) -> np.ndarray:
        """Return the indices (n, 3) of flat indices (n,)."""
        return np.stack(np.unravel_index(flat, self.inside.shape), axis=1)

    def at_face(self, places: np.ndarray) -> bool:
        """Return whether any of the voxels touches a face of the image."""
        at, last = self.places(places), np.array(self.inside.shape) - 2
        return bool(((at == 1) | (at == last))[:, last > 1].any())

    def surface(self, places: np.ndarray) -> tuple[float, float]:
        """Return the area by which voxels touch the rest of the phase, and the other phases.

        `places` are flat indices in rising order.
        """
        flat, sides = self.inside.reshape(-1), around(self.inside.shape)[[4, 10, 12, 14, 16, 22]]
        area = np.prod(self.edge) / self.edge[[0, 1, 2, 2, 1, 0]]
        beside = places[:, None] + sides
        found = np.minimum(np.searchsorted(places, beside), len(places) - 1)
        free = flat[beside] == 0
        held = ~free & (places[found] != beside)
        return float(held.sum(axis=0) @ area), float(free.sum(axis=0) @ area)

    def write(self, at: np.ndarray, *, grown: bool) -> None:
        """Write voxels (n, 3) into `inside`: of a grown strut, or of one that is removed."""
        self.inside[tuple(at.T)] = grown
        if grown:
            self.added.append(at)

    def cut(self, branch: int, tip: np.ndarray) -> np.ndarray:
        """Remove the branch's voxels from `inside`, those nearest to its tip first.

        Returns their flat indices. Only voxels whose removal keeps the topology are removed, with
        26 neighbours and with 6; where many would have to stay, the branch is more than a strut
        (part of a plate with holes, say), and none is removed.
        """
        flat = self.branch_voxels(branch)
        at = self.places(flat)
        far = np.linalg.norm((at - tip) * self.edge, axis=1)
        order = flat[np.argsort(far, kind="stable")]
        flat_inside = self.inside.reshape(-1)
        removed = _peel_off(flat_inside, order, around(self.inside.shape), euler_changes())
        if np.count_nonzero(removed) < _MOST * len(order):
            flat_inside[order] = 1
            return order[:0]
        return order[removed]


@kernel
def _in_no_sphere(at, centre, radius, edge):
    """Return which of the voxels are in none of the spheres, a bool array."""
    free = np.ones(len(at), np.bool_)
    for n in range(len(at)):
        for k in range(len(centre)):
            z = (at[n, 0] - centre[k, 0]) * edge[0]
            y = (at[n, 1] - centre[k, 1]) * edge[1]
            x = (at[n, 2] - centre[k, 2]) * edge[2]
            # The radius is a float32: its square needs slack, or rounding decides about voxels on
            # the sphere itself.
            if z * z + y * y + x * x <= np.float64(radius[k]) ** 2 * (1 + 1e-6):
                free[n] = False
                break
    return free


@kernel
def _propagate_owners(inside, owner, seeds, steps, edge):
    """Propagate the owner of every seed to the voxels nearer to it than to any seed seen so far.

    A queue of voxels in a ring buffer; each is queued again when a nearer seed reaches it.
    """
    height = steps[22] - steps[13]  # one step along z
    width = steps[16] - steps[13]
    best = np.full(len(inside), np.inf, np.float32)
    source = np.full(len(inside), -1, np.int64)
    waiting = np.zeros(len(inside), np.bool_)
    room = len(seeds)
    for at in range(len(inside)):
        room += inside[at] == 1
    queue = np.empty(room, np.int64)
    for n in range(len(seeds)):
        queue[n] = seeds[n]
        source[seeds[n]] = seeds[n]
        best[seeds[n]] = 0
        waiting[seeds[n]] = True
    head, count = 0, len(seeds)
    while count > 0:
        at = queue[head]
        head = (head + 1) % room
        count -= 1
        waiting[at] = False
        seed = source[at]
        dz = (at // height - seed // height) * edge[0]
        dy = (at % height // width - seed % height // width) * edge[1]
        dx = (at % width - seed % width) * edge[2]
        for k in range(27):
            other = at + steps[k]
            if inside[other] == 0:
                continue
            z, y, x = (
                dz + (k // 9 - 1) * edge[0],
                dy + (k // 3 % 3 - 1) * edge[1],
                dx + (k % 3 - 1) * edge[2],
            )
            far = np.float32(z * z + y * y + x * x)
            if far < best[other]:
                best[other] = far
                source[other] = seed
                owner[other] = owner[seed]
                if not waiting[other]:
                    waiting[other] = True
                    queue[(head + count) % room] = other
                    count += 1


@kernel
def _peel_off(state, order, steps, changes):
    """Remove simple voxels in this order, in passes until none is; return which, as bools."""
    gone = np.zeros(len(order), np.bool_)
    removed = 1
    while removed > 0:
        removed = 0
        for n in range(len(order)):
            if gone[n]:
                continue
            found = neighbourhood(state, order[n], steps)
            # Without a face neighbour it is a component of its own, by faces, and its removal
            # disconnects nothing.
            if is_simple(found, changes) and (
                found & FACES == 0 or is_simple_by_faces(found, changes)
            ):
                state[order[n]] = 0
                gone[n] = True
                removed += 1
    return gone

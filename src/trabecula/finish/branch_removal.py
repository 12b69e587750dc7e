"""Take a branch off: which voxels are its own, and their removal one simple voxel after another."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.skeleton import SkeletonGraph
from trabecula.measure.skeleton.simple import (
    FACES,
    around,
    euler_changes,
    is_simple,
    is_simple_by_faces,
    neighbourhood,
)

_MOST = 0.8  # of a strut's voxels have to be free to go


class Territories:
    """Every voxel of a phase belongs to the branch or joint of the nearest skeleton voxel, as far
    as ways inside the phase lead.

    Owners are numbered: branches as in the graph, then joints. Volumes are lifted to three axes and
    have a margin of one voxel.
    """

    def __init__(self, graph: SkeletonGraph, inside: np.ndarray, radius: np.ndarray) -> None:
        lift = 3 - inside.ndim
        self.inside = np.pad(inside.reshape((1,) * lift + inside.shape), 1).astype(np.uint8)
        self.edge = np.array((max(graph.spacing),) * lift + tuple(graph.spacing))
        self.owner = np.full(self.inside.shape, -1, np.int32)
        self.added: list[np.ndarray] = []
        """(n, 3) voxels of every strut that has been grown."""
        along, joints = tuple(self.lifted(graph.voxels).T), tuple(self.lifted(graph.joint_voxels).T)
        self.owner[along] = np.repeat(np.arange(graph.branches), np.diff(graph.offsets))
        # over the ends of the branches that meet there
        self.owner[joints] = graph.branches + graph.joint_of
        self.spine = self.owner >= 0
        self.radius = radius.reshape((1,) * lift + radius.shape)
        self._girth = float(radius[graph.skeleton].max(initial=0))
        _spread(
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

    def lifted(self, voxels: np.ndarray) -> np.ndarray:
        """(n, 3) places in the volumes of voxels (n, D) of the image."""
        return np.pad(voxels, [(0, 0), (3 - voxels.shape[1], 0)]) + 1

    def of(self, branch: int) -> np.ndarray:
        """(n,) flat places of the voxels of a branch that lie in no sphere around another part of
        the skeleton.
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
        """(n, 3) of flat places."""
        return np.stack(np.unravel_index(flat, self.inside.shape), axis=1)

    def at_face(self, places: np.ndarray) -> bool:
        """Whether any of the voxels lies at a face of the image."""
        at, last = self.places(places), np.array(self.inside.shape) - 2
        return bool(((at == 1) | (at == last))[:, last > 1].any())

    def surface(self, places: np.ndarray) -> tuple[float, float]:
        """Area by which voxels (rising flat places) touch the rest of the phase, and what is not
        the phase.
        """
        flat, sides = self.inside.reshape(-1), around(self.inside.shape)[[4, 10, 12, 14, 16, 22]]
        area = np.prod(self.edge) / self.edge[[0, 1, 2, 2, 1, 0]]
        beside = places[:, None] + sides
        found = np.minimum(np.searchsorted(places, beside), len(places) - 1)
        free = flat[beside] == 0
        held = ~free & (places[found] != beside)
        return float(held.sum(axis=0) @ area), float(free.sum(axis=0) @ area)

    def cut(self, branch: int, tip: np.ndarray) -> np.ndarray:
        """Remove the branch's voxels from `inside`, those nearest to its tip first; their flat
        places.

        Only voxels whose removal changes no topology go, with 26 neighbours and with 6; where many
        would have to stay, the branch is more than a strut (part of a plate with holes, say), and
        nothing goes.
        """
        flat = self.of(branch)
        at = self.places(flat)
        far = np.linalg.norm((at - tip) * self.edge, axis=1)
        order = flat[np.argsort(far, kind="stable")]
        flat_inside = self.inside.reshape(-1)
        gone = _peel_off(flat_inside, order, around(self.inside.shape), euler_changes())
        if np.count_nonzero(gone) < _MOST * len(order):
            flat_inside[order] = 1
            return order[:0]
        return order[gone]


@kernel
def _in_no_sphere(at, centre, radius, edge):
    """Which of the voxels lie in none of the spheres."""
    free = np.ones(len(at), np.bool_)
    for n in range(len(at)):
        for k in range(len(centre)):
            z = (at[n, 0] - centre[k, 0]) * edge[0]
            y = (at[n, 1] - centre[k, 1]) * edge[1]
            x = (at[n, 2] - centre[k, 2]) * edge[2]
            # Squares of float32 distances: voxels on the sphere itself should not be in or out by
            # rounding.
            if z * z + y * y + x * x <= np.float64(radius[k]) ** 2 * (1 + 1e-6):
                free[n] = False
                break
    return free


@kernel
def _spread(inside, owner, seeds, steps, edge):
    """Hand every seed's owner on to the voxels that are nearer to it than to any other seed known
    to them.
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
    """Remove the voxels that may go, in this order, again and again until none may; which of them
    went.
    """
    gone = np.zeros(len(order), np.bool_)
    removed = 1
    while removed > 0:
        removed = 0
        for n in range(len(order)):
            if gone[n]:
                continue
            found = neighbourhood(state, order[n], steps)
            # Without a face neighbour it is a piece of its own, by faces, and its loss breaks
            # nothing.
            if is_simple(found, changes) and (
                found & FACES == 0 or is_simple_by_faces(found, changes)
            ):
                state[order[n]] = 0
                gone[n] = True
                removed += 1
    return gone

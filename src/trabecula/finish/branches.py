"""Struts with a free end, and the cells that they stick into.

Rough surfaces and plates have skeleton branches with free ends too. A branch is taken for a strut
where its own voxels

- stick out: the void touches at least twice as much of their surface as the rest of the phase does;
- are not more than twice as wide as thick;
- are not cut by a face of the image, nor by the surface of the form that it fills.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.finish.branch_removal import Territories
from trabecula.finish.forms import depth_in_form
from trabecula.finish.periodic import crop_margins
from trabecula.measure.distance import distance_transform
from trabecula.measure.skeleton import SkeletonGraph, skeleton_graph
from trabecula.measure.skeleton.graph import END_JOINT, JOINT_JOINT

_FLAT = 2.0  # width over thickness above which a branch is a plate
_SAMPLED = 200  # joints whose loops give the size of a typical cell
_FREE = 2.0  # least free surface over surface shared with the rest of the phase


@dataclass(frozen=True, eq=False)
class FreeEnd:
    """A strut with a free end inside the image. Lengths are in the unit of the spacing."""

    branch: int
    """Number in the skeleton graph."""
    root: int
    """The joint that it grows from."""
    length: float
    """Length of the branch, from joint to tip."""
    thickness: float
    """Mean diameter, along the branch outside of its root."""
    tip: np.ndarray
    """(3,) voxel at the free end, in the territories' volumes."""
    direction: np.ndarray
    """(3,) of length 1, outwards, in the unit of the spacing."""


@dataclass(frozen=True, eq=False)
class Anatomy:
    """A phase divided into the territories of its skeleton's branches."""

    graph: SkeletonGraph
    radius: np.ndarray
    """Distance of every voxel of the phase to the rest, of the image's shape, in the unit of the
    spacing.
    """
    territories: Territories
    ends: list[FreeEnd]
    """Shortest first."""
    volume: float
    """Volume of the image, or of the form that it fills, without the margin in which ends are not
    judged; in the unit of the spacing.
    """
    margins: tuple[int, ...]
    """Voxels along every axis that repeat a periodic image, before and behind it."""


def anatomy(
    inside: np.ndarray,
    spacing: tuple[float, ...],
    form: np.ndarray | None = None,
    margins: tuple[int, ...] | None = None,
) -> Anatomy:
    """Find skeleton, territories and free ends of a phase, a boolean array.

    Lengths are in the unit of `spacing`. Ends nearer to a face, or to the surface of a `form`
    (bool, same shape), than the mean thickness of the struts are not judged: a strut may be cut
    there. Nor are those in `margins`, voxels along every axis that repeat a periodic image.
    """
    margins = margins or (0,) * inside.ndim
    graph = skeleton_graph(Image(inside, "labels", spacing=spacing))
    radius = distance_transform(inside, spacing=spacing)
    margin = 2 * float(radius[graph.skeleton].mean(dtype=np.float64))
    territories = Territories(graph, inside, radius)
    girth = np.zeros(len(graph.joints))
    np.maximum.at(girth, graph.joint_of, radius[tuple(graph.joint_voxels.T)])
    domain = _FilledDomain.of(inside.shape, spacing, form, margins)
    found = []
    for branch in np.flatnonzero(graph.kind == END_JOINT):
        if domain.depth(graph.path(branch)[0]) >= margin:
            end = _free_end(
                int(branch), graph, radius, girth[graph.stop[branch]], territories, domain
            )
            found += [] if end is None else [end]
    found.sort(key=lambda end: end.length)  # stable: equal ones stay in the order of the graph
    return Anatomy(graph, radius, territories, found, domain.volume(margin), margins)


@dataclass(frozen=True, eq=False)
class _FilledDomain:
    """The domain that a phase fills: a box, or a form in it."""

    margins: np.ndarray
    """Voxels along every axis that repeat a periodic image, before and behind the box."""
    shape: np.ndarray
    """Voxels of the box."""
    spacing: np.ndarray
    deep: np.ndarray | None
    """Depth of the centre of every voxel below the surface of a form, a face of a voxel or of the
    box; None for a box.
    """

    @classmethod
    def of(
        cls,
        shape: tuple[int, ...],
        spacing: tuple[float, ...],
        form: np.ndarray | None,
        margins: tuple[int, ...],
    ) -> _FilledDomain:
        """Return the domain of an image of this shape, or of a form in it."""
        around = np.array(margins)
        deep = None if form is None else depth_in_form(form, spacing, (around > 0).tolist())
        return cls(around, np.array(shape) - 2 * around, np.array(spacing), deep)

    def depth(self, voxel: np.ndarray) -> float:
        """Return the depth of the centre of a voxel below the surface; -inf in the margins."""
        at = voxel - self.margins
        if (at < 0).any() or (at >= self.shape).any():
            return -np.inf
        if self.deep is not None:
            return float(self.deep[tuple(voxel)])
        centre = ((at + 0.5) * self.spacing)[self.margins == 0]
        sides = (self.shape * self.spacing)[self.margins == 0]
        return float(min(centre.min(initial=np.inf), (sides - centre).min(initial=np.inf)))

    def volume(self, margin: float) -> float:
        """Return the volume deeper than a margin."""
        if self.deep is not None:
            own = crop_margins(self.deep, self.margins.tolist())
            return float(np.count_nonzero(own >= margin) * np.prod(self.spacing))
        cut = np.where(self.margins == 0, 2 * margin, 0)
        return float(np.prod(np.maximum(self.shape * self.spacing - cut, 0)))

    def cuts(self, space: Territories, places: np.ndarray) -> bool:
        """Return whether any voxel of a branch touches the surface."""
        if self.deep is None:
            return space.at_face(places)
        at = space.places(places)[:, 3 - self.deep.ndim :] - 1
        return bool((self.deep[tuple(at.T)] < self.spacing.max()).any())


def _free_end(
    branch: int,
    graph: SkeletonGraph,
    radius: np.ndarray,
    girth: float,
    space: Territories,
    domain: _FilledDomain,
) -> FreeEnd | None:
    """Return the strut around a branch; None where it is no strut, or a face cuts it.

    `girth` is the radius at its root.
    """
    edge, root = space.edge, int(graph.stop[branch])
    own = space.branch_voxels(branch)
    if not len(own) or domain.cuts(space, own):
        return None
    held, free = space.surface(own)
    if free < _FREE * held:
        return None
    path = space.lift(graph.path(branch))
    base = space.lift(graph.joints[root][None])[0]
    away = np.linalg.norm((path[:-1] - base) * edge, axis=1)
    outside = graph.path(branch)[:-1][away >= min(girth, away[0])]
    diameter = 2 * float(radius[tuple(outside.T)].mean()) - edge.min() / 2
    if not away[0]:  # a joint around its own branch: no direction is outwards
        return None
    outward = (path[0] - base) * edge / away[0]
    at = space.places(own) * edge
    wide, thick = _widths(at, outward, edge)
    if radius.ndim == 3 and wide > _FLAT * min(thick, diameter):
        return None
    behind = np.linalg.norm((path - path[0]) * edge, axis=1) >= 2 * diameter
    direction = (path[0] - (path[np.argmax(behind)] if behind.any() else base)) * edge
    direction /= np.linalg.norm(direction)
    return FreeEnd(branch, root, float(graph.length[branch]), diameter, path[0], direction)


def _widths(at: np.ndarray, along: np.ndarray, edge: np.ndarray) -> tuple[float, float]:
    """Return two widths across a direction, larger first: of the box of equal second moments."""
    across = at - at.mean(axis=0)
    across -= np.outer(across @ along, along)
    # A voxel is no point: add its own second moment, edge^2 / 12.
    moments = np.linalg.eigvalsh(across.T @ across / len(at) + np.diag(edge**2) / 12)
    return float(np.sqrt(12 * moments[2])), float(np.sqrt(12 * moments[1]))


def cell_perimeters(graph: SkeletonGraph, roots: list[int]) -> np.ndarray:
    """Return the perimeter of the cell around each joint, in the unit of the spacing.

    It is the length of the shortest loop through the joint, but no less than the median of such
    loops: a small hole in a strut is no cell, and a joint without a loop (on a tree inside a cell)
    still has one around it. Infinite where the graph has no loops at all.
    """
    edges = _edges(graph)
    every = 1 + len(edges) // _SAMPLED
    loops = np.array(
        [_shortest_loop(joint, edges) for joint in range(0, len(edges), every)], np.float64
    )
    if not np.isfinite(loops).any():
        return np.full(len(roots), np.inf)
    median = float(np.median(loops[np.isfinite(loops)]))
    found = np.array([_shortest_loop(root, edges) for root in roots], np.float64)
    return np.where(np.isfinite(found), np.maximum(found, median), median)


def _edges(graph: SkeletonGraph) -> list[list[tuple[int, float, int]]]:
    """List for every joint its branches: the other joint, the length between both centres, the
    branch's number.
    """
    edge = np.array(graph.spacing)
    edges: list[list[tuple[int, float, int]]] = [[] for _ in graph.joints]
    for branch in np.flatnonzero(graph.kind == JOINT_JOINT):
        path, a, b = graph.path(branch), int(graph.start[branch]), int(graph.stop[branch])
        inside = np.linalg.norm((path[[0, -1]] - graph.joints[[a, b]]) * edge, axis=1).sum()
        length = float(graph.length[branch] + inside)
        edges[a].append((b, length, int(branch)))
        if a != b:
            edges[b].append((a, length, int(branch)))
    return edges


def _shortest_loop(root: int, edges: list[list[tuple[int, float, int]]]) -> float:
    """Return the length of the shortest loop through the root, by Dijkstra's algorithm.

    A loop closes where two paths meet that left the root by different branches.
    """
    best = min((length for other, length, _ in edges[root] if other == root), default=np.inf)
    queue = [(length, other, branch) for other, length, branch in edges[root] if other != root]
    heapq.heapify(queue)
    reached: dict[int, tuple[float, int]] = {}
    while queue:
        far, joint, left_by = heapq.heappop(queue)
        if 2 * far >= best:  # the farthest joints of a shorter loop are nearer than half of it
            break
        if joint in reached:
            continue
        reached[joint] = (far, left_by)
        for other, length, branch in edges[joint]:
            if other == root:
                best = min(best, far + length) if branch != left_by else best
            elif other not in reached:
                heapq.heappush(queue, (far + length, other, left_by))
            elif reached[other][1] != left_by:
                best = min(best, far + length + reached[other][0])
    return float(best)

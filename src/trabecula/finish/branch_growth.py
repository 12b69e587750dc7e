"""Growth of a strut from its free end to the next strut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.finish.branch_removal import Territories
from trabecula.finish.branches import Anatomy, FreeEnd
from trabecula.measure.configurations import count_cubes, cube_euler
from trabecula.measure.skeleton.graph import JOINT_JOINT

_CONE = np.cos(np.deg2rad(45))
_STEP = 0.25  # voxels between two spheres of a strut


@dataclass(frozen=True, eq=False)
class Struts:
    """The n struts of an exemplar from joint to joint, to be copied."""

    paths: list[np.ndarray]
    """(k, 3) centres along each, in the image's unit."""
    diameters: list[np.ndarray]
    """(k,) along each."""
    chords: np.ndarray
    """(n, 3) from first to last centre."""
    thickness: np.ndarray
    """(n,) mean diameter."""


def struts_of(exemplar: Anatomy) -> Struts:
    """Return the branches between two different joints."""
    graph, edge = exemplar.graph, exemplar.territories.edge
    paths, diameters = [], []
    for branch in np.flatnonzero((graph.kind == JOINT_JOINT) & (graph.span > 0)):
        path = graph.path(branch)
        paths.append(exemplar.territories.lift(path) * edge)
        diameters.append(2 * exemplar.radius[tuple(path.T)].astype(np.float64) - edge.min() / 2)
    chords = np.array([path[-1] - path[0] for path in paths]).reshape(-1, 3)
    return Struts(paths, diameters, chords, np.array([along.mean() for along in diameters]))


def grow(
    end: FreeEnd, perimeter: float, parts: Anatomy, struts: Struts | None, closed: np.ndarray | None
) -> np.ndarray:
    """Paint a strut from a free end to its target into the territories.

    Returns the flat indices of the new voxels. Empty where there is no target within the diameter
    of a circle of the cell's perimeter, where a strut that was grown before ends here, or where the
    new one would close a hole instead of making a loop. `closed` marks voxels that may not be
    painted.
    """
    space, none = parts.territories, np.empty(0, np.int64)
    target = None if _is_met(end, space) else _target(end, perimeter, parts)
    if target is None:
        return none
    centres, radii = _centreline(end, target, parts, struts)
    places = np.unique(
        np.concatenate([_sphere(c, r, space) for c, r in zip(centres, radii, strict=True)])
    )
    if closed is not None and closed.reshape(-1)[places].any():
        return none
    new = places[space.inside.reshape(-1)[places] == 0]
    if not _makes_loop(space, new):
        return none
    space.owner.reshape(-1)[new] = end.branch
    return new


def _is_met(end: FreeEnd, space: Territories) -> bool:
    """Return whether a strut that was grown before ends at this one: it is no longer free."""
    girth = end.thickness / 2 + 2 * space.edge.max()
    return any(
        np.linalg.norm((at - end.tip) * space.edge, axis=1).min() <= girth for at in space.added
    )


def _target(end: FreeEnd, perimeter: float, parts: Anatomy) -> np.ndarray | None:
    """Return the voxel that the strut should meet: in a cone ahead, the nearest and straightest.

    The least |d|^2 / (d . direction), d from the tip; None where there is none, or where voxels
    beside the root are in between.
    """
    space, reach = parts.territories, perimeter / np.pi
    voxels = np.ceil(reach / space.edge).astype(np.int64)
    low = np.maximum(end.tip - voxels, 0)
    box = tuple(slice(a, b) for a, b in zip(low, end.tip + voxels + 1, strict=True))
    at = np.argwhere(space.inside[box]) + low
    offset = (at - end.tip) * space.edge
    far = np.linalg.norm(offset, axis=1)
    ahead = (offset @ end.direction) / np.maximum(far, 1e-12)
    at = at[(far <= reach) & (ahead >= _CONE)]
    at = at[~_beside_root(at, end, perimeter / 4, parts)]
    if not len(at):
        return None
    offset = (at - end.tip) * space.edge
    target = at[np.argmin((offset * offset).sum(axis=1) / (offset @ end.direction))]
    between = _line(end.tip, target)
    between = between[space.inside[tuple(between.T)] > 0]
    blocked = _beside_root(between, end, perimeter / 4, parts) & (
        space.owner[tuple(between.T)] != end.branch
    )
    return None if blocked.any() else target


def _beside_root(at: np.ndarray, end: FreeEnd, within: float, parts: Anatomy) -> np.ndarray:
    """Return which voxels (n, 3) of the phase are no next strut, a bool array (n,).

    Those of the free end itself, of its root, and of branches from the same root as far as `within`
    along them.
    """
    space, graph = parts.territories, parts.graph
    owner = space.owner[tuple(at.T)]
    beside = (owner == end.branch) | (owner == graph.branches + end.root)
    for branch in np.flatnonzero((graph.start == end.root) | (graph.stop == end.root)):
        mine = np.flatnonzero(owner == branch)
        if branch == end.branch or not len(mine):
            continue
        path = space.lift(graph.path(branch)) * space.edge
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        from_start = along if graph.start[branch] == end.root else np.inf
        from_stop = along[-1] - along if graph.stop[branch] == end.root else np.inf
        apart = np.linalg.norm(at[mine, None] * space.edge - path, axis=2)
        beside[mine] = np.minimum(from_start, from_stop)[np.argmin(apart, axis=1)] < within
    return beside


def _line(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the voxels along a straight line."""
    steps = max(2, int(np.abs(b - a).max() / _STEP))
    return np.round(a + np.linspace(0, 1, steps + 1)[:, None] * (b - a)).astype(np.int64)


def _centreline(
    end: FreeEnd, target: np.ndarray, parts: Anatomy, struts: Struts | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (n, 3) and radii (n,) of the spheres along the new strut, as lengths."""
    edge = parts.territories.edge
    root = parts.territories.lift(parts.graph.joints[end.root][None])[0] * edge
    tip, goal = end.tip * edge, target * edge
    steps = int(np.linalg.norm(goal - tip) / (_STEP * edge.min())) + 2
    share = np.linspace(0, 1, steps)
    bend, diameter = np.zeros((steps, 3)), np.full(steps, end.thickness)
    if struts is not None and len(struts.thickness):
        old = np.linalg.norm(tip - root)
        first = old / (old + np.linalg.norm(goal - tip))
        bend, diameter = _copy_strut(
            struts, goal - root, goal - tip, end.thickness, first + (1 - first) * share
        )
    # At least two voxels wide, as joins are: a sphere of a radius below half a voxel's diagonal
    # could miss every centre of a voxel.
    radii = np.maximum(diameter / 2, edge.max())
    return tip + share[:, None] * (goal - tip) + bend, radii


def _copy_strut(
    struts: Struts, whole: np.ndarray, missing: np.ndarray, thickness: float, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return bend (n, 3) and diameter (n,) along the last section of the best exemplar strut.

    The best one minimises |log| of the ratios of length and thickness, plus 1 - |cosine| of the
    angle between the directions.
    """
    spans = np.linalg.norm(struts.chords, axis=1)
    along = struts.chords @ whole / (spans * np.linalg.norm(whole))
    unlike = np.abs(np.log(spans / np.linalg.norm(whole))) + np.abs(
        np.log(struts.thickness / thickness)
    )
    best = int(np.argmin(unlike + 1 - np.abs(along)))
    order = slice(None) if along[best] >= 0 else slice(None, None, -1)
    path, diameters = struts.paths[best][order], struts.diameters[best][order]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.stack([np.interp(share * length[-1], length, column) for column in path.T], axis=1)
    bend = at - (at[0] + np.linspace(0, 1, len(share))[:, None] * (at[-1] - at[0]))
    scale = float(np.linalg.norm(missing)) / max(float(np.linalg.norm(at[-1] - at[0])), 1e-12)
    bend = bend @ _turn(at[-1] - at[0], missing).T * min(scale, 1.0)
    # Never thinner than the old strut; and the girth of the joint at the far end of the copied one
    # would show as a blob.
    return bend, np.clip(
        np.interp(share * length[-1], length, diameters), thickness, 1.5 * thickness
    )


def _turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation that turns a into the direction of b (Rodrigues' formula)."""
    a, b = a / max(np.linalg.norm(a), 1e-12), b / max(np.linalg.norm(b), 1e-12)
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -0.999:
        return np.eye(3)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def _sphere(centre: np.ndarray, radius: float, space: Territories) -> np.ndarray:
    """Return the flat indices of the voxels whose centres are in a sphere and in the image."""
    shape = np.array(space.inside.shape)
    low = np.maximum(np.ceil((centre - radius) / space.edge), 1).astype(np.int64)
    high = np.minimum(np.floor((centre + radius) / space.edge), shape - 2).astype(np.int64)
    axes = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
    at = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = np.linalg.norm(at * space.edge - centre, axis=1) <= radius + 1e-9
    return np.ravel_multi_index(tuple(at[near].T), space.inside.shape)


def _makes_loop(space: Territories, new: np.ndarray) -> bool:
    """Paint `new` if that lowers the Euler number with 6 and with 26 neighbours.

    It makes loops then and closes none. Returns whether it was painted.
    """
    if not len(new):
        return False
    at = space.places(new)
    box = tuple(slice(a, b) for a, b in zip(at.min(axis=0) - 1, at.max(axis=0) + 2, strict=True))
    before = count_cubes(space.inside[box].astype(bool), None)
    space.inside.reshape(-1)[new] = 1
    change = count_cubes(space.inside[box].astype(bool), None) - before
    if max(change @ cube_euler(6), change @ cube_euler(26)) < 0:
        return True
    space.inside.reshape(-1)[new] = 0
    return False

"""Nodes on the faces of the box, and those that are one node of the periodic material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.mesh.bricks.grid import BrickGrid

AXES = "zyx"


@dataclass(frozen=True, eq=False)
class FaceNodes:
    """Numbers of the nodes on the six faces.

    Attributes
    ----------
    faces : dict
        "z_low", "z_high", "y_low", ... -> int64 array of the corners of that face, -1 where none
        is a node: (Y + 1, X + 1), (Z + 1, X + 1) or (Z + 1, Y + 1).
    shape : three ints
        Voxels of the volume.
    """

    faces: dict[str, np.ndarray]
    shape: tuple[int, int, int]

    def nodes(self, face: str) -> np.ndarray:
        """Return the nodes of a face, rising."""
        numbers = self.faces[face]
        return np.sort(numbers[numbers >= 0])


@dataclass(frozen=True, eq=False)
class NodePairs:
    """Nodes that are one where the volume repeats itself.

    Attributes
    ----------
    nodes, partners : int64 array, (pairs,)
        Every node that depends on a partner, which depends on none.
    periods : int64 array, (pairs, 3)
        Periods along z, y, x from the partner to the node: -1, 0 or 1.
    """

    nodes: np.ndarray
    partners: np.ndarray
    periods: np.ndarray


def collect_faces(grid: BrickGrid) -> FaceNodes:
    """Collect the nodes on the faces of the box, of one pass over the voxels."""
    rows: dict[str, list[np.ndarray]] = {f"{a}_{e}": [] for a in "yx" for e in ("low", "high")}
    faces: dict[str, np.ndarray] = {}
    k, numbers = 0, np.empty((0, 0), np.int64)
    for k, numbers in grid.node_layers():
        if k == 0:
            faces["z_low"] = numbers
        rows["y_low"].append(numbers[0].copy())
        rows["y_high"].append(numbers[-1].copy())
        rows["x_low"].append(numbers[:, 0].copy())
        rows["x_high"].append(numbers[:, -1].copy())
    faces["z_high"] = numbers
    faces |= {name: np.array(found) for name, found in rows.items()}
    return FaceNodes(faces, grid.volume.shape)


def pair_nodes(found: FaceNodes) -> NodePairs:
    """Pair the nodes of opposite faces; of an edge or a corner all go to one of them."""
    sides = np.array(found.shape)
    places, numbers = [], []
    for name, face in found.faces.items():
        axis = AXES.index(name[0])
        inside = np.argwhere(face >= 0)
        across = np.full(len(inside), sides[axis] if name.endswith("high") else 0)
        places.append(np.insert(inside, axis, across, axis=1))
        numbers.append(face[face >= 0])
    place, number = np.concatenate(places), np.concatenate(numbers)
    number, first = np.unique(number, return_index=True)  # edges and corners lie on several faces
    place = place[first]
    key = np.ravel_multi_index(tuple((place % sides).T), found.shape)
    order = np.lexsort((number, key))
    key, place, number = key[order], place[order], number[order]
    fresh = np.ones(len(key), bool)
    fresh[1:] = key[1:] != key[:-1]
    starts = np.flatnonzero(fresh)
    partner = starts[np.cumsum(fresh) - 1] if len(key) else starts
    depends = partner != np.arange(len(key))
    periods = (place - place[partner]) // sides
    return NodePairs(number[depends], number[partner][depends], periods[depends])

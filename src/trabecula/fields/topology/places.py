"""Places on a part: nodes in a box, on a plane, where its surface faces, or at a painted mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.measure.smooth import gaussian

Box = tuple[tuple[float, float], ...]
"""From and to along z, y, x, in shares of the sides 0 .. 1; a face, edge or corner where both are
equal.
"""
EVERYWHERE: Box = ((0.0, 1.0), (0.0, 1.0), (0.0, 1.0))

Three = tuple[float, float, float]

_WITHIN = 30.0  # degrees
_SMOOTH = 1.5  # elements: the steps of an oblique face are levelled before its normal is taken


@dataclass(frozen=True)
class Place:
    """Nodes of a part; what is not given picks all.

    Parameters
    ----------
    normal : three floats, optional
        Nodes of the surface that faces this way (z, y, x), by `within` degrees. Normals are those
        of the form levelled over some elements: at an edge they turn by half its angle, so 60
        degrees take a flat face up to its edges, and 30 leave them out.
    within : float
    through, across : three floats, optional
        Nodes of the plane through a point, in shares of the sides, with this normal.
    mesh : str, optional
        Name of a painted mesh, a surface that lies on the part's: nodes beside it.
    """

    normal: Three | None = None
    within: float = _WITHIN
    through: Three | None = None
    across: Three | None = None
    mesh: str | None = None


ALL = Place()


def read_place(given: Mapping[str, Any]) -> Place:
    """Return the place that a support, load or region names.

    Raises
    ------
    ValueError, TypeError, LookupError
        It cannot be read.
    """
    plane = given.get("plane")
    within = float(given.get("within", _WITHIN))
    if not 0 < within <= 180:
        raise ValueError(f"within is an angle above 0 and up to 180 degrees, got {within:g}")
    mesh = given.get("mesh")
    if mesh is not None and not isinstance(mesh, str):
        raise TypeError("mesh is the name of a file")
    return Place(
        None if "normal" not in given else _direction(given["normal"]),
        within,
        None if plane is None else _three(plane["through"]),
        None if plane is None else _direction(plane["normal"]),
        mesh,
    )


def write_place(place: Place) -> dict[str, Any]:
    """Return the fields that `read_place` reads; none where the place picks all."""
    found: dict[str, Any] = {}
    if place.normal is not None:
        found |= {"normal": place.normal, "within": place.within}
    if place.through is not None:
        found["plane"] = {"through": place.through, "normal": place.across}
    if place.mesh is not None:
        found["mesh"] = place.mesh
    return found


def _three(given: Sequence[float]) -> Three:
    z, y, x = (float(part) for part in given)
    if not all(map(math.isfinite, (z, y, x))):
        raise ValueError("three finite numbers are needed")
    return z, y, x


def _direction(given: Sequence[float]) -> Three:
    found = _three(given)
    if not any(found):
        raise ValueError("a normal is not 0 0 0")
    return found


def nodes_of(box: Box, shape: tuple[int, ...]) -> np.ndarray:
    """Return the nodes of a grid of elements in a box, the nearest ones at least, (Z + 1, Y + 1,
    X + 1) bool.
    """
    picked = []
    for (low, high), side in zip(box, shape, strict=True):
        node = np.arange(side + 1)
        first, last = int(np.ceil(low * side - 1e-9)), int(np.floor(high * side + 1e-9))
        if first > last:  # between two nodes
            first = last = round((low + high) / 2 * side)
        picked.append((node >= first) & (node <= last))
    return picked[0][:, None, None] & picked[1][None, :, None] & picked[2][None, None, :]


class PartNodes:
    """The nodes of a part, of which places are picked.

    Parameters
    ----------
    inside : (Z, Y, X) bool
        Elements of the part.
    marks : mapping of str to (Z, Y, X) bool array
        Elements that painted meshes go through, by the name of the mesh.
    edges : three floats
        Of an element.
    form : (Z, Y, X) bool, optional
        The form whose surface is meant, where the elements are its material. Default: `inside`.
    """

    def __init__(
        self,
        inside: np.ndarray,
        marks: Mapping[str, np.ndarray] | None = None,
        edges: Sequence[float] = (1.0, 1.0, 1.0),
        form: np.ndarray | None = None,
    ) -> None:
        self.inside, self.marks = inside, dict(marks or {})
        self.form = inside if form is None else form
        self.edges = tuple(float(edge) for edge in edges)
        self.present = at_corners(inside)
        self._normals: np.ndarray | None = None

    def pick(self, box: Box, place: Place) -> np.ndarray:
        """Return the nodes of the part in a box and at a place, (Z + 1, Y + 1, X + 1) bool.

        Raises
        ------
        InputError
            A painted mesh that was not given.
        """
        found = nodes_of(box, self.inside.shape) & self.present
        if place.normal is not None:
            wanted = np.array(place.normal) / np.linalg.norm(place.normal)
            outward = self._outward()
            found &= outward.any(axis=-1)
            found &= outward @ wanted >= math.cos(math.radians(place.within)) - 1e-12
        if place.through is not None and place.across is not None:
            found &= self._on_plane(np.array(place.through), np.array(place.across))
        if place.mesh is not None:
            if place.mesh not in self.marks:
                raise InputError(
                    f"the case names the mesh {place.mesh!r}, which was not given: pass its "
                    "elements as marks, or use trabecula field simp with --mask"
                )
            found &= at_corners(self.marks[place.mesh])
        return found

    def _on_plane(self, through: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the nodes within half an element of a plane."""
        sides = np.array(self.inside.shape)
        unit = across / np.linalg.norm(across)
        lines = [
            (np.arange(side + 1) - at * side) * edge * part
            for side, at, edge, part in zip(sides, through, self.edges, unit, strict=True)
        ]
        far = sum(np.ix_(*lines))
        return np.asarray(np.abs(far) <= 0.5 * float(np.abs(unit) @ np.array(self.edges)) + 1e-9)

    def _outward(self) -> np.ndarray:
        """Return the unit normals of the surface at its nodes, 0 elsewhere."""
        if self._normals is None:
            padded = np.pad(self.form, 3).astype(np.float32)
            level = gaussian(padded, _SMOOTH)
            between = tuple(side - 1 for side in level.shape)
            slopes = [
                sum(sign * level[corner_nodes(corner, between)] for corner, sign in _signs(axis))
                / edge
                for axis, edge in enumerate(self.edges)
            ]
            normals = -np.stack(slopes, axis=-1)[2:-2, 2:-2, 2:-2].astype(np.float64)
            length = np.linalg.norm(normals, axis=-1)
            rim = at_corners(self.form) & at_corners(~np.pad(self.form, 1))[1:-1, 1:-1, 1:-1]
            known = rim & (length > 0)
            self._normals = np.where(
                known[..., None], normals / np.maximum(length, 1e-30)[..., None], 0
            )
        return self._normals

    def elements(self, box: Box, place: Place, depth: int) -> np.ndarray:
        """Return the elements of the part in a box, or `depth` layers below a place, (Z, Y, X)
        bool.
        """
        middles = [(np.arange(side) + 0.5) / side for side in self.inside.shape]
        lines = [
            (middle >= low - 1e-9) & (middle <= high + 1e-9)
            for middle, (low, high) in zip(middles, box, strict=True)
        ]
        found = lines[0][:, None, None] & lines[1][None, :, None] & lines[2][None, None, :]
        if place != ALL:
            layer = elements_at(self.pick(EVERYWHERE, place))
            for _ in range(depth - 1):
                layer = elements_at(at_corners(layer))
            found = found & layer
        elif not found.any():  # a face, an edge or a corner
            found = elements_at(nodes_of(box, self.inside.shape))
        return np.asarray(found & self.inside)


def at_corners(elements: np.ndarray) -> np.ndarray:
    """Return the nodes at the corners of elements, (Z + 1, Y + 1, X + 1) bool."""
    found = np.zeros(tuple(side + 1 for side in elements.shape), bool)
    for corner in np.ndindex(2, 2, 2):
        found[corner_nodes(corner, elements.shape)] |= elements
    return found


def elements_at(nodes: np.ndarray) -> np.ndarray:
    """Return the elements that have a marked corner, (Z, Y, X) bool."""
    shape = tuple(side - 1 for side in nodes.shape)
    corners = [nodes[corner_nodes(corner, shape)] for corner in np.ndindex(2, 2, 2)]
    return np.asarray(np.logical_or.reduce(corners))


def corner_nodes(corner: Sequence[int] | np.ndarray, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the nodes at one corner of every element of a grid of `shape`."""
    return tuple(slice(c, c + side) for c, side in zip(corner, shape, strict=True))


def _signs(axis: int) -> list[tuple[tuple[int, ...], int]]:
    return [(corner, 2 * corner[axis] - 1) for corner in np.ndindex(2, 2, 2)]

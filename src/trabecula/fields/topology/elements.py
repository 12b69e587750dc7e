"""A grid of elements with supports and loads, and the product of its stiffness with displacements.

No matrix is stored: it is one brick's stiffness times every element's density. Forces and
displacements are (Z + 1, Y + 1, X + 1, 3) at the nodes, densities (Z, Y, X) at the elements; 0 is
no element.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.fields.topology.cases import Case, Load
from trabecula.fields.topology.places import PartNodes, corner_nodes
from trabecula.measure.mechanics.elements import CORNERS, brick_stiffness, isotropic

_ROUND = 2.0**40


@dataclass(frozen=True)
class ElementGrid:
    """A grid of elements with its supports and loads."""

    stiffness: np.ndarray
    """(24, 24): of one element at density 1; corner c is 4 dz + 2 dy + dx, each with z, y, x."""
    inside: np.ndarray
    """(Z, Y, X) bool."""
    free: np.ndarray
    """(Z + 1, Y + 1, X + 1, 3) bool: may move."""
    load: np.ndarray
    """The same shape: force, 0 where it is held."""

    @classmethod
    def of(
        cls,
        case: Case,
        inside: np.ndarray | PartNodes,
        *,
        edges: tuple[float, ...],
        poisson: float,
    ) -> ElementGrid:
        """Set a case on a grid whose elements are `inside`, with the first of its loads that act
        alone; edges are those of an element.
        """
        part = inside if isinstance(inside, PartNodes) else PartNodes(inside, edges=edges)
        blocks = brick_stiffness(isotropic(1.0, poisson), edges)
        # Rounded, since the last bit of a matrix product depends on the machine.
        stiffness = np.rint(blocks.transpose(0, 2, 1, 3).reshape(24, 24) * _ROUND) / _ROUND
        free = np.repeat(part.present[..., None], 3, axis=-1)
        for support in case.supports:
            held = part.pick(support.box, support.place)
            for axis in support.axes:
                free[held, "zyx".index(axis)] = False
        load = _forces(case.alone[0].loads, part, free, case.name)
        if free[part.present].all():
            raise InputError(
                f"case {case.name!r} holds no element: give supports that meet the part"
            )
        _check_held(part.present[..., None] & ~free, load, edges, case.name)
        return cls(stiffness, part.inside, free, load)

    def loaded(self, case: Case, part: PartNodes) -> list[tuple[float, ElementGrid]]:
        """Return the weight of every load case, and the grid with its loads."""
        first, *others = case.alone
        return [
            (first.weight, self),
            *(
                (one.weight, replace(self, load=_forces(one.loads, part, self.free, case.name)))
                for one in others
            ),
        ]

    def product(self, density: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the forces of displacements, 0 where a node is held."""
        force = np.zeros_like(u)
        # layers of one parity share no nodes: sums have one order for any threads
        for parity in (0, 1):
            layers = partial(_apply_layers, self.stiffness, density, u, force, parity)
            for_slabs(layers, (len(density) + 1) // 2, least=2)
        force[~self.free] = 0
        return force

    def diagonal(self, density: np.ndarray) -> np.ndarray:
        """Return the diagonal of the stiffness; 1 where a node is held."""
        own = np.diag(self.stiffness).reshape(8, 3)
        found = np.zeros_like(self.load)
        for corner, stiff in zip(CORNERS, own, strict=True):
            found[corner_nodes(corner, density.shape)] += density[..., None] * stiff
        return np.where(self.free, found, 1.0)

    def energy(self, u: np.ndarray) -> np.ndarray:
        """Return u K u of every element at density 1, (Z, Y, X)."""
        found = np.empty(self.inside.shape)
        for_slabs(partial(_energies, self.stiffness, self.inside, u, found), len(found), least=2)
        return found


def _forces(loads: tuple[Load, ...], part: PartNodes, free: np.ndarray, name: str) -> np.ndarray:
    """Return the forces at the nodes; 0 where a node is held."""
    force = np.zeros(free.shape)
    for push in loads:
        pushed = part.pick(push.box, push.place)
        if not pushed.any():
            raise InputError(
                f"the load at {push.box} meets no element: move it onto the part, or widen its "
                "place"
            )
        force[pushed] += np.array(push.force) / np.count_nonzero(pushed)
    force[~free] = 0
    if not force.any():
        raise InputError(
            f"case {name!r} pushes nothing that can move: give a load away from the supports"
        )
    return force


@inline
def _collect(u, z, y, x, local):
    """Collect the 24 displacements of an element's corners, by corner 4 dz + 2 dy + dx."""
    for c in range(8):
        node = u[z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)]
        for i in range(3):
            local[3 * c + i] = node[i]


@inline
def _push(stiffness, local, force):
    """Set force = stiffness @ local, by columns: LLVM reorders no sum, but does rows side by
    side.
    """
    force[:] = 0.0
    for column in range(24):
        value = local[column]
        row = stiffness[column]  # symmetric
        for k in range(24):
            force[k] += row[k] * value


@kernel
def _apply_layers(stiffness, density, u, force, parity, start, stop):
    """Add K u of the layers 2 k + parity with start <= k < stop, which share no nodes
    with each other.
    """
    depth, height, width = density.shape
    local, pushed = np.empty(24), np.empty(24)
    for k in range(start, stop):
        z = 2 * k + parity
        if z >= depth:
            continue
        for y in range(height):
            for x in range(width):
                rho = density[z, y, x]
                if rho == 0.0:
                    continue
                _collect(u, z, y, x, local)
                _push(stiffness, local, pushed)
                for c in range(8):
                    node = force[z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)]
                    for i in range(3):
                        node[i] += rho * pushed[3 * c + i]


@kernel
def _energies(stiffness, inside, u, energy, start, stop):
    """Write u K u of every element at density 1."""
    _, height, width = inside.shape
    local, pushed = np.empty(24), np.empty(24)
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                total = 0.0
                if inside[z, y, x]:
                    _collect(u, z, y, x, local)
                    _push(stiffness, local, pushed)
                    for k in range(24):
                        total += local[k] * pushed[k]
                energy[z, y, x] = total


@kernel
def dot(a, b):
    """Return the inner product of two flat arrays, summed in order."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


_IDLE = 1e-6  # share of the loads that no support takes up


def _check_held(held: np.ndarray, load: np.ndarray, edges: Sequence[float], name: str) -> None:
    """Raise where a load moves the part as a whole, since no support holds it that way.

    A rigid motion is t + w x p. Those that leave every held component where it is are the kernel of
    the sum of r r^T over held components, with r the motion's six numbers there.
    """
    middle = (np.array(held.shape[:3]) - 1) / 2 * edges
    size = float(np.max(np.array(held.shape[:3]) * edges))
    gram, forces = np.zeros((6, 6)), np.zeros(6)
    for axis in range(3):
        nodes = np.argwhere(held[..., axis])
        rows = _rigid_rows((nodes * edges - middle) / size, axis)
        gram += rows.T @ rows
        nodes = np.argwhere(load[..., axis])
        rows = _rigid_rows((nodes * edges - middle) / size, axis)
        forces += load[(*nodes.T, axis)] @ rows
    values, modes = np.linalg.eigh(gram)
    loose = modes[:, values < 1e-9 * values[-1]]
    motion = loose @ (loose.T @ forces)
    if np.abs(motion).max() <= _IDLE * np.abs(forces).max():
        return
    which = int(np.abs(motion).argmax())
    how = f"moving along {'zyx'[which]}" if which < 3 else f"turning about {'zyx'[which - 3]}"
    raise InputError(
        f"case {name!r} does not hold the part: nothing keeps its loads from {how}; give supports "
        "farther apart, or that hold more axes"
    )


def _rigid_rows(places: np.ndarray, axis: int) -> np.ndarray:
    """Return what the six rigid motions do to a component of the displacement at places (N, 3)."""
    rows = np.zeros((len(places), 6))
    rows[:, axis] = 1
    for turn in range(3):
        first, second = (turn + 1) % 3, (turn + 2) % 3
        if axis == first:
            rows[:, 3 + turn] = -places[:, second]
        elif axis == second:
            rows[:, 3 + turn] = places[:, first]
    return rows

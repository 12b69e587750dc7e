"""A part as a grid of elements with supports and loads, and what its densities do to displacements:
no matrix is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.parallel import for_slabs
from trabecula.fields.topology.cases import Case, nodes_of
from trabecula.fields.topology.kernels import apply_layers, energies
from trabecula.measure.mechanics.elements import CORNERS, brick_stiffness, isotropic

_ROUND = 2.0**40


@dataclass(frozen=True)
class Part:
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
        cls, case: Case, inside: np.ndarray, *, edges: tuple[float, ...], poisson: float
    ) -> Part:
        """A case on a grid whose elements are `inside`; edges are those of an element."""
        blocks = brick_stiffness(isotropic(1.0, poisson), edges)
        # Rounded, since the last bit of a matrix product depends on the machine.
        stiffness = np.rint(blocks.transpose(0, 2, 1, 3).reshape(24, 24) * _ROUND) / _ROUND
        nodes = tuple(side + 1 for side in inside.shape)
        present = np.zeros(nodes, bool)
        for corner in CORNERS:
            present[
                tuple(slice(c, c + side) for c, side in zip(corner, inside.shape, strict=True))
            ] |= inside
        free = np.repeat(present[..., None], 3, axis=-1)
        load = np.zeros((*nodes, 3))
        for support in case.supports:
            held = nodes_of(support.box, inside.shape)
            for axis in support.axes:
                free[held, "zyx".index(axis)] = False
        for push in case.loads:
            pushed = nodes_of(push.box, inside.shape) & present
            if not pushed.any():
                raise InputError(f"the load at {push.box} meets no element: move it onto the part")
            load[pushed] += np.array(push.force) / np.count_nonzero(pushed)
        load[~free] = 0
        if not load.any():
            raise InputError(
                f"case {case.name!r} pushes nothing that can move: give a load away from the supports"
            )
        if free[present].all():
            raise InputError(
                f"case {case.name!r} holds no element: give supports that meet the part"
            )
        return cls(stiffness, inside, free, load)

    def product(self, density: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Forces of displacements, 0 where a node is held."""
        force = np.zeros_like(u)
        # layers of one parity share no nodes: sums have one order for any threads
        for parity in (0, 1):
            for_slabs(
                lambda a, b, p=parity: apply_layers(self.stiffness, density, u, force, p, a, b),  # type: ignore[misc]
                (len(density) + 1) // 2,
                least=2,
            )
        force[~self.free] = 0
        return force

    def diagonal(self, density: np.ndarray) -> np.ndarray:
        """Of the stiffness; 1 where a node is held."""
        own = np.diag(self.stiffness).reshape(8, 3)
        found = np.zeros_like(self.load)
        for corner, stiff in zip(CORNERS, own, strict=True):
            at = tuple(slice(c, c + side) for c, side in zip(corner, density.shape, strict=True))
            found[at] += density[..., None] * stiff
        return np.where(self.free, found, 1.0)

    def energy(self, u: np.ndarray) -> np.ndarray:
        """(Z, Y, X): u K u of every element at density 1."""
        found = np.empty(self.inside.shape)
        for_slabs(
            lambda a, b: energies(self.stiffness, self.inside, u, found, a, b), len(found), least=2
        )
        return found

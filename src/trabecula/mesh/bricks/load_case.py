"""Load cases of finite elements: which nodes move, which are held, which move alike.

Degrees of freedom are 1 (x), 2 (y), 3 (z). What is held beside the load removes rigid motions and
nothing else: its reactions are zero.

- compression: the lower face along an axis is held along it, the upper one moves towards it by the
  strain; both slide, and the sides are free. E = force / (area strain).
- shear: the lower face is held, the upper one moves sideways as a whole, along the first other
  axis of x, y, z. G is a little less than that of the material, for the sides are free.
- periodic: opposite faces move alike but for the periods of the mean displacement gradient (Suquet
  1987), one reference node an axis: U_j = H L_j. The reference node of an axis is pulled, and all
  other mean stresses are zero, so E = stress side / displacement is exactly the material's, as in
  `measure.stiffness`. A force, not a displacement: CalculiX gives no reaction of a node that
  belongs to no element.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.mesh.bricks.faces import AXES, FaceNodes, NodePairs, pair_nodes
from trabecula.mesh.bricks.grid import BrickGrid
from trabecula.mesh.bricks.selection import Bearing, BrickComponent

DOF = {"x": 1, "y": 2, "z": 3}


@dataclass(frozen=True)
class Held:
    """A prescribed displacement: of a node by its number from 0, or of a named set."""

    where: int | str
    dof: int
    value: float = 0.0


@dataclass(frozen=True, eq=False)
class LoadCase:
    """A load case, ready to be written.

    Attributes
    ----------
    name, axis : str
    held : tuple of Held
    loaded : str
        Set of nodes whose reaction force is the load, or which the load pulls.
    dof : int
        Along which the load acts.
    extension : float
        Displacement of the loaded nodes, in the unit of length; of the periodic case what the
        solid alone would have.
    pull : float
        Force on the loaded node, of the periodic case.
    pairs : NodePairs, optional
        Of the periodic case.
    references : tuple of str
        Sets of its reference nodes, of x, y and z.
    """

    name: str
    axis: str
    held: tuple[Held, ...]
    loaded: str
    dof: int
    extension: float
    pull: float = 0.0
    pairs: NodePairs | None = None
    references: tuple[str, ...] = ()


def reference_name(axis: str) -> str:
    """Return the name of the set of the reference node of an axis."""
    return f"REF_{axis.upper()}"


def build_case(
    name: str, bearing: Bearing, faces: FaceNodes, *, axis: int, strain: float, young: float
) -> LoadCase:
    """Build a load case.

    Parameters
    ----------
    name : {"compression", "shear", "periodic"}
    bearing : Bearing
    faces : FaceNodes
    axis : int
        0 is z: along which it is compressed or stretched; of shear the normal of the faces.
    strain : float
    young : float
        Young's modulus of the stiffest phase: the mean stress of the periodic case is `strain`
        times that.

    Raises
    ------
    InputError
        Periods that no axis has alone, which would leave the reference nodes undetermined.
    """
    grid, letter = bearing.grid, AXES[axis]
    side = grid.volume.shape[axis] * grid.volume.spacing[axis]
    others = [other for other in "xyz" if other != letter]
    low, high = f"{letter}_low", f"{letter}_high"
    if name == "shear":
        moved = others[0]
        held = [Held(low, dof) for dof in DOF.values()]
        held += [Held(high, DOF[other], 0.0) for other in "xyz" if other != moved]
        held.append(Held(high, DOF[moved], strain * side))
        return LoadCase(name, letter, tuple(held), high, DOF[moved], strain * side)
    if name == "compression":
        held = [Held(low, DOF[letter]), Held(high, DOF[letter], -strain * side)]
        for component in bearing.components:
            held += _hold_sliding(grid, component, others)
        return LoadCase(name, letter, tuple(held), high, DOF[letter], -strain * side)
    sides = np.array(grid.volume.shape) * grid.volume.spacing
    area = float(np.prod(np.delete(sides, axis)))
    pairs = pair_nodes(faces)
    held = _hold_references(bearing, letter, others)
    for component in bearing.components:
        held += _hold_periodic(grid, component, set(pairs.nodes.tolist()))
    names = tuple(reference_name(other) for other in "xyz")
    return LoadCase(
        name,
        letter,
        tuple(held),
        reference_name(letter),
        DOF[letter],
        strain * side,
        strain * young * area,
        pairs,
        names,
    )


def _hold_sliding(grid: BrickGrid, component: BrickComponent, others: Sequence[str]) -> list[Held]:
    """Hold a component between two faces that slide: two shifts and one turn."""
    b, c = others
    along = AXES.index(b)
    first, last = _far_corners(component, along)
    p, q = numbers_at(grid, [first, last])
    return [Held(p, DOF[b]), Held(p, DOF[c]), Held(q, DOF[c])]


def _hold_periodic(grid: BrickGrid, component: BrickComponent, dependent: set[int]) -> list[Held]:
    """Hold a component that repeats: three shifts; one turn where it repeats along one direction
    alone.
    """
    places = [tuple(voxel + corner) for voxel in component.ends[0] for corner in _CORNER_STEPS]
    near = numbers_at(grid, places)
    free = [number for number in near if number not in dependent]
    if not free:  # all on faces: their partners are as good
        raise InputError(
            "a part of the periodic volume is one voxel small: prune it (finish --prune), or "
            "choose --case compression"
        )
    held = [Held(free[0], dof) for dof in DOF.values()]
    if np.linalg.matrix_rank(component.periods) > 1:
        return held
    along = int(np.argmax(np.abs(component.periods).sum(axis=0)))
    b, c = (axis for axis in range(3) if axis != along)
    p, q = _far_corners(component, b)
    start = places[near.index(free[0])]
    last = max((p, q), key=lambda corner: abs(corner[b] - start[b]))
    (number,) = numbers_at(grid, [last])
    if number in dependent:
        number = next(n for n in free[1:] if n != free[0])
    return [*held, Held(number, DOF[AXES[c]])]


_CORNER_STEPS = [np.array((k, j, i)) for k in (0, 1) for j in (0, 1) for i in (0, 1)]


def _far_corners(component: BrickComponent, axis: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return two corners of a component, the lowest and the highest along an axis."""
    low, high = component.ends[axis]
    last = high.copy()
    last[axis] += 1
    return tuple(low.tolist()), tuple(last.tolist())


def _hold_references(bearing: Bearing, letter: str, others: Sequence[str]) -> list[Held]:
    """Hold the reference nodes: no mean rotation, and whatever no
    component repeats along; what is left free has no mean stress.
    """
    periods = np.concatenate([component.periods for component in bearing.components])
    wraps = {name: bool(periods[:, AXES.index(name)].any()) for name in AXES}
    if np.linalg.matrix_rank(periods) < sum(wraps.values()):
        raise InputError(
            "the periodic volume repeats along an oblique direction alone, which this load case "
            "does not hold: choose --case compression"
        )
    b, c = others
    held = [Held(reference_name(letter), DOF[other]) for other in others]
    for name, other in ((b, c), (c, b)):
        if not wraps[name]:
            held += [Held(reference_name(name), dof) for dof in DOF.values()]
        elif name == b or not wraps[b]:
            held.append(Held(reference_name(name), DOF[other]))
    return held


def numbers_at(grid: BrickGrid, corners: Sequence[tuple[int, ...]]) -> list[int]:
    """Return the numbers of the nodes at corners (z, y, x) of the grid; -1 where none is."""
    wanted: dict[int, list[int]] = {}
    for place, corner in enumerate(corners):
        wanted.setdefault(int(corner[0]), []).append(place)
    found = [-1] * len(corners)
    for k, numbers in grid.node_layers():
        for place in wanted.get(k, []):
            found[place] = int(numbers[corners[place][1], corners[place][2]])
    return found

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
from itertools import combinations

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
    partner = dict(zip(pairs.nodes.tolist(), pairs.partners.tolist(), strict=True))
    held = _hold_references(bearing, letter, others)
    for component in bearing.components:
        held += _hold_periodic(grid, component, partner)
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


def _hold_periodic(
    grid: BrickGrid, component: BrickComponent, partner: dict[int, int]
) -> list[Held]:
    """Hold a component that repeats: three shifts; one turn where it repeats along one direction
    alone. Both nodes are of one brick, since between far ones a face may lie.
    """
    along = int(np.argmax(np.abs(component.periods).sum(axis=0)))
    b, c = (axis for axis in range(3) if axis != along)
    corner = component.ends[0, 0]
    beside = corner.copy()
    beside[b] += 1
    p, q = (partner.get(n, n) for n in numbers_at(grid, [tuple(corner), tuple(beside)]))
    held = [Held(p, dof) for dof in DOF.values()]
    turns = np.linalg.matrix_rank(component.periods) == 1
    return [*held, Held(q, DOF[AXES[c]])] if turns else held


def _far_corners(component: BrickComponent, axis: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return two corners of a component, the lowest and the highest along an axis."""
    low, high = component.ends[axis]
    last = high.copy()
    last[axis] += 1
    return tuple(low.tolist()), tuple(last.tolist())


def _hold_references(bearing: Bearing, letter: str, others: Sequence[str]) -> list[Held]:
    """Hold the reference nodes: no mean rotation in the plane of two axes, no shear there unless a
    component repeats along both, and nothing along axes that none repeats along.
    """
    periods = [component.periods for component in bearing.components]
    wraps = {name: any(gaps[:, AXES.index(name)].any() for gaps in periods) for name in AXES}
    if np.linalg.matrix_rank(np.concatenate(periods)) < sum(wraps.values()):
        raise InputError(
            "the periodic volume repeats along an oblique direction alone, which this load case "
            "does not hold: choose --case compression"
        )
    order = (letter, *others)
    held = [
        Held(reference_name(name), dof) for name in order if not wraps[name] for dof in DOF.values()
    ]
    for first, second in combinations(order, 2):
        both = [AXES.index(first), AXES.index(second)]
        joint = any(np.linalg.matrix_rank(gaps[:, both]) == 2 for gaps in periods)
        if wraps[first]:
            held.append(Held(reference_name(first), DOF[second]))
        if wraps[second] and not (wraps[first] and joint):
            held.append(Held(reference_name(second), DOF[first]))
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

"""Effective stiffness of a periodic box, by finite elements on its voxels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, check_name, check_type, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, with_values
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import one_blas_thread
from trabecula.engine.rows import add_block
from trabecula.measure.centre_crop import box_sides, centre, centre_box, check_memory
from trabecula.measure.mechanics.elements import brick_stiffness, isotropic, mean_strain
from trabecula.measure.mechanics.lattice import LOADS, Cells, node_mask, voxel_cells
from trabecula.measure.mechanics.solve import Solution, build_levels, solve
from trabecula.measure.percolation import wrapping_voxels
from trabecula.measure.phases import indicator

VOIGT = ("xx", "yy", "zz", "yz", "xz", "xy")
_MOST_ITERATIONS = 500
_HALVED_SIDE = 40

# Resident memory at the peak, from 40 and 64 voxels an edge, 15 to 85 % solid; separate columns of
# one voxel take 2500.
_NODE_BYTES, _GRID_BYTES = 2000, 20

Moduli = tuple[float, float] | Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Stiffness:
    """Effective stiffness, in the unit of the Young's moduli given."""

    matrix: np.ndarray
    """(6, 6), Voigt order xx, yy, zz, yz, xz, xy, engineering shear strains."""
    moduli: dict[str, float]
    """Apparent Young's modulus along each axis, "z", "y", "x": stress over strain with the sides
    free to move.
    """
    shear: dict[str, float]
    """Apparent shear modulus in each plane, "yz", "xz", "xy"."""
    converged: bool
    """Whether the tolerance was reached for all six load cases."""
    imbalance: float
    """Largest deviation of the mean stress in one layer of voxels from that of all layers, over the
    largest stiffness. Stress normal to a layer is equal in all of them where forces balance; 0 is
    exact."""
    iterations: int
    bearing: float
    """Share of the solid that can carry load: the rest is not connected with itself across
    the faces.
    """
    halving: float | None = None
    """Relative change of the mean diagonal where every voxel of a centre box is split in eight
    (with the same materials); None unless requested."""

    __repr__ = brief


def stiffness(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    moduli: Moduli = (1.0, 0.3),
    tolerance: float = 1e-3,
    box: int | Sequence[int] | None = None,
    halving: bool = False,
) -> Stiffness:
    """Measure the effective elastic stiffness of a material, void being void.

    The image is repeated periodically, and the fluctuation of the displacement is periodic; every
    voxel of solid is a trilinear brick (Garboczi and Day 1995, doi:10.1016/0022-5096(95)00050-S;
    for bone van Rietbergen et al. 1995, doi:10.1016/0021-9290(95)80008-5). Six unit strains are
    applied; column j of the matrix is the mean stress for strain j. A scan's faces do not fit each
    other, so what they cut there counts as cut, and small boxes come out too soft. Parts that no
    path through voxel faces connects with themselves across the faces carry nothing and are left
    out. Zero where nothing percolates.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
        Axes are (z, y, x); the matrix is in the order xx, yy, zz, yz, xz, xy. Any spacing.
    phase : str or int, optional
        The phase that `moduli` is of. Default: "solid", which is every phase but "void".
    moduli : (E, nu), or mapping from the name of a phase to (E, nu)
        Young's modulus (any unit, > 0) and Poisson's ratio (-0.99 .. 0.49). Phases that a mapping
        leaves out are void.
    tolerance : float
        Error of the displacements in the energy norm over that of the whole field, 1e-10 .. 0.1,
        estimated. The diagonal of the matrix errs by about its square, the rest by up to
        itself.
    box : int or (Z, Y, X), optional
        Only the centre box of this many voxels. Default: the whole image.
    halving : bool
        Measure also what halving the voxels changes, on a centre box of at most 40 voxels a side.
        Bricks bend too stiffly where a strut is one or two voxels thick; this says how much that
        matters here.

    Returns
    -------
    stiffness : Stiffness

    Raises
    ------
    InputError
        2-D, moduli out of range, no such phase, a tolerance or box out of range.
    MemoryBudgetError
        More memory would be needed than there is: give a smaller `box`.

    Notes
    -----
    Conjugate gradients with a multigrid preconditioner. 1.5 kB of memory per voxel of a compact
    solid, 2 to
    3.5 kB of struts a few voxels thick, checked before anything is solved. The result does not
    depend on the number of threads.

    Examples
    --------
    >>> result = stiffness(np.ones((4, 4, 4), np.uint8), moduli=(10.0, 0.25))
    >>> round(result.moduli["z"], 6), round(float(result.matrix[3, 3]), 6)
    (10.0, 4.0)
    """
    image = as_image(image)
    check_labels(image)
    if image.ndim != 3:
        raise InputError(
            "stiffness is of a volume and the image is 2-D: stack slices to one (np.stack), or "
            "synthesise a volume"
        )
    as_number(tolerance, name="tolerance", low=1e-10, high=0.1)
    check_type(halving, bool, name="halving", advice="give True or False")
    inside = with_values(image, centre(image.values, box_sides(box, image.shape)))
    kind, materials = _materials(inside, phase, moduli)
    check_memory(forecast_bytes(kind >= 0, halving=halving))
    # Lengths cancel; edges near 1 keep the numbers near that of the moduli.
    edges = tuple(edge / min(image.spacing) for edge in image.spacing)
    result = _stiffness(kind, materials, edges, tolerance)
    if not halving:
        return result
    small = centre_box(kind, _HALVED_SIDE)
    coarse = result if small.shape == kind.shape else _stiffness(small, materials, edges, tolerance)
    split = small.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
    fine = _stiffness(split, materials, edges, tolerance)
    before, after = np.trace(coarse.matrix), np.trace(fine.matrix)
    return replace(result, halving=float((after - before) / before) if before else 0.0)


def _materials(
    image: Image, phase: str | int | None, moduli: Moduli
) -> tuple[np.ndarray, np.ndarray]:
    """Return for every voxel the index of its material, -1 for void; and the materials, (n, 6,
    6).
    """
    if not isinstance(moduli, Mapping):
        _, inside = indicator(image, phase)
        return np.where(inside, 0, -1).astype(np.int8), _material(moduli, "moduli")[None]
    if phase is not None:
        raise InputError("give either a phase, or moduli by phase: not both")
    table = np.full(len(image.phases), -1, np.int8)
    for index, name in enumerate(moduli):
        check_name(name, image.phases, name="phase")
        table[image.phases.index(name)] = index
    if not moduli:
        raise InputError(
            "moduli is empty: give (E, nu), or (E, nu) for the name of a phase at least"
        )
    return table[image.values], np.stack(
        [_material(pair, f"moduli of {name}") for name, pair in moduli.items()]
    )


def _material(pair: Sequence[float], name: str) -> np.ndarray:
    if isinstance(pair, str) or np.shape(pair) != (2,):
        raise InputError(
            f"{name} is {quote(pair)}: two numbers are needed, Young's modulus and Poisson's ratio"
        )
    young = as_number(pair[0], name=f"Young's modulus ({name})", low=1e-30, high=1e30)
    return isotropic(
        young, as_number(pair[1], name=f"Poisson's ratio ({name})", low=-0.99, high=0.49)
    )


def forecast_bytes(solid: np.ndarray, *, halving: bool = False) -> int:
    """Forecast the bytes that solving for the stiffness of a solid (Z, Y, X) takes beyond it; with
    `halving` those of the larger solve.
    """

    def one(part: np.ndarray, nodes: int) -> int:
        return nodes * _NODE_BYTES + part.size * _GRID_BYTES

    whole = one(solid, int(np.count_nonzero(node_mask(solid))))
    if not halving:
        return whole
    small = centre_box(solid, _HALVED_SIDE)
    # Eight voxels for every one, and not even that many nodes for every node.
    return max(whole, 8 * one(small, int(np.count_nonzero(node_mask(small)))))


def _stiffness(
    kind: np.ndarray, materials: np.ndarray, edges: tuple[float, ...], tolerance: float
) -> Stiffness:
    solid = np.count_nonzero(kind >= 0)
    kind = np.where(wrapping_voxels(kind >= 0), kind, -1)
    bearing = np.count_nonzero(kind >= 0)
    if not bearing:
        return _result(np.zeros((6, 6)), True, 0.0, 0, 0.0)
    cells = voxel_cells(
        kind, np.stack([brick_stiffness(material, edges) for material in materials]), edges
    )
    strain = mean_strain(edges)
    volume = math.prod(edges)
    whole = volume * np.tensordot(np.bincount(cells.kind, minlength=len(materials)), materials, 1)
    with one_blas_thread():
        load = np.zeros((cells.count, 3, LOADS))
        pull = -volume * np.einsum("ick,mij->mckj", strain, materials)
        _add_loads(cells.nodes, cells.kind, np.ascontiguousarray(pull), load)
        solution = solve(
            build_levels(cells),
            load,
            whole=whole.diagonal(),
            tolerance=tolerance,
            most_iterations=_MOST_ITERATIONS,
        )
    matrix, imbalance = _mean_stress(cells, materials, strain, solution, kind.shape)
    return _result(matrix, solution.converged, imbalance, solution.iterations, bearing / solid)


def _mean_stress(
    cells: Cells,
    materials: np.ndarray,
    strain: np.ndarray,
    solution: Solution,
    shape: tuple[int, ...],
) -> tuple[np.ndarray, float]:
    """Return the stiffness, and the largest difference of the stress of a single layer from it."""
    layers = np.zeros((3, max(shape), 6, LOADS))
    _sum_stress(
        cells.nodes, cells.kind, cells.position, materials, strain, solution.displacement, layers
    )
    matrix = layers[0].sum(axis=0) / math.prod(shape)
    size = float(np.abs(matrix).max())
    imbalance = 0.0
    # stress components on a plane across z, y, x
    for axis, crossing in enumerate(((2, 3, 4), (1, 3, 5), (0, 4, 5))):
        section = layers[axis, : shape[axis]] * shape[axis] / math.prod(shape)
        imbalance = max(imbalance, float(np.abs(section - matrix)[:, crossing].max()) / size)
    return (matrix + matrix.T) / 2, imbalance


def _result(
    matrix: np.ndarray, converged: bool, imbalance: float, iterations: int, bearing: float
) -> Stiffness:
    size = float(np.abs(matrix).max())
    # Where nothing resists, the compliance is infinite: a little added stiffness makes it large,
    # and its inverse 0.
    compliance = np.linalg.inv(matrix + 1e-9 * (size or 1.0) * np.eye(6)).diagonal()
    apparent = [float(1 / value) if value < 1e6 / (size or 1.0) else 0.0 for value in compliance]
    if not size:
        apparent = [0.0] * 6
    named = dict(zip(VOIGT, apparent, strict=True))
    young = {axis: named[axis * 2] for axis in "zyx"}
    return Stiffness(
        matrix,
        young,
        {plane: named[plane] for plane in VOIGT[3:]},
        converged,
        imbalance,
        iterations,
        bearing,
    )


@kernel
def _add_loads(nodes, kind, pull, load):
    for cell in range(len(nodes)):
        for c in range(8):
            add_block(load[nodes[cell, c]], pull[kind[cell], c])


@kernel
def _sum_stress(nodes, kind, position, materials, strain, u, layers):
    """Add the stress of every cell for every load case to layers[axis, layer]."""
    e = np.zeros((6, LOADS))
    s = np.zeros((6, LOADS))
    for cell in range(len(nodes)):
        for i in range(6):
            for j in range(LOADS):
                e[i, j] = 1.0 if i == j else 0.0
        for c in range(8):
            v = u[nodes[cell, c]]
            for i in range(6):
                for k in range(3):
                    b = strain[i, c, k]
                    if b != 0.0:
                        for j in range(LOADS):
                            e[i, j] += b * v[k, j]
        d = materials[kind[cell]]
        for i in range(6):
            for j in range(LOADS):
                total = 0.0
                for k in range(6):
                    total += d[i, k] * e[k, j]
                s[i, j] = total
        for axis in range(3):
            add_block(layers[axis, position[cell, axis]], s)

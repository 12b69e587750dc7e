"""What CalculiX and OpenFOAM solve comes back onto the voxels (`make test-solvers`)."""

import math
import re
import shutil

import numpy as np
import pytest
from test_other_solvers import bone, ccx, field, foam, run

import trabecula as tb
from trabecula.fields import import_result
from trabecula.measure.mechanics import homogenise, lattice
from trabecula.measure.mechanics import solve as elastic
from trabecula.measure.mechanics.elements import brick_stiffness, mean_strain
from trabecula.mesh.bricks.export import export_bricks

MODULI = (17e3, 0.3)


def own_fields(material, axis, stress):
    """Solve with this package; return places of the bricks, their stress by name, and the
    displacement (z, y, x) of their middles, for a mean stress along an axis.
    """
    kind, materials = homogenise._materials(material, None, MODULI)
    edges = tuple(edge / min(material.spacing) for edge in material.spacing)
    kind = np.where(homogenise.wrapping_voxels(kind >= 0), kind, -1)
    bricks = np.stack([brick_stiffness(one, edges) for one in materials])
    cells = lattice.voxel_cells(kind, bricks, edges)
    strain, volume = mean_strain(edges), math.prod(edges)
    load = np.zeros((cells.count, 3, 6))
    pull = np.ascontiguousarray(-volume * np.einsum("ick,mij->mckj", strain, materials))
    homogenise._add_loads(cells.nodes, cells.kind, pull, load)
    whole = volume * np.tensordot(np.bincount(cells.kind), materials, 1).diagonal()
    given = {"tolerance": 1e-6, "most_iterations": 2000}
    solution = elastic.solve(elastic.build_levels(cells), load, whole=whole, **given)
    matrix, _ = homogenise._mean_stress(cells, materials, strain, solution, kind.shape)
    names = homogenise.VOIGT
    mean = np.linalg.solve(matrix, [stress if name == axis * 2 else 0.0 for name in names])
    moves = solution.displacement @ mean
    local = mean + np.einsum("ick,mck->mi", strain, moves[cells.nodes])
    stresses = np.einsum("mij,mj->mi", materials[cells.kind], local)
    gradient = np.zeros((3, 3))
    for value, name in zip(mean, names, strict=True):
        i, j = "zyx".index(name[0]), "zyx".index(name[1])
        gradient[i, j] = gradient[j, i] = value if i == j else value / 2
    middles = (cells.position + 0.5) * np.array(edges)
    shift = moves[cells.nodes].mean(axis=1) + middles @ gradient
    return cells.position, dict(zip(names, stresses.T, strict=True)), shift * min(material.spacing)


def without_rigid_motion(moves, places):
    """Return displacements less the shift and the turn that fit them best."""
    one, zero = np.ones(len(places)), np.zeros(len(places))
    z, y, x = places.T.astype(float)
    motions = [(one, zero, zero), (zero, one, zero), (zero, zero, one)]
    motions += [(y, -z, zero), (x, zero, -z), (zero, x, -y)]
    matrix = np.stack([np.stack(motion, axis=1).ravel() for motion in motions], axis=1)
    found = np.linalg.lstsq(matrix, moves.ravel(), rcond=None)[0]
    return moves - (matrix @ found).reshape(-1, 3)


@ccx
@pytest.mark.whole
@pytest.mark.parametrize("axis", ["z", "x"])
def test_the_displacement_of_calculix_is_ours(tmp_path, axis):
    for name, material in (("bone", bone(24)), ("field", field(16, 0.5, spacing=(2.0, 1.5, 1.0)))):
        export_bricks(material, tmp_path / f"{name}.inp", case="periodic", axis=axis, moduli=MODULI)
        run("ccx", name, folder=tmp_path)
        path = tmp_path / f"{name}.frd"
        # the mean stress of the load case is a hundredth of the modulus
        places, stress, want = own_fields(material, axis, 0.01 * MODULI[0])
        at = tuple(places.T)
        given = {"like": material, "array": "DISP"}
        moves = [import_result(path, component=c, **given).values[at] for c in "zyx"]
        true = places * np.array(material.spacing)
        left = without_rigid_motion(np.stack(moves, axis=1) - want, true)
        assert np.sqrt((left**2).mean() / (want**2).mean()) < 1e-4
        # CalculiX writes stresses as means at nodes, so single bricks differ from their own
        for component in (axis * 2, "xy"):
            local = stress["".join(sorted(component))]
            found = import_result(path, like=material, array="STRESS", component=component).values[
                at
            ]
            assert np.corrcoef(found, local)[0, 1] > 0.9
            assert abs(found.mean() - local.mean()) < 2e-3 * np.abs(stress[axis * 2]).mean()


@foam
@pytest.mark.whole
@pytest.mark.skipif(
    shutil.which("foamToVTK") is None, reason="foamToVTK is not installed: apt-get install openfoam"
)
@pytest.mark.parametrize("axis", ["z", "x"])
def test_the_velocity_of_openfoam_comes_back(tmp_path, axis):
    """The mean velocity is the permeability; across a duct it is the known profile."""
    side, walls = 24, slice(4, 20)
    duct = np.ones((12, side, side), np.uint8)
    duct[:, walls, walls] = 0
    duct = np.moveaxis(duct, 0, "zyx".index(axis))
    for name, material in (
        ("duct", tb.Image(duct, "labels", spacing=2.0, unit="um")),
        ("bone", bone(24)),
    ):
        case = tmp_path / f"{name}.foam"
        export_bricks(material, case, axis=axis)
        assert "converged in" in run("simpleFoam", "-case", str(case), folder=tmp_path)
        run("foamToVTK", "-case", str(case), "-latestTime", folder=tmp_path)
        path = next((case / "VTK").glob("*_[1-9]*/internal.vtu"))
        field = import_result(path, like=material, array="U", component=axis, file_unit="m")
        head = (case / "system" / "controlDict").read_text()
        number = r"([-+.\deE]+)"
        factor = float(re.search(rf"= Q \* {number} m2", head)[1])
        area = float(re.search(rf"A = {number} m2", head)[1])
        found = field.values.mean(dtype=float) * area * factor
        own = tb.measure.permeability(material, axis="zyx".index(axis)).value * 1e-12
        assert found == pytest.approx(own, rel=0.05)
        assert not field.values[material.values == 1].any()
        if name == "duct":
            section = np.moveaxis(field.values, "zyx".index(axis), 0)[6, walls, walls]
            profile = section / section.mean()
            assert np.abs(profile - square_duct(16)).max() < 0.03
            legacy = run(
                "foamToVTK", "-legacy", "-case", str(case), "-name", "old", folder=tmp_path
            )
            assert "End" in legacy
            old = next((case / "old").glob("*_[1-9]*.vtk"))
            again = import_result(old, like=material, array="U", component=axis, file_unit="m")
            np.testing.assert_allclose(again.values, field.values, rtol=1e-5)


def square_duct(cells):
    """Return the velocity in a square duct over its mean, at the middles of cells: the series of
    Boussinesq (White, Viscous Fluid Flow, equation 3-48).
    """
    at = (np.arange(cells) + 0.5) / cells * 2 - 1
    y, x = np.meshgrid(at, at, indexing="ij")
    found = np.zeros((cells, cells))
    for k in range(1, 60, 2):
        w = k * np.pi / 2
        found += (-1) ** ((k - 1) // 2) * (1 - np.cosh(w * y) / np.cosh(w)) * np.cos(w * x) / k**3
    return found / found.mean()

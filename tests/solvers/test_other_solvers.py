"""The solvers themselves read what is exported: CalculiX and OpenFOAM (`make test-solvers`).

Both are Debian packages, calculix-ccx and openfoam; where they are not installed these tests are
skipped.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import trabecula as tb
from trabecula.mesh.bricks.export import export_bricks
from trabecula.mesh.tetrahedra.export import write_tetrahedra

_ETC = Path("/usr/share/openfoam")
"""Where Debian's OpenFOAM keeps its defaults; its programs look for it by a variable."""

ccx = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not installed: apt-get install calculix-ccx"
)
foam = pytest.mark.skipif(
    shutil.which("simpleFoam") is None, reason="OpenFOAM is not installed: apt-get install openfoam"
)


def run(*words, folder):
    """Run a solver on one core; return what it printed."""
    known = {"WM_PROJECT_DIR": str(_ETC)} if _ETC.exists() else {}
    env = {**known, **os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def field(side, share, seed=0, **fields):
    noise = np.random.default_rng(seed).standard_normal((side,) * 3)
    smooth = gaussian_filter(noise, 2, mode="wrap")
    values = (smooth > np.quantile(smooth, 1 - share)).astype(np.uint8)
    return tb.Image(values, "labels", **fields)


def bone(side):
    """Return the embedded bone's centre."""
    return tb.crop(tb.sample("bone"), side)


def modulus(path):
    """Return E of what CalculiX wrote beside a deck, by the words in the deck's comments."""
    head, dat = path.read_text()[:900], path.with_suffix(".dat").read_text()
    number = r"([-+.\deE]+)"
    pull = re.search(rf"modulus = {number} x {number} / displacement U(\d)", head)
    if pull:
        row = re.search(r"displacements.*\n\s*\n(.*)", dat)[1].split()
        return float(pull[1]) * float(pull[2]) / float(row[int(pull[3])])
    area, strain = map(float, re.search(rf"\({number} x {number}\)", head).groups())
    dof = int(re.search(r"reactions RF(\d)", head)[1])
    total = re.search(r"total force.*\n\s*\n(.*)", dat)[1].split()
    return abs(float(total[dof - 1])) / (area * strain)


@ccx
@pytest.mark.whole
@pytest.mark.parametrize("axis", ["z", "y", "x"])
def test_calculix_gives_the_modulus_of_measure_stiffness(tmp_path, axis):
    for name, material in (
        ("bone", bone(24)),
        ("field", field(16, 0.5, spacing=(2.0, 1.5, 1.0), unit="mm")),
    ):
        path = tmp_path / f"{name}.inp"
        export_bricks(material, path, case="periodic", axis=axis, moduli=(17e3, 0.3))
        run("ccx", name, folder=tmp_path)
        own = tb.measure.stiffness(material, moduli=(17e3, 0.3), tolerance=1e-4).moduli[axis]
        assert modulus(path) == pytest.approx(own, rel=0.01)


@ccx
@pytest.mark.whole
def test_calculix_solves_the_other_load_cases(tmp_path):
    material = field(14, 0.5)
    whole = tb.measure.stiffness(material)
    for case in ("compression", "shear"):
        export_bricks(material, tmp_path / f"{case}.inp", case=case)
        run("ccx", case, folder=tmp_path)
    # between faces, with free sides: softer than the material, of the same order
    assert 0.5 < modulus(tmp_path / "compression.inp") / whole.moduli["z"] < 1.05
    assert 0.2 < modulus(tmp_path / "shear.inp") / whole.shear["xz"] < 1.05


@ccx
@pytest.mark.whole
def test_calculix_reads_several_phases(tmp_path):
    values = 1 + field(10, 0.5).values
    rock = tb.Image(values, "labels", phases=("void", "soft", "hard"))
    given = {"soft": (1.0, 0.3), "hard": (3.0, 0.2)}
    export_bricks(rock, tmp_path / "two.inp", case="periodic", moduli=given)
    run("ccx", "two", folder=tmp_path)
    own = tb.measure.stiffness(rock, moduli=given, tolerance=1e-4).moduli["z"]
    assert modulus(tmp_path / "two.inp") == pytest.approx(own, rel=0.01)


def pulled(mesh, path):
    """Return E of tetrahedra that CalculiX pulls along z by a hundredth, between plates."""
    write_tetrahedra(mesh, path, moduli=(1.0, 0.3))
    length, below = mesh.extent[2], mesh.face_nodes()["z_low"]
    far = below[np.argmax(np.abs(mesh.points[below, 0] - mesh.points[below[0], 0]))]
    with path.open("a") as file:
        file.write("*STEP\n*STATIC\n*BOUNDARY\nZ_LOW, 3, 3, 0\n")
        file.write(f"{below[0] + 1}, 1, 2, 0\n{far + 1}, 2, 2, 0\n")
        file.write(f"Z_HIGH, 3, 3, {length / 100}\n")
        file.write("*NODE PRINT, NSET=Z_HIGH, TOTALS=ONLY\nRF\n*END STEP\n")
    run("ccx", path.stem, folder=path.parent)
    total = re.search(r"total force.*\n\s*\n(.*)", path.with_suffix(".dat").read_text())[1].split()
    return float(total[2]) / (mesh.extent[0] * mesh.extent[1] * 0.01)


@ccx
@pytest.mark.whole
def test_calculix_pulls_tetrahedra(tmp_path):
    """A block has its own modulus; of bone bricks say it about."""
    block = tb.tetrahedra(np.ones((6, 6, 6), np.uint8), edge=2)
    assert pulled(block, tmp_path / "block.inp") == pytest.approx(1, rel=1e-4)
    material = bone(24)
    fine = pulled(tb.tetrahedra(material, edge=1), tmp_path / "fine.inp")
    coarse = pulled(tb.tetrahedra(material, edge=1.6), tmp_path / "coarse.inp")
    path = tmp_path / "bricks.inp"
    export_bricks(material, path, case="compression")
    run("ccx", "bricks", folder=tmp_path)
    assert 0.75 < fine / modulus(path) < 1.1 and 0.6 < coarse / modulus(path) < 1.1


def permeability(case):
    """Return k, m2, of a case that has run, by the words in its comments."""
    control = (case / "system" / "controlDict").read_text()
    factor = float(re.search(r"= Q \* ([-+.\deE]+) m2", control)[1])
    rows = (case / "postProcessing" / "flow" / "0" / "surfaceFieldValue.dat").read_text()
    return float(rows.split()[-1]) * factor


@foam
@pytest.mark.whole
@pytest.mark.parametrize("axis", ["z", "x"])
def test_openfoam_gives_the_permeability_of_measure(tmp_path, axis):
    duct = np.ones((20, 20, 20), np.uint8)
    duct[:, 4:16, 4:16] = 0
    duct = np.moveaxis(duct, 0, "zyx".index(axis))
    for name, material in (
        ("duct", tb.Image(duct, "labels", spacing=2.0, unit="um")),
        ("bone", bone(32)),
    ):
        case = tmp_path / f"{name}.foam"
        export_bricks(material, case, axis=axis)
        checked = run("checkMesh", "-case", str(case), folder=tmp_path)
        assert "Mesh OK" in checked
        assert "converged in" in run("simpleFoam", "-case", str(case), folder=tmp_path)
        own = tb.measure.permeability(material, axis="zyx".index(axis)).value * 1e-12
        assert permeability(case) == pytest.approx(own, rel=0.05)

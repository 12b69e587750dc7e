"""Dictionaries of a flow by OpenFOAM: slow, steady, laminar, from inlet to outlet by a pressure.

The conditions are those of `measure.permeability`: no slip at the walls, mirrors at the sides,
constant pressure at both ends. Pressure is over the density, so k = Q nu L / (A dp). The pressure
is so small that inertia does not matter: the Reynolds number of a pore of one voxel is of the order
of `_SLOW`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.grid import BrickGrid
from trabecula.mesh.text import recipe_lines

WALLS = "walls"

_VISCOSITY = 1e-6
"""Of water, m2/s; it cancels in the permeability."""

_SLOW = 1e-3
"""Drop of pressure over a voxel, over nu^2 / spacing^2."""


@dataclass(frozen=True)
class FoamPatch:
    """Faces of the boundary that follow each other."""

    name: str
    start: int
    count: int

    @property
    def kind(self) -> str:
        """Return the type of the patch: the sides are mirrors."""
        if self.name == WALLS:
            return "wall"
        return "symmetryPlane" if self.name.startswith("side_") else "patch"


def foam_header(kind: str, name: str, *, location: str) -> str:
    """Return the header of a file."""
    return (
        "FoamFile\n{\n    version 2.0;\n    format ascii;\n"
        f'    class {kind};\n    location "{location}";\n    object {name};\n}}\n\n'
    )


def write_case(
    grid: BrickGrid,
    path: Path,
    patches: Sequence[FoamPatch],
    context: ExportContext,
    scale: float,
) -> None:
    """Write the boundary, fields, properties and controls; `scale` gives metres."""
    sides = np.array(grid.volume.shape) * grid.volume.spacing * scale
    length = float(sides[context.axis])
    area = float(np.prod(np.delete(sides, context.axis)))
    voxel = float(min(grid.volume.spacing)) * scale
    drop = _SLOW * _VISCOSITY**2 / voxel**3 * length
    _write(path, "constant/polyMesh", "boundary", "polyBoundaryMesh", _boundary(patches))
    _write(path, "0", "U", "volVectorField", _velocity(patches))
    _write(path, "0", "p", "volScalarField", _pressure(patches, drop))
    _write(path, "constant", "transportProperties", "dictionary", _TRANSPORT)
    _write(path, "constant", "turbulenceProperties", "dictionary", "simulationType laminar;\n")
    _write(path, "system", "fvSchemes", "dictionary", _SCHEMES)
    _write(path, "system", "fvSolution", "dictionary", _SOLUTION)
    reading = [
        "flow over the outlet: postProcessing/flow/0/surfaceFieldValue.dat, Q in m3/s",
        f"permeability k = Q nu L / (A dp) = Q * {_VISCOSITY * length / (area * drop):.9g} m2",
        f"nu = {_VISCOSITY:g} m2/s, L = {length:.9g} m, A = {area:.9g} m2, dp = {drop:.9g} m2/s2",
    ]
    lines = [*reading, "recipe", *recipe_lines(context.recipe)]
    # A comment of a line each: none is long, and no recipe can end it.
    comment = "".join(f"// {line}\n" for line in lines)
    _write(path, "system", "controlDict", "dictionary", comment + _CONTROL)
    (path / "case.foam").touch()  # what ParaView opens


def _write(path: Path, location: str, name: str, kind: str, text: str) -> None:
    folder = path / location
    folder.mkdir(parents=True, exist_ok=True)
    content = foam_header(kind, name, location=location) + text
    (folder / name).write_text(content, encoding="ascii", newline="\n")


def _boundary(patches: Sequence[FoamPatch]) -> str:
    entries = "".join(
        f"    {patch.name}\n    {{\n        type {patch.kind};\n        nFaces {patch.count};\n"
        f"        startFace {patch.start};\n    }}\n"
        for patch in patches
    )
    return f"{len(patches)}\n(\n{entries})\n"


def _field(dimensions: str, inside: str, patches: Sequence[FoamPatch], at: dict[str, str]) -> str:
    entries = "".join(
        f"    {patch.name}\n    {{\n        {at.get(patch.name, 'type symmetryPlane;')}\n    }}\n"
        for patch in patches
    )
    return (
        f"dimensions {dimensions};\ninternalField uniform {inside};\n"
        f"boundaryField\n{{\n{entries}}}\n"
    )


def _velocity(patches: Sequence[FoamPatch]) -> str:
    normal = "type pressureInletVelocity; value uniform (0 0 0);"  # none along the end faces
    at = {"inlet": normal, "outlet": normal, WALLS: "type noSlip;"}
    return _field("[0 1 -1 0 0 0 0]", "(0 0 0)", patches, at)


def _pressure(patches: Sequence[FoamPatch], drop: float) -> str:
    at = {
        "inlet": f"type fixedValue; value uniform {drop:.9g};",
        "outlet": "type fixedValue; value uniform 0;",
        WALLS: "type zeroGradient;",
    }
    return _field("[0 2 -2 0 0 0 0]", "0", patches, at)


_TRANSPORT = f"transportModel Newtonian;\nnu [0 2 -1 0 0 0 0] {_VISCOSITY:g};\n"

_SCHEMES = """ddtSchemes { default steadyState; }
gradSchemes { default Gauss linear; }
divSchemes
{
    default none;
    div(phi,U) bounded Gauss linear;
    div((nuEff*dev2(T(grad(U))))) Gauss linear;
}
laplacianSchemes { default Gauss linear orthogonal; }
interpolationSchemes { default linear; }
snGradSchemes { default orthogonal; }
"""

_SOLUTION = """solvers
{
    p { solver GAMG; smoother DICGaussSeidel; tolerance 1e-14; relTol 0.01; }
    U { solver PBiCGStab; preconditioner DILU; tolerance 1e-16; relTol 0.01; }
}
SIMPLE
{
    consistent yes;
    nNonOrthogonalCorrectors 0;
    residualControl { p 1e-6; U 1e-6; }
}
relaxationFactors { equations { U 0.9; } fields { p 1; } }
"""

_CONTROL = """application simpleFoam;
startFrom startTime;
startTime 0;
stopAt endTime;
endTime 3000;
deltaT 1;
writeControl timeStep;
writeInterval 3000;
purgeWrite 1;
writeFormat ascii;
writePrecision 10;
runTimeModifiable false;
functions
{
    flow
    {
        type surfaceFieldValue;
        libs ("libfieldFunctionObjects.so");
        fields (phi);
        operation sum;
        regionType patch;
        name outlet;
        writeFields false;
        writeControl timeStep;
        writeInterval 1;
    }
}
"""

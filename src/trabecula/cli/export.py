"""`trabecula export FILE --out part.stl`, and bricks or tetrahedra for solvers: `--out
part.inp|.vtu|.msh|.foam [--tetrahedra [EDGE]] [--phase NAME ...] [--case CASE] [--axis AXIS]
[--strain S] [--moduli NAME=E,NU ...]`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file and the target."""
    parser.add_argument("file", metavar="FILE", help="volume")
    parser.add_argument(
        "--out",
        required=True,
        metavar="FILE",
        help=".stl .3mf .ply .obj, .inp .vtu .msh .foam (bricks for solvers), or a volume's format",
    )
    parser.add_argument(
        "--phase",
        nargs="+",
        metavar="NAME",
        help="phase whose surface is taken, or phases that become bricks, or parts of a .3mf "
        "(default: every phase but void; of .foam void)",
    )
    parser.add_argument(
        "--beams",
        action="store_true",
        help="beams along the skeleton instead of a surface, as .3mf: small, and editable",
    )
    parser.add_argument(
        "--tolerance",
        metavar="VOXELS",
        help="decimate the surface: fewer triangles, nowhere farther from it than this (try 0.5)",
    )
    shared.add_lengths(parser)
    group = parser.add_argument_group("bricks for solvers")
    group.add_argument(
        "--tetrahedra",
        nargs="?",
        const="2",
        metavar="EDGE",
        help="tetrahedra with smooth interfaces instead: cells of so many voxels a side (default "
        "2); of .inp, .vtu, .msh",
    )
    group.add_argument(
        "--case",
        metavar="CASE",
        help="load case of .inp: compression, shear or periodic; bricks that it does not reach are "
        "left out",
    )
    group.add_argument("--axis", metavar="AXIS", help="of the load case or flow (default z)")
    group.add_argument("--strain", type=float, metavar="S", help="of the load case (default 0.01)")
    group.add_argument(
        "--moduli",
        nargs="+",
        default=[],
        metavar="NAME=E,NU",
        help="Young's modulus and Poisson's ratio of a phase, or E,NU of all (default 1,0.3)",
    )
    shared.add_memory(parser, "the .stl of a .zarr that needs more is written in slabs")


def run(options: argparse.Namespace) -> int:
    """Write the surface, the bricks or the voxels; of a surface, print a check of it."""
    from trabecula.io.files import read, write
    from trabecula.io.lengths import with_lengths
    from trabecula.mesh.bricks.formats import FORMATS as BRICKS
    from trabecula.mesh.check import check
    from trabecula.mesh.files import write_mesh
    from trabecula.mesh.formats import FORMATS
    from trabecula.mesh.sizes import extent_of
    from trabecula.mesh.surface import mesh
    from trabecula.pipeline.outputs import check_no_bricks, check_surface_options, check_target

    check_target(options.out, surfaces=True)
    tolerance = None
    if options.tolerance is not None:
        tolerance = shared.number(options.tolerance, name="--tolerance")
    check_surface_options(options.out, beams=options.beams, tolerance=tolerance)
    if options.tetrahedra is not None:
        return _tetrahedra(options)
    if Path(options.out).suffix.lower() in BRICKS:
        return _bricks(options)
    check_no_bricks(options.out, _one_or_all(options.phase), _brick_options(options))
    if options.phase and len(options.phase) > 1:
        return _several(options, tolerance)
    options.phase = options.phase[0] if options.phase else None
    in_memory = options.beams or tolerance is not None
    volume = None if in_memory else _too_large(options)
    if volume is not None:
        return _in_slabs(volume, options)
    image = with_lengths(read(options.file), **shared.lengths(options))
    if options.beams:
        return _as_beams(image, options)
    if Path(options.out).suffix.lower() not in FORMATS:
        write(image, options.out)
        print(f"{options.out}: {image!r}")
        return 0
    surface = mesh(image, phase=options.phase)
    if tolerance is not None:
        surface = _decimated(surface, tolerance, min(image.spacing))
    write_mesh(surface, options.out)
    print(f"{options.out}: {len(surface.vertices)} vertices, {len(surface.faces)} triangles")
    print(f"size {_size(extent_of(surface), surface.unit, options.out)}")
    terminal.show_mapping(vars(check(surface)))
    return 0


def _several(options: argparse.Namespace, tolerance: float | None) -> int:
    """Write the surfaces of several phases into one file."""
    from trabecula.io.files import read
    from trabecula.pipeline.outputs import export

    image = read(options.file)
    given = {**shared.lengths(options), "beams": options.beams, "tolerance": tolerance}
    export(image, options.out, phase=options.phase, **given)
    print(f"{options.out}: {len(options.phase)} parts: {', '.join(options.phase)}")
    return 0


def _as_beams(image: Any, options: argparse.Namespace) -> int:
    """Write beams, and say how far they are from the part."""
    from trabecula.mesh.beam_file import write_beams
    from trabecula.mesh.beams import beam_lattice, compare_beams

    lattice = beam_lattice(image, phase=options.phase)
    write_beams(lattice, options.out)
    found = compare_beams(image, lattice, phase=options.phase)
    print(f"{options.out}: {len(lattice.beams)} beams")
    terminal.show_mapping(found)
    return 0


def _decimated(surface: Any, tolerance: float, voxel: float) -> Any:
    """Decimate a surface, and say how far it is from the one before."""
    from trabecula.mesh.decimate import decimate, surface_distance

    fewer = decimate(surface, tolerance * voxel)
    off = surface_distance(surface, fewer, spacing=voxel / 2)
    print(
        f"{len(surface.faces)} triangles before; distance at most {off.there / voxel:.2f} voxels "
        f"from there, {off.back / voxel:.2f} back, {off.mean / voxel:.2f} on average"
    )
    return fewer


def _size(extent: Any, unit: str, out: str) -> str:
    """Return the size in millimetres, and the unit in the file where it is another."""
    from trabecula.mesh.formats import surface_format
    from trabecula.mesh.sizes import size_text

    other = surface_format(out).own_unit and unit not in ("mm", "voxel")
    return size_text(extent, unit) + (f"; its coordinates are in {unit}" if other else "")


def _too_large(options: argparse.Namespace) -> Any:
    """Open the volume in slabs where its surface would not fit into memory and the format allows
    it.
    """
    from trabecula.io.lazy import slabs_if_large
    from trabecula.mesh.formats import FORMATS
    from trabecula.mesh.slabs import in_core_bytes

    form = FORMATS.get(Path(options.out).suffix.lower())
    if form is None or not form.in_slabs:
        return None
    return slabs_if_large(options.file, need=in_core_bytes, memory=options.memory)


def _in_slabs(volume: Any, options: argparse.Namespace) -> int:
    """Write the surface slab by slab. A check would need all of it at once."""
    from trabecula.io.lengths import with_lengths
    from trabecula.mesh.slabs import export_slabs

    volume = with_lengths(volume, **shared.lengths(options))
    found = export_slabs(volume, options.out, phase=options.phase, memory=options.memory)
    print(f"{options.out}: {found.vertices.sum()} vertices, {found.faces.sum()} triangles")
    print(f"size {_size(found.extent, volume.unit, options.out)}")
    print("closed by construction; not checked, since the surface was never in memory as a whole")
    return 0


def _tetrahedra(options: argparse.Namespace) -> int:
    """Write tetrahedra, and print how many there are and their angles."""
    from trabecula.io.files import read
    from trabecula.io.lengths import with_lengths
    from trabecula.mesh.tetrahedra.export import write_tetrahedra
    from trabecula.mesh.tetrahedra.make import tetrahedra
    from trabecula.pipeline.outputs import check_tetrahedra

    edge = shared.number(options.tetrahedra, name="--tetrahedra")
    check_tetrahedra(options.out, edge, case=options.case)
    given = _brick_options(options)
    image = with_lengths(read(options.file), **shared.lengths(options))
    found = tetrahedra(image, edge=edge, phases=options.phase)
    write_tetrahedra(found, options.out, **({"moduli": given["moduli"]} if options.moduli else {}))
    print(f"{options.out}: {len(found.points)} nodes, {len(found.cells)} tetrahedra")
    for phase, volume in found.volume.items():
        print(f"volume of {phase} {volume:.6g} {image.unit}^3")
    angles = found.angles
    print(
        f"dihedral angles {angles.least:.1f} to {angles.largest:.1f} degrees; of 99 in 100 "
        f"tetrahedra the least is above {angles.hundredth:.1f}"
    )
    return 0


def _bricks(options: argparse.Namespace) -> int:
    """Write bricks, and print how many there are and how they touch."""
    from trabecula.io.files import read
    from trabecula.io.lazy import slabs_if_large
    from trabecula.io.lengths import with_lengths
    from trabecula.mesh.bricks.export import export_bricks, in_core_bytes

    need: dict[str, Any] = {"need": in_core_bytes, "memory": options.memory}
    volume: Any = slabs_if_large(options.file, **need)
    volume = read(options.file) if volume is None else volume
    volume = with_lengths(volume, **shared.lengths(options))
    found = export_bricks(
        volume,
        options.out,
        phases=options.phase,
        memory=options.memory,
        **_brick_options(options),
    )
    by_phase = ", ".join(f"{count} {name}" for name, count in found.bricks.items())
    print(f"{options.out}: {found.nodes} nodes, bricks: {by_phase}")
    print(f"volume {found.volume:.6g} {volume.unit}^3, {found.size} bytes")
    if found.pairs:
        print(f"{found.pairs} nodes depend on their partners across the faces")
    if found.left_out:
        print(
            f"{found.left_out} voxels are left out: they do not reach from face to face through "
            "shared faces"
        )
    if found.edge_contacts or found.node_contacts:
        print(
            f"bricks touch by an edge alone at {found.edge_contacts} edges, by a node alone at "
            f"{found.node_contacts} nodes: hinges in a solver (finish --manifold joins them)"
        )
    return 0


def _brick_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of bricks that are given."""
    found = {name: getattr(options, name) for name in ("case", "axis", "strain")}
    found["moduli"] = _moduli(options.moduli) if options.moduli else None
    return {name: value for name, value in found.items() if value is not None}


def _moduli(words: list[str]) -> Any:
    """Return (E, nu), or a mapping from phases to them."""
    from trabecula.core.checks import quote

    found: dict[str, tuple[float, float]] = {}
    for word in words:
        name, _, pair = word.rpartition("=")
        try:
            young, poisson = (float(number) for number in pair.split(","))
        except ValueError:
            raise InputError(
                f"--moduli {quote(word)} is not NAME=E,NU: give two numbers, such as solid=17e3,0.3"
            ) from None
        found[name] = (young, poisson)
    return found[""] if list(found) == [""] else found


def _one_or_all(phases: list[str] | None) -> str | list[str] | None:
    return phases[0] if phases and len(phases) == 1 else phases

"""`trabecula export FILE --out part.stl`."""

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
        "--out", required=True, metavar="FILE", help=".stl .3mf .ply .obj, or a volume's format"
    )
    parser.add_argument(
        "--phase", help="phase whose surface is taken (default: every phase but void)"
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
    shared.add_memory(parser, "the .stl of a .zarr that needs more is written in slabs")


def run(options: argparse.Namespace) -> int:
    """Write the surface or the voxels; of a surface, print a check of it."""
    from trabecula.io.files import read, write
    from trabecula.io.lengths import with_lengths
    from trabecula.mesh.check import check
    from trabecula.mesh.files import write_mesh
    from trabecula.mesh.formats import FORMATS
    from trabecula.mesh.sizes import extent_of
    from trabecula.mesh.surface import mesh
    from trabecula.pipeline.outputs import check_target

    check_target(options.out, surfaces=True)
    tolerance = None
    if options.tolerance is not None:
        tolerance = shared.number(options.tolerance, name="--tolerance")
    in_memory = options.beams or tolerance is not None
    volume = None if in_memory else _too_large(options)
    if volume is not None:
        return _in_slabs(volume, options)
    image = with_lengths(read(options.file), **shared.lengths(options))
    if options.beams:
        return _as_beams(image, options)
    if Path(options.out).suffix.lower() not in FORMATS:
        if tolerance is not None:
            raise InputError(
                f"{options.out} holds voxels, --tolerance is for a surface: leave it out"
            )
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

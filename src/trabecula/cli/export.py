"""`trabecula export FILE --out part.stl`."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The file and the target."""
    parser.add_argument("file", metavar="FILE", help="volume")
    parser.add_argument("--out", required=True, metavar="FILE", help=".stl .3mf .ply .obj, or a volume's format")
    parser.add_argument("--phase", help="phase whose surface is taken (default: every phase but void)")


def run(options: argparse.Namespace) -> int:
    """Write the surface or the voxels; for a surface, print what a check of it says."""
    from pathlib import Path

    from trabecula.flow import check_target
    from trabecula.io.files import read, write
    from trabecula.mesh.check import check
    from trabecula.mesh.files import write_mesh
    from trabecula.mesh.formats import FORMATS
    from trabecula.mesh.surface import mesh

    check_target(options.out, surfaces=True)
    image = read(options.file)
    if Path(options.out).suffix.lower() not in FORMATS:
        write(image, options.out)
        print(f"{options.out}: {image!r}")
        return 0
    surface = mesh(image, phase=options.phase)
    write_mesh(surface, options.out)
    print(f"{options.out}: {len(surface.vertices)} vertices, {len(surface.faces)} triangles")
    terminal.show_mapping(vars(check(surface)))
    return 0

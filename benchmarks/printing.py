"""For printers: surfaces and beams of parts with their distance from the voxels, and layers."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import trabecula as tb
from common import busy, table
from crossings import crossings
from descriptors import scans
from trabecula.mesh.base import Mesh
from trabecula.mesh.beam_file import write_beams
from trabecula.mesh.beams import beam_lattice, compare_beams
from trabecula.mesh.check import check
from trabecula.mesh.decimate import decimate, surface_distance
from trabecula.mesh.files import write_mesh


def _parts() -> dict[str, tb.Image]:
    """Return one-piece parts of 128^3 (the sample 96^3) with voxels of a millimetre."""
    found = {"sample foam": tb.sample("foam")}
    found |= {name: tb.crop(scan, 128) for name, scan in scans().items() if name == "bone a"}
    parts = {}
    for name, image in found.items():
        part = tb.finish.connect(image)
        parts[name] = tb.Image(part.values, "labels", 1.0, unit="mm", phases=part.phases)
    return parts


def surfaces() -> None:
    """Triangles, files and distances of whole and decimated surfaces, and of beams.

    Distances are in voxels, at samples of half a voxel: from the whole surface to the other, back,
    and the mean; `volume` is over the whole surface's; `crossing` are triangles that cross another.
    """
    heads = ("triangles", "crossing", "3MF kB", "STL kB", "there", "back", "mean", "volume", "s")
    row = table("part, what", *heads, wide=36)
    decimate(tb.mesh(np.ones((8, 8, 8), np.uint8)), 0.5)  # compiles
    beam_lattice(np.ones((8, 8, 8), np.uint8))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        for name, part in _parts().items():
            seconds, whole = busy(lambda part=part: tb.mesh(part))
            volume = check(whole).volume
            cells = _sizes(whole, path)
            row(f"{name}, whole", *cells, "", "", "", 1, f"{seconds:.1f}")
            for tolerance in (0.25, 0.5, 1.0):
                seconds, fewer = busy(lambda s=whole, t=tolerance: decimate(s, t))
                off = surface_distance(whole, fewer, spacing=0.5)
                row(
                    f"{name}, tolerance {tolerance:g}",
                    *_sizes(fewer, path),
                    *(f"{value:.3f}" for value in (off.there, off.back, off.mean)),
                    f"{check(fewer).volume / volume:.4f}",
                    f"{seconds:.1f}",
                )
            seconds, lattice = busy(lambda part=part: beam_lattice(part))
            size = write_beams(lattice, path / "beams.3mf").stat().st_size
            found = compare_beams(part, lattice)
            row(
                f"{name}, {len(lattice.beams)} beams",
                "",
                "",
                f"{size / 1000:.0f}",
                "",
                "",
                f"99 %: {found['distance_99']:.2f}",
                f"overlap {found['overlap']:.2f}",
                f"{found['volume']:.4f}",
                f"{seconds:.1f}",
            )


def _sizes(surface: Mesh, folder: Path) -> list[str]:
    """Return the triangles, and the kilobytes of its files."""
    files = [write_mesh(surface, folder / f"part{suffix}") for suffix in (".3mf", ".stl")]
    crossing = crossings(surface, 1.5)
    return [
        f"{len(surface.faces)}",
        f"{crossing}",
        *(f"{file.stat().st_size / 1000:.0f}" for file in files),
    ]


def layers() -> None:
    """Seconds of a layer in each form, of parts at the usual pitch: ten layers in the middle."""
    row = table("part, form", "layers", "pixels", "ms a layer", "volume / voxels", wide=36)
    with tempfile.TemporaryDirectory() as folder:
        for name, part in _parts().items():
            for form in ("polyjet", "dlp", "svg"):
                plan = tb.plan_layers(part, form=form)
                middle = plan.layers // 2
                target = Path(folder) / f"{name} {form}"
                tb.write_layers(part, target / "first", form=form, only=(0, 1))  # compiles
                chosen = (middle, min(middle + 10, plan.layers))
                seconds, stack = busy(
                    lambda p=part, t=target, f=form, c=chosen: tb.write_layers(
                        p, t / "all", form=f, only=c
                    )
                )
                low, high = (k * plan.pitch[0] for k in chosen)
                inside = _volume_between(part, low, high)
                row(
                    f"{name}, {form}",
                    plan.layers,
                    f"{plan.shape[0]} x {plan.shape[1]}",
                    f"{100 * seconds:.1f}",
                    f"{sum(stack.materials.values()) / inside:.3f}",
                )


def _volume_between(part: tb.Image, low: float, high: float) -> float:
    """Return the volume of the solid between two heights; voxels are of 1 mm."""
    planes = (part.values > 0).sum(axis=(1, 2), dtype=float)
    overlap = np.clip(np.minimum(high, np.arange(1, len(planes) + 1)), 0, None) - np.maximum(
        low, np.arange(len(planes))
    )
    return float((planes * np.clip(overlap, 0, 1)).sum())

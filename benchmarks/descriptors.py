"""Descriptors and the certificate: every scan's figures with the seconds they took, speed and
memory at size.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, tell, timed, unit

LABELS = {
    "bone a": ("trabecular_bone_a.tif", 0.05, "mm"),
    "bone b": ("trabecular_bone_b.tif", 0.05, "mm"),
    "bone with cortex": ("trabecular_bone_cortex_a.tif", 0.05, "mm"),
    "Berea": ("berea_sandstone_a.tif", 1.0, "voxel"),
    "NMC": ("nmc_electrode_a.tif", 1.0, "voxel"),
    "electrode, 3 phases": ("electrode_3phase_a.tif", 1.0, "voxel"),
    "cathode, coarse": ("battery_cathode_lowres.tif", 1.0, "voxel"),
}
GREY = {
    "grey bone": ("trabecular_bone_grey_lhdl.tif", 19.5, "um"),
    "cement": ("cement_air_voids.tif", 1.0, "voxel"),
    "weave": ("fibre_composite_weave.tif", 1.0, "voxel"),
    "soil": ("soil_sand_a.tif", 1.0, "voxel"),
    "polymer fibres": ("polymer_fibres.tif", 1.0, "voxel"),
}
BOX = 96
"""Transport and stiffness are solved in a centre box of so many voxels a side."""


def scans() -> dict[str, tb.Image]:
    """Every volume there is, grey ones cut at Otsu's threshold."""
    if not SCANS.is_dir():
        return {name: tb.sample(name) for name in tb.samples()}
    found = {
        name: tb.read(SCANS / file, spacing=edge, unit=unit)
        for name, (file, edge, unit) in LABELS.items()
    }
    for name, (file, edge, length) in GREY.items():
        found[f"{name}, Otsu"] = tb.segment(tb.read(SCANS / file, spacing=edge, unit=length))
    return found


def descriptors() -> None:
    """Figures of every scan, one a line, in the scan's unit; transport and stiffness of a centre
    box; seconds.
    """
    names = (
        "porosity",
        "specific_surface",
        "thickness",
        "pore_size",
        "chord_length",
        "anisotropy",
        "euler_density",
    )
    names += ("components", "largest_fraction")
    tell("scan", "shape", "unit", *names, "seconds", "D", "k", "E", "seconds in the box")
    for name, image in scans().items():
        seconds, found = timed(lambda i=image: tb.describe(i))
        slow, physics = timed(lambda i=image: tb.measure.describe_physics(i, box=BOX))
        means = [_mean(physics[key]) for key in ("diffusivity", "permeability")]
        stiff = _mean({axis: physics["stiffness"]["moduli"][axis] for axis in "zyx"})
        size = "x".join(map(str, image.shape))
        cells = [_short(found[key]) for key in names]
        tell(
            name,
            size,
            image.unit,
            *cells,
            f"{seconds:.1f}",
            *map(_short, (*means, stiff)),
            f"{slow:.0f}",
        )


def large() -> None:
    """Speed and memory at 256^3 (bone, tiled where the scan is smaller), r = 50; two_point at 500^3
    as well.
    """
    base = unit()
    solid = _tiled(256)
    jobs: dict[str, Callable[[], Any]] = {
        "two_point 256^3": lambda: tb.measure.two_point(solid, r_max=50),
        "minkowski 256^3": lambda: tb.measure.minkowski(solid),
        "components 256^3": lambda: tb.measure.components(solid),
        "thickness 256^3": lambda: tb.measure.thickness(solid),
        "pore_size 256^3": lambda: tb.measure.pore_size(solid),
        "lineal_path 256^3": lambda: tb.measure.lineal_path(solid, r_max=50),
        "two_point_cluster 256^3": lambda: tb.measure.two_point_cluster(solid, r_max=50),
        "anisotropy 256^3": lambda: tb.measure.anisotropy(solid),
    }
    tell("job", "s", "/ unit", "bytes a voxel")
    for name, job in jobs.items():
        job()
        _told(name, job, solid.size, base)
    wide = _tiled(500)
    _told("two_point 500^3", lambda: tb.measure.two_point(wide, r_max=50), wide.size, base)


def certificate() -> None:
    """Seconds of the certificate of 128^3 from a crop of 128^3, at every level (two threads for
    "full").
    """
    exemplar = tb.crop(next(iter(scans().values())), 128)
    material = tb.method("texture").fit(exemplar).generate(128, seed=0)
    tb.verify(exemplar, material)
    tell("level", "s", "verdict")
    for level, count in (("quick", 1), ("default", 1), ("full", 2)):
        with tb.threads(count):
            seconds, found = timed(lambda at=level: tb.verify(exemplar, material, level=at))
        tell(
            level, f"{seconds:.1f}", "pass" if found.passed else f"FAIL: {', '.join(found.failed)}"
        )
    crop = tb.crop(exemplar, 100)
    for name, image in (
        ("texture", tb.method("texture")),
        ("noise", tb.method("noise", exact=True)),
    ):
        other = image.fit(crop).generate(128, seed=0)
        seconds, share = timed(lambda o=other: tb.measure.coherence(crop, o))
        shares = ", ".join(f"{k}: {value:.2f}" for k, value in share.items())
        tell(f"coherence of {name}, 128^3 from 100^3", f"{seconds:.1f}", shares)


def _told(name: str, job: Callable[[], Any], voxels: int, base: float) -> None:
    seconds = min(timed(job)[0] for _ in range(2))
    tracemalloc.start()
    job()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    tell(name, f"{seconds:.2f}", f"{seconds / base:.1f}", f"{peak / voxels:.1f}")


def _tiled(side: int) -> np.ndarray:
    solid = (next(iter(scans().values())).values > 0).astype(np.uint8)
    repeats = [-(-side // edge) for edge in solid.shape]
    return np.tile(solid, repeats)[:side, :side, :side].copy()


def _mean(axes: dict[str, float]) -> float:
    return float(np.mean(list(axes.values())))


def _short(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}"

"""`drainage`: seconds of two fluids, and their curves in a sandstone."""

from __future__ import annotations

import numpy as np

import trabecula as tb
from common import busy, table
from descriptors import scans
from trabecula.measure import drainage as drain
from trabecula.measure import imbibition

SIDES = (128, 200, 256)
RADII = (8, 6, 5, 4, 3, 2.5, 2, 1)


def drainage() -> None:
    """Processor seconds by size (Berea, beyond its 200^3 mirrored), then its curves at 200^3.

    Saturation of the non-wetting fluid over the void, by radius in voxels, along z.
    """
    scan = scans()["Berea"]
    drain(tb.crop(scan, 32), trapping=True)  # compiles
    imbibition(tb.crop(scan, 32), trapping=True)
    row = table("job, CPU s", *(f"{side}^3" for side in SIDES))
    volumes = {side: sized(scan, side) for side in SIDES}
    jobs = {
        "drainage": lambda one: drain(one),
        "drainage, trapping": lambda one: drain(one, trapping=True),
        "drainage, all faces": lambda one: drain(one, inlet="all"),
        "imbibition, trapping": lambda one: imbibition(one, trapping=True),
        "local_thickness": lambda one: tb.measure.local_thickness(one, phase="void"),
    }
    for name, job in jobs.items():
        seconds = (busy(lambda job=job, side=side: job(volumes[side]))[0] for side in SIDES)
        row(name, *(f"{one:.1f}" for one in seconds))
    print()
    row = table("radius", *map(str, RADII), "trapped", "entry radius")
    for name, job in list(jobs.items())[:-1]:
        found = job(volumes[200])
        shares = (found.nonwetting(one).sum() / (volumes[200].values == 0).sum() for one in RADII)
        entry = "" if found.entry_radius is None else f"{found.entry_radius:.2f}"
        row(name, *(f"{one:.3f}" for one in shares), f"{found.trapped:.3f}", entry)


def sized(scan: tb.Image, side: int) -> tb.Image:
    """Return the centre of a scan with void at 0 and voxels of 1, or the scan continued by its
    mirror image.
    """
    values = (scan.values != scan.phases.index("void")).astype(np.uint8)
    image = tb.Image(values, "labels", phases=("void", "solid"))
    if side <= min(scan.shape):
        return tb.crop(image, side)
    more = [(0, side - one) for one in scan.shape]
    return tb.Image(np.pad(values, more, mode="symmetric"), "labels", phases=image.phases)


def drainage_tubes() -> None:
    """Entry radius less the radius of round tubes, in voxels: mean, least and largest of twelve
    places (and of directions, where they are random).
    """
    row = table("direction, radius", "faces", "all 26")
    ways = {"axis": (1, 0, 0), "1 1 0": (1, 1, 0), "1 1 1": (1, 1, 1), "random": None}
    for name, way in ways.items():
        for radius in (1.5, 2.5, 4, 6, 8):
            cells = []
            for connectivity in (6, 26):
                off = [_tube_error(radius, way, seed, connectivity) for seed in range(12)]
                cells.append(f"{np.mean(off):.2f} ({min(off):.2f} .. {max(off):.2f})")
            row(f"{name}, {radius:g}", *cells)


def _tube_error(radius: float, way: tuple[int, ...] | None, seed: int, connectivity: int) -> float:
    """Return the error of the entry radius of a tube somewhere, at most 55 degrees from z."""
    rng = np.random.default_rng(seed)
    along = rng.normal(size=3) if way is None else np.array(way, float)
    along = along[np.argsort(-abs(along))] / np.linalg.norm(along)
    place = np.stack(np.indices((40, 40, 40)), -1) - 19.5 - rng.uniform(-0.5, 0.5, 3)
    aside = place - (place @ along)[..., None] * along
    values = ((aside**2).sum(-1) >= radius**2).astype(np.uint8)[14:26]
    found = drain(values, connectivity=connectivity).entry_radius
    return (0.0 if found is None else found) - radius

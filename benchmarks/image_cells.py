"""Closed cells from one section of a material whose grains are known: `tessellation` beside the
truth, and beside `kopf`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

import trabecula as tb
from common import busy, table
from image import draw, side_of
from trabecula.core.errors import TrabeculaError
from trabecula.core.seeds import generator
from trabecula.engine.compile import inline, kernel
from trabecula.exemplar.views import take_slices
from trabecula.measure.plane_cells import PlaneCells, plane_cells

PHASES = ("grain", "boundary")
GROWN = 96
"""Voxels a side of the grains that grow by curvature."""
SEEDS = 1200
STEPS = 8
REACH = 3


def image_cells() -> None:
    """96^3 from the middle section of a known material: cells of Voronoi walls (`noise`), and
    grains grown by the curvature of their boundaries, which no tessellation makes.

    Of sections: cells per 1000 pixels, mean and variation of their area, neighbours, triple points
    per 1000 pixels, length of lines per pixel. In space: grains per 1e6 voxels (components of the
    interior of 8 voxels or more, half of those at the faces), variation of their volume, and the
    largest one's share of the interior.
    """
    side = side_of(96)
    row = table(
        "material",
        "cells",
        "area",
        "variation",
        "neighbours",
        "triple",
        "length",
        "grains",
        "volumes vary",
        "largest",
        "s",
        wide=28,
    )
    for name, make in truths().items():
        truth = make()
        picture = take_slices(truth, "yx", 1)[0]
        row(f"{name}: the section", *_cells_of([plane_cells(picture)]), "-", "-", "-", "-")
        row(f"{name}: the truth", *_figures(truth), "-")
        volumes = {"truth": truth}
        for method in ("tessellation", "kopf"):
            try:
                seconds, made = busy(
                    lambda m=method, p=picture: tb.method(m).fit(p).generate(side, seed=1)
                )
                row(f"{name}: {method}", *_figures(made), f"{seconds:.1f}")
            except TrabeculaError as error:
                print(f"{name}: {method}: {error}")
                continue
            volumes[method] = made
        draw(f"cells {name}", [picture], volumes)


def truths() -> Mapping[str, Callable[[], tb.Image]]:
    walls = tb.method("noise", kind="voronoi", thickness=2.5, length=16)
    return {
        "Voronoi": lambda: walls.fit().generate(160, seed=1),
        "grain growth": lambda: grown_grains(GROWN),
    }


def grown_grains(side: int) -> tb.Image:
    """Grow grains by the curvature of their boundaries, and draw these one voxel thick.

    Threshold dynamics (Merriman, Bence, Osher 1994; Esedoglu and Otto 2015,
    doi:10.1002/cpa.21527): every voxel takes the grain that fills most of the ball around it, on a
    torus.
    """
    places = generator(0, "bench/grains").random((SEEDS, 3)) * side
    owner = np.empty((side,) * 3, np.int32)
    _nearest(owner, places)
    for _ in range(STEPS):
        found = np.empty_like(owner)
        _vote(found, owner, REACH)
        owner = found
    walls = np.zeros(owner.shape, bool)
    for axis in range(3):
        walls |= owner != np.roll(owner, 1, axis)
    return tb.Image(walls.astype(np.uint8), "labels", phases=PHASES)


@kernel
def _nearest(owner, places):
    side = len(owner)
    for z in range(side):
        for y in range(side):
            for x in range(side):
                best = np.inf
                for n in range(len(places)):
                    far = 0.0
                    for axis in range(3):
                        at = (z if axis == 0 else y if axis == 1 else x) + 0.5
                        apart = at - places[n, axis]
                        apart -= side * np.round(apart / side)
                        far += apart * apart
                    if far < best:
                        best = far
                        owner[z, y, x] = n


@inline
def _lies_deep(owner, z, y, x, reach):
    """Tell whether the corners of the cube around a voxel are of its grain."""
    side = len(owner)
    for dz in (-reach, reach):
        for dy in (-reach, reach):
            for dx in (-reach, reach):
                corner = owner[(z + dz) % side, (y + dy) % side, (x + dx) % side]
                if corner != owner[z, y, x]:
                    return False
    return True


@kernel
def _vote(found, owner, reach):
    side = len(owner)
    names, counts = np.empty(343, np.int32), np.empty(343, np.int64)
    for z in range(side):
        for y in range(side):
            for x in range(side):
                kinds, own = 0, owner[z, y, x]
                if _lies_deep(owner, z, y, x, reach):
                    found[z, y, x] = own
                    continue
                for dz in range(-reach, reach + 1):
                    for dy in range(-reach, reach + 1):
                        for dx in range(-reach, reach + 1):
                            if dz * dz + dy * dy + dx * dx > reach * reach:
                                continue
                            grain = owner[(z + dz) % side, (y + dy) % side, (x + dx) % side]
                            n = 0
                            while n < kinds and names[n] != grain:
                                n += 1
                            if n == kinds:
                                names[n], counts[n] = grain, 0
                                kinds += 1
                            counts[n] += 1
                best = 0
                for n in range(1, kinds):
                    if counts[n] > counts[best]:
                        best = n
                found[z, y, x] = names[best]


def _figures(volume: tb.Image) -> list[str]:
    """Figures of the sections and of the grains."""
    sections = []
    for plane in ("yx", "zx", "zy"):
        for each in take_slices(volume, plane, 4):
            try:
                sections.append(plane_cells(each, boundary=1))
            except TrabeculaError:
                continue
    return [*_cells_of(sections), *_grains_of(volume)]


def _cells_of(found: list[PlaneCells]) -> list[str]:
    if not found:
        return ["-"] * 6
    mean = lambda f: float(np.mean([f(cells) for cells in found]))  # noqa: E731
    return [
        f"{1e3 * mean(lambda c: c.density):.2f}",
        f"{mean(lambda c: c.mean_area):.1f}",
        f"{mean(lambda c: c.spread(c.area) / c.mean_area):.3f}",
        f"{mean(lambda c: c.mean_neighbours):.2f}",
        f"{1e3 * mean(lambda c: c.triple_points):.2f}",
        f"{mean(lambda c: c.boundary_length):.4f}",
    ]


def _grains_of(volume: tb.Image) -> list[str]:
    labels = tb.measure.label_components(volume.values == 0)[0]
    sizes = np.bincount(labels.ravel())
    faces = [labels[0], labels[-1], labels[:, 0], labels[:, -1], labels[..., 0], labels[..., -1]]
    cut = np.zeros(len(sizes), bool)
    for face in faces:
        cut[face] = True
    cut[0] = True
    real = sizes >= 8
    count = np.count_nonzero(real & ~cut) + 0.5 * np.count_nonzero(real[1:] & cut[1:])
    whole = sizes[real & ~cut]
    varied = f"{whole.std() / whole.mean():.3f}" if len(whole) else "-"
    return [
        f"{1e6 * count / volume.values.size:.0f}",
        varied,
        f"{sizes[1:].max() / sizes[1:].sum():.3f}",
    ]

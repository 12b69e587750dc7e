"""Samples that the package makes itself, so that everything can be tried without a file.

They are stand-ins for scans, made from Voronoi cells: right in kind (struts, plates, cells), wrong
in detail. Use a real scan for anything that is to be believed; `REAL_SCANS` says where some are
published.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe
from trabecula.core.seeds import key
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.engine.random import philox


@dataclass(frozen=True)
class Sample:
    """A sample: cells of a jittered grid, walls and edges between them."""

    name: str
    summary: str
    cell: float  # mean edge of a cell, voxels
    stretch: float  # length of a cell along z over its width
    porosity: float
    walls: float  # share of the walls between cells that are plates of material, 0..1
    wander: float  # how far cell centres stray from their grid, in cells, 0..0.5
    spacing: float
    unit: str


SAMPLES = {
    sample.name: sample
    for sample in (
        Sample(
            "bone",
            "stand-in for cancellous bone: rods with some plates, longer along z",
            15.0,
            1.35,
            0.82,
            0.22,
            0.45,
            40.0,
            "um",
        ),
        Sample(
            "foam",
            "stand-in for an open-cell foam: struts along the edges of cells",
            17.0,
            1.0,
            0.88,
            0.0,
            0.35,
            25.0,
            "um",
        ),
        Sample(
            "cells",
            "stand-in for a closed-cell foam or for grains: walls between all cells",
            9.0,
            1.0,
            0.6,
            1.0,
            0.45,
            10.0,
            "um",
        ),
    )
}

REAL_SCANS = (
    (
        "Digital Porous Media (Digital Rocks) Portal",
        "rock, soil, electrodes: digitalporousmedia.org",
    ),
    ("Imperial College pore-scale group", "Berea, Bentheimer, carbonates"),
    ("BoneBox", "trabecular bone regions of interest (BSD-3-Clause)"),
    ("LHDL collection, through ciclope", "human trabecular bone, grey (MIT)"),
    ("NREL MATBOX and TauFactor examples", "battery electrodes"),
)

_SIDE = 96


def samples() -> dict[str, str]:
    """Return the names of the samples and a summary of each."""
    return {name: sample.summary for name, sample in SAMPLES.items()}


def sample(name: str) -> Image:
    """Return a sample volume of 96^3 voxels, labels void and solid; always the same voxels.

    Raises
    ------
    UnknownNameError
        No sample of that name.
    """
    check_name(name, SAMPLES, name="sample")
    chosen = SAMPLES[name]
    field = np.empty((_SIDE,) * 3, np.float32)
    size = np.array([chosen.cell * chosen.stretch, chosen.cell, chosen.cell], np.float32)
    grow = key(0, f"sample/{name}")
    centres = np.empty((*(int(_SIDE // edge) + 5 for edge in size), 3))
    _centres(centres, size, np.float32(chosen.wander), grow)
    for_slabs(
        lambda a, b: _cells(field, centres, size, np.float32(chosen.walls), grow, a, b), _SIDE
    )
    if chosen.walls < 1:  # a blur opens thin walls
        field = _blur(field)
    count = round(field.size * (1 - chosen.porosity))
    level = np.partition(field.ravel(), count)[count]
    values = (field < level).astype(np.uint8)
    recipe = Recipe().then("sample", values, name=name)
    return Image(values, "labels", (chosen.spacing,) * 3, chosen.unit, ("void", "solid"), recipe)


def _blur(field: np.ndarray) -> np.ndarray:
    """Blur twice by (1, 2, 1) / 4 along every axis: struts get round sections and none is thinner
    than a voxel.
    """
    for axis in (0, 1, 2) * 2:
        padded = np.pad(field, [(int(a == axis),) * 2 for a in range(3)], mode="edge")
        first, last = (
            padded.take(range(field.shape[axis]), axis),
            padded.take(range(2, field.shape[axis] + 2), axis),
        )
        field = (first + 2 * field + last) * np.float32(0.25)
    return field


@kernel
def _centres(centres, size, wander, grow):
    """Write the centres of the cells (voxels): places in a grid, moved at random, every other row
    by half a cell so that cells pack.

    Cell (i, j, k) of the array is cell (i - 2, j - 2, k - 2) of the grid, since a voxel looks two
    cells far.
    """
    unit = np.float32(2.0 / 4294967296.0) * wander
    for i in range(centres.shape[0]):
        for j in range(centres.shape[1]):
            for k in range(centres.shape[2]):
                cz, cy, cx = i - 2, j - 2, k - 2
                r0, r1, r2, _ = philox(grow, cz, cy, cx, 0)
                shift = np.float32(0.5) * ((cz + cy) % 2)
                centres[i, j, k, 0] = (cz + np.float32(0.5) - wander + r0 * unit) * size[0]
                centres[i, j, k, 1] = (cy + np.float32(0.5) - wander + r1 * unit) * size[1]
                centres[i, j, k, 2] = (cx + np.float32(0.5) - wander + r2 * unit + shift) * size[2]


@kernel
def _cells(field, centres, size, walls, grow, start, stop):
    """Write the distance (about, voxels) to the nearest edge between three cells, or to a wall
    between two where it is a plate.

    d1 <= d2 <= d3 are the distances to the nearest centres: d3 - d1 vanishes on edges, d2 - d1 on
    walls.
    """
    for z in range(start, stop):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                d1, d2, d3 = np.float32(1e9), np.float32(1e9), np.float32(1e9)
                id1, id2 = 0, 0
                bz, by, bx = int(z // size[0]), int(y // size[1]), int(x // size[2])
                for cz in range(bz - 2, bz + 3):
                    for cy in range(by - 2, by + 3):
                        for cx in range(bx - 2, bx + 3):
                            centre = centres[cz + 2, cy + 2, cx + 2]
                            dz = (centre[0] - z) * (size[2] / size[0])
                            d = np.float32(
                                np.sqrt(dz * dz + (centre[1] - y) ** 2 + (centre[2] - x) ** 2)
                            )
                            name = ((cz + 64) << 32) + ((cy + 64) << 16) + (cx + 64)
                            if d < d1:
                                d3, d2, d1 = d2, d1, d
                                id2, id1 = id1, name
                            elif d < d2:
                                d3, d2 = d2, d
                                id2 = name
                            elif d < d3:
                                d3 = d
                low, high = min(id1, id2), max(id1, id2)
                word = philox(grow, low, low >> 32, high, high >> 32)[1]
                plate = word < np.uint64(np.float64(walls) * 4294967296.0)
                value = d3 - d1
                if plate:
                    value = min(value, (d2 - d1) * np.float32(2.0))
                field[z, y, x] = value

"""Figures 1 to 7 of Baravalle et al. (2016), drawn again with `bubbles`; apart from its photographs
and renderings.

Slices are as in the paper: bubbles black, mass white; what is outside of a form grey. Both ways to
grow are drawn where the figure is about growth: the paper's particles on the lattice, and the
fronts that stand in for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw

import trabecula as tb
from common import SCANS, busy, pictures, table
from trabecula.core.seeds import generator
from trabecula.mesh.voxels import fit_mesh
from trabecula.synth.bubbles.flow import FlowConfig, flow_of
from trabecula.view.picture import font

SIDE = 280  # pixels of a flat figure, voxels of a form
_GAP, _LETTERS, _WIDE = 12, 15, 200
GROWTHS = ("particles", "fronts")
Panel = tuple[str, np.ndarray]


def bubbles_figures() -> None:
    """Figures 1 to 7, each a sheet in TRABECULA_BENCH_OUT; a line each with the seconds it took and
    its porosities.
    """
    folder = pictures()
    if folder is None:
        print("(name a folder for the figures in TRABECULA_BENCH_OUT)")
        return
    row = table("figure", "s", "porosity", wide=44)
    jobs = {
        "1: separation 1, 2, 4": separation,
        "2: dynamical systems": systems,
        "3: randomness 0.3, 0.2, 0.1": randomness,
        "4: vectors along the silhouette": silhouettes,
        "5: boundary and dynamical system": slices,
        "6: horizontal and vertical by the ratio": ratios,
        "7: bunny, about the centre of mass": bunny,
    }
    for name, job in jobs.items():
        seconds, rows = busy(job)
        save(rows, folder / f"figure-{name[0]}.png")
        row(
            name,
            f"{seconds:.1f}",
            " ".join(
                f"{share(panel):.2f}" for panels in rows for _, panel in panels if share(panel)
            ),
        )


def separation() -> list[list[Panel]]:
    """Figure 1: particles that grow at random, and the width of the mass between them."""
    return [
        [
            (f"{growth}, separation {width}", grown(growth=growth, separation=width, distance=17))
            for width in (1, 2, 4)
        ]
        for growth in GROWTHS
    ]


def systems() -> list[list[Panel]]:
    """Figure 2: streamlines, as noise smeared along them."""
    names = [["quadratic", "concentric", "spiral"], ["roll", "elliptic", "saddle"]]
    return [[(name, streaks(FlowConfig(flow=name))) for name in line] for line in names]


def randomness() -> list[list[Panel]]:
    """Figure 3: how closely the system is followed."""
    return [
        [
            (
                f"{growth}, randomness {r}",
                grown(growth=growth, randomness=r, flow="concentric", distance=17, separation=1.5),
            )
            for r in (0.3, 0.2, 0.1)
        ]
        for growth in GROWTHS
    ]


def silhouettes() -> list[list[Panel]]:
    """Figure 4: the gradient of the blurred slice turned by 90 degrees, on a slice of one part and
    on one of several.
    """
    mask = form("bunny", SIDE)
    config = FlowConfig(silhouette=SIDE / 14)
    places = {"of one part": mask[int(0.6 * SIDE)], "of several": mask[int(0.42 * SIDE)]}
    return [[(words, cropped(streaks(config, plane), plane)) for words, plane in places.items()]]


def slices() -> list[list[Panel]]:
    """Figure 5: the outline at the border, a system inside; the first is the most random, the last
    the least.
    """
    mask = form("spot", 256)
    shares = {
        "distance": 11,
        "thickness": 0.14,
        "silhouette_share": 2,
        "crust_share": 0.5,
        "flow_axis": "x",
    }
    found = []
    for r, flow in ((1.0, "none"), (0.6, "roll"), (0.45, "spiral"), (0.3, "concentric")):
        material = made(mask, randomness=r, flow=flow, **shares)
        plane = mask[:, :, 128].T
        found.append(
            (f"{flow}, randomness {r}", cropped(drawn(material[:, :, 128].T, plane), plane))
        )
    return [found[:2], found[2:]]


def ratios() -> list[list[Panel]]:
    """Figure 6: one model, of which wide slices flow horizontally and tall ones vertically."""
    loaf = np.hypot(*np.ogrid[-1:1:200j, -1:1:300j]) < 1
    settings = {
        "flow_aspect": 1.2,
        "randomness": 0.35,
        "distance": 13,
        "separation": 1.5,
        "crust": 3,
    }
    return [
        [
            (words, drawn(made(mask, **settings), mask))
            for words, mask in (("wide", loaf), ("tall", loaf.T.copy()))
        ]
    ]


def bunny() -> list[list[Panel]]:
    """Figure 7: slices of one volume, each about its own centre of mass, walls of 2 voxels."""
    mask = form("bunny", 256)
    settings = {
        "flow": "concentric",
        "randomness": 0.35,
        "distance": 11,
        "separation": 2,
        "crust": 3,
    }
    material = made(mask, **settings)
    places = [int(part * len(mask)) for part in (0.42, 0.5, 0.58)]
    return [[(f"z = {at}", cropped(drawn(material[at], mask[at]), mask[at])) for at in places]]


def grown(**settings: Any) -> np.ndarray:
    """A square of bubbles, as a picture."""
    return drawn(tb.method("bubbles", **settings).fit().generate((SIDE, SIDE), seed=1).values)


def made(mask: np.ndarray, **settings: Any) -> np.ndarray:
    """A form full of bubbles."""
    return tb.method("bubbles", **settings).fit().generate(mask.shape, seed=1, mask=mask).values


def form(name: str, side: int) -> np.ndarray:
    """A mesh of the data folder in a cube of voxels."""
    mesh = tb.read_mesh(SCANS / f"mesh_{name}.ply")
    return tb.voxelise(
        fit_mesh(mesh, shape=side, spacing=1.0), spacing=1.0, shape=side
    ).values.astype(bool)


def drawn(labels: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Grey values of a slice."""
    shades = np.where(labels == 0, 20, 245).astype(np.uint8)
    return shades if mask is None else np.where(mask, shades, 150).astype(np.uint8)


def cropped(picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Crop a picture to the form, with y of the meshes upwards."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1][::-1]


def share(panel: np.ndarray) -> float:
    """Porosity of a drawn slice: black, of what is not outside of the form."""
    return float(np.sum(panel == 20) / max(1, np.sum(panel != 150)))


def streaks(config: FlowConfig, mask: np.ndarray | None = None) -> np.ndarray:
    """Noise smeared along the flow (line integral convolution, Cabral and Leedom 1993)."""
    shape = (SIDE, SIDE) if mask is None else mask.shape
    flow = flow_of(config, shape, 1.0, mask)
    assert flow is not None
    vectors = flow.directions(tuple((0, side) for side in shape)) / 127
    noise = generator(1, "streaks").random(shape)
    total, start = noise.copy(), np.indices(shape).astype(np.float64)
    for sign in (1, -1):
        place = start.copy()
        for _ in range(14):
            at = tuple(
                np.clip(np.rint(part), 0, side - 1).astype(int)
                for part, side in zip(place, shape, strict=True)
            )
            place += sign * np.moveaxis(vectors[at], -1, 0)
            total += noise[at]
    shades = 128 + 55 * (total - total.mean()) / total.std()
    still = ~vectors.any(axis=-1)
    shades[still] = 200
    picture = np.clip(shades, 21, 245).astype(np.uint8)
    return picture if mask is None else np.where(mask, picture, 150).astype(np.uint8)


def save(rows: Sequence[Sequence[Panel]], path: Path) -> None:
    """Panels in rows, their captions below them."""
    wide = (
        max(sum(max(panel.shape[1], _WIDE) + _GAP for _, panel in panels) for panels in rows) + _GAP
    )
    tall = (
        sum(max(panel.shape[0] for _, panel in panels) + 2 * _LETTERS + _GAP for panels in rows)
        + _GAP
    )
    sheet = Pillow.new("L", (wide, tall), 255)
    pen, top = ImageDraw.Draw(sheet), _GAP
    for panels in rows:
        left, below = _GAP, top + max(panel.shape[0] for _, panel in panels)
        for words, panel in panels:
            sheet.paste(Pillow.fromarray(panel), (left, top))
            pen.text((left, below + 4), words, fill=0, font=font(_LETTERS))
            left += max(panel.shape[1], _WIDE) + _GAP
        top = below + 2 * _LETTERS + _GAP
    sheet.save(path)


if __name__ == "__main__":
    bubbles_figures()

"""`bubbles`: the paper's table I beside ours, one material on several grids, porosity asked for and
reached.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, busy, table, timed, unit
from trabecula.mesh.voxels import fit_mesh
from trabecula.testing.peak import peak_bytes

BUBBLES = 7000
PAPER = {128: (14.69, 34.61, "~75"), 256: (38.83, 155.99, "~25"), 384: (85.82, 356.35, "~33")}
"""Table I: seconds of loading and voxelising, seconds of growing; bytes of the process by voxels.
"""

GRIDS = {128: 3.0, 192: 2.0, 384: 1.0}
"""Edge and spacing of one cube of 384 units."""


def bubbles_table() -> None:
    """Table I: a form loaded and voxelised, 7000 bubbles grown in its box, one thread, kernels
    compiled, best of three.

    Seconds are the processor's. `flow` is growing with a flow about the middle of every slice of
    the form, `porosity` with half of it void, whose level is found first. `bytes` are those held at
    most per voxel, the result among them.
    """
    heads = (
        "load s",
        "grow s",
        "flow s",
        "porosity s",
        "total s",
        "bytes",
        "paper s",
        "paper bytes",
    )
    row = table(f"cube (unit {unit():.3f} s)", *heads, wide=20)
    grown(_model(32), 32)  # compiles
    for side, (load, main, held) in PAPER.items():
        loading, mask = _loaded(side)
        model = _model(side)
        plain, flow = (
            _best(model, side),
            _best(_model(side, flow="roll", randomness=0.3), side, mask=mask),
        )
        half = _best(_model(side, porosity=0.5), side)
        most = peak_bytes(lambda m=model, s=side: grown(m, s)) / side**3
        cells = (loading, plain, flow, half, loading + plain)
        row(
            f"{side}^3", *(f"{cell:.2f}" for cell in cells), f"{most:.1f}", f"{load} + {main}", held
        )


def bubbles_threads() -> None:
    """384^3 with 7000 bubbles: seconds on the wall with one thread and two. It says something on a
    quiet machine only.
    """
    row = table("cube", "1 thread s", "2 threads s", "ratio")
    model = _model(384)
    found = []
    for count in (1, 2):
        with tb.threads(count):
            grown(model, 32)
            found.append(min(timed(lambda: grown(model, 384))[0] for _ in range(3)))
    row("384^3", *(f"{one:.2f}" for one in found), f"{found[0] / found[1]:.2f}")


def bubbles_grids() -> None:
    """One cube of 384 units at three spacings: 900 bubbles, walls of 4 units; mean and spread over
    three seeds.

    `seeds` is the mean over seeds of how far the coarse grid's figure lies from the finest's with
    the same seed.
    """
    row = table(
        "cube",
        "spacing",
        "porosity %",
        "+-",
        "seeds",
        "chord",
        "+-",
        "seeds",
        "pore size",
        "+-",
        wide=10,
    )
    figures = {side: np.array([_figures(side, seed) for seed in range(3)]) for side in GRIDS}
    finest = figures[384]
    for side, found in figures.items():
        mean, spread, apart = found.mean(0), found.std(0, ddof=1), np.abs(found - finest).mean(0)
        cells = [
            f"{cell:.2f}" for name in range(3) for cell in (mean[name], spread[name], apart[name])
        ]
        row(f"{side}^3", GRIDS[side], *cells[:-1])


def bubbles_porosity() -> None:
    """Porosity reached, in points off what was asked for: the worst and the root mean square of
    five seeds, 160^3 and 256^3.
    """
    row = table("cube", "asked %", "worst", "rms", wide=10)
    for side in (120, 160, 256):
        for asked in (0.1, 0.5):
            model = tb.method("bubbles", distance=20.0, porosity=asked).fit()
            off = np.array([100 * (grown(model, side, seed) - asked) for seed in range(5)])
            row(
                f"{side}^3",
                100 * asked,
                f"{np.abs(off).max():.3f}",
                f"{np.sqrt((off**2).mean()):.3f}",
            )


def grown(model: Any, side: int, seed: int = 0, **parts: Any) -> float:
    """Make a cube, as if for the first time; its porosity."""
    model = type(model)(model.config, model.facts)
    request = tb.Request((side,) * 3, seed=seed, **parts)
    return 1 - float(model.values_of(request, ((0, side),) * 3).mean())


def _model(side: int, **settings: Any) -> Any:
    """7000 bubbles in a cube of 384 units."""
    return tb.method("bubbles", density=BUBBLES / 384.0**3, **settings).fit(spacing=384.0 / side)


def _best(model: Any, side: int, **parts: Any) -> float:
    with tb.threads(1):
        return min(busy(lambda: grown(model, side, **parts))[0] for _ in range(3))


def _loaded(side: int) -> tuple[float, np.ndarray | None]:
    """Seconds of reading and voxelising the form, and the form; none where the folder of forms is
    not there.
    """

    def load() -> np.ndarray:
        mesh = fit_mesh(tb.read_mesh(SCANS / "mesh_bunny.ply"), shape=side, spacing=1.0)
        return np.asarray(tb.voxelise(mesh, spacing=1.0, shape=side).values != 0)

    if not SCANS.is_dir():
        return 0.0, None
    with tb.threads(1):
        load()
        return busy(load)


def _figures(side: int, seed: int) -> tuple[float, float, float]:
    """Porosity in percent, mean chord of the void, and pore size of a middle cube of 192 units."""
    model = tb.method("bubbles", density=900 / 384.0**3, separation=4.0, spread=0.25).fit(
        spacing=GRIDS[side]
    )
    made = model.generate((side,) * 3, seed=seed)
    part = tb.crop(made, side // 2)
    return (
        100 * tb.measure.porosity(made),
        tb.measure.chord_length(made, phase="void"),
        tb.measure.pore_size(part),
    )

"""`texture`: seconds, threads and memory, each beside the floor by counting (see stages.py); cost
against size.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import trabecula as tb
from common import SCANS, busy, table, timed, unit
from descriptors import LABELS
from stages import show, watched
from texture import fitted, presets
from trabecula.testing.peak import peak_bytes


def speed() -> None:
    """One thread, kernels compiled, best of two: 120^3 from 60^3, and 256^3 from 100^3; threads,
    memory, stages.

    Seconds are the processor's; `1 / 2 threads` compares seconds on the wall, so it says something
    on a quiet machine only. `bytes` are those held at most per voxel of the output, beyond the
    output and the model.
    """
    base = unit()
    heads = ("fit s", "make s", "/ unit", "ns / voxel", "1 / 2 threads", "bytes")
    shown = []
    row = table(f"shape, preset (unit {base:.3f} s)", *heads, wide=30)
    for side, exemplar, name, settings in [
        *(
            (120, _bone(60), name, settings)
            for name, settings in presets("fast", "default", "best")
        ),
        *((256, _bone(100), name, settings) for name, settings in presets("fast", "default")),
    ]:
        title = f"{side}^3 from {exemplar.shape[0]}^3, {name}"
        cells, stages = _measured(side, exemplar, settings, base)
        row(title, *cells)
        shown.append((title, stages))
    for title, (profile, seconds) in shown:
        print()
        show(profile, seconds, title)


def _bone(side: int) -> tb.Image:
    """A crop of a scan, of the sample where there is none."""
    file, edge, length = LABELS["bone a"]
    whole = (
        tb.read(SCANS / file, spacing=edge, unit=length) if SCANS.is_dir() else tb.sample("bone")
    )
    return tb.crop(whole, min(side, *whole.shape))


def _measured(
    side: int, exemplar: tb.Image, settings: Mapping[str, Any], base: float
) -> tuple[list[str], Any]:
    """The cells of a row, and the stages of one run with its seconds."""
    fitted(exemplar, settings).generate(24)  # compiles
    fit, model = min(
        (busy(lambda: fitted(exemplar, settings)) for _ in range(2)), key=lambda pair: pair[0]
    )
    runs = []
    for _ in range(2):
        with watched(model.config) as profile:
            wall, (make, _) = timed(lambda: busy(lambda: model.generate(side, seed=0)))
        runs.append((make, wall, profile))
    make, _, stages = min(runs, key=lambda run: run[0])
    with tb.threads(2):
        both = min(timed(lambda: model.generate(side, seed=0))[0] for _ in range(2))
    speedup = min(wall for _, wall, _ in runs) / both
    beyond = peak_bytes(lambda: model.generate(side, seed=0)) / side**3 - 1
    cells = [
        f"{fit:.2f}",
        f"{make:.2f}",
        f"{(fit + make) / base:.0f}",
        f"{make / side**3 * 1e9:.0f}",
        f"{speedup:.2f}",
        f"{beyond:.1f}",
    ]
    return cells, (stages, make)


def sizes() -> None:
    """Cost against size: processor seconds and nanoseconds a voxel; bytes a voxel beside those of
    the forecast.

    Bytes are held at most beyond the model: the output is one of them.
    """
    row = table("shape", "make s", "ns / voxel", "bytes", "forecast")
    model = fitted(tb.crop(tb.sample("bone"), 60), {})
    model.generate(24)
    for side in (60, 120, 180):
        request = tb.Request(side, seed=0)
        seconds, _ = busy(lambda r=request: model.generate(r))
        held = peak_bytes(lambda r=request: model.generate(r))
        plan = model.plan(request).memory
        forecast = plan["output"] + plan["scratch"]
        voxels = side**3
        row(
            f"{side}^3",
            f"{seconds:.2f}",
            f"{seconds / voxels * 1e9:.0f}",
            f"{held / voxels:.1f}",
            f"{forecast / voxels:.1f}",
        )

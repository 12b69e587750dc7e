"""Seconds and bytes of the methods that learn from pictures, at the sizes that were asked for."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Mapping
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, asked, table
from trabecula.core.errors import TrabeculaError
from trabecula.synth.api.registry import methods

# case -> kind, pixels a side of the picture, voxels a side, method, settings, seconds that two
# cores may take
JOBS: dict[str, tuple[str, int, int, str, Mapping[str, Any], float]] = {
    "grey 64^3 of 64^2, 7x7": (
        "grey",
        64,
        64,
        "mrf",
        {"neighbourhood": 7, "scales": 3, "relaxation": "gibbs"},
        180,
    ),
    "colour 64^3 of 64^2, 11x11": (
        "colour",
        64,
        64,
        "mrf",
        {"neighbourhood": 11, "scales": 3},
        900,
    ),
    "labels 128^3 of 256^2": ("labels", 256, 128, "mrf", {}, 600),
}
LIMIT = 60
"""Seconds for 128^3 by any other method."""
FILES = {
    "labels": "micrograph_ceramics.png",
    "grey": "tex_gravel.png",
    "colour": "bread_baguette2.png",
}


def picture(kind: str, side: int) -> tb.Image:
    """The middle of a picture of a kind; noise where the folder is not here."""
    if SCANS.is_dir():
        return tb.crop(tb.read(SCANS / FILES[kind]), side)
    levels = (
        np.random.default_rng(0)
        .integers(0, 2 if kind == "labels" else 256, (side, side, 3))
        .astype(np.uint8)
    )
    return tb.Image(levels if kind == "colour" else levels[..., 0], kind)


def jobs() -> dict[str, tuple[str, int, int, str, Mapping[str, Any], float]]:
    """Those of `mrf`, and 128^3 of every kind for every other method that learns from pictures."""
    found = {name: job for name, job in JOBS.items() if job[3] in methods()}
    for method, spec in methods().items():
        if spec.exemplar == "2d" and method != "mrf":
            found |= {
                f"{kind} 128^3 of 256^2, {method}": (kind, 256, 128, method, {}, LIMIT)
                for kind in spec.kinds
            }
    return found


def image_speed() -> None:
    """The sizes of the goals: seconds with kernels compiled, on two threads and of the processor,
    and bytes a voxel.

    `goal` is for two cores. Bytes are held at most beyond the model, counted in a run of their own
    where that is below two minutes. `--only kopf` takes the rows that hold that word, `--methods
    kopf:fast` another preset.
    """
    row = table(
        "job", "goal s", "wall s, 2 threads", "processor s", "ns / voxel", "bytes / voxel", wide=34
    )
    presets = dict(word.partition(":")[::2] for word in asked("METHODS"))
    for name, (kind, pixels, side, method, settings, goal) in jobs().items():
        if (asked("ONLY") and not any(word in name for word in asked("ONLY"))) or (
            presets and method not in presets
        ):
            continue
        preset = {"preset": presets[method]} if presets.get(method) else {}
        try:
            row(name, goal, *_run(picture(kind, pixels), side, method, {**preset, **settings}))
        except TrabeculaError as error:
            print(f"{name}: {error}")


def _run(exemplar: tb.Image, side: int, method: str, settings: Mapping[str, Any]) -> list[str]:
    learner = tb.method(method, **settings)
    learner.fit(exemplar).generate(24, seed=1)  # compiles
    with tb.threads(2):
        wall, busy = time.perf_counter(), time.process_time()
        model = learner.fit(exemplar)
        model.generate(side, seed=0)
        wall, busy = time.perf_counter() - wall, time.process_time() - busy
    held = "-"
    if busy < 120:
        tracemalloc.start()
        model.generate(side, seed=0)
        held = f"{tracemalloc.get_traced_memory()[1] / side**3:.0f}"
        tracemalloc.stop()
    return [f"{wall:.1f}", f"{busy:.1f}", f"{busy / side**3 * 1e9:.0f}", held]

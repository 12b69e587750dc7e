"""Path-traced stills: seconds, memory beside the volume, and noise against a long reference."""

from __future__ import annotations

import time

import numpy as np

import trabecula as tb
from common import asked, pictures, table
from trabecula.view.trace.photograph import SAMPLES, forecast_traced
from view import bone

LOOKS = ("bone", "stone")
SMALL, LONG = (160, 120), 256


def stills() -> None:
    """Seconds of 800 x 600 of 256^3, and memory beside the volume; looks by --only."""
    volume = bone(256)
    held = forecast_traced(volume.shape, (800, 600)).memory
    beside = sum(held[name] for name in ("field", "blocks", "rim")) / volume.values.size
    print(f"memory beside the volume, without the film: {beside:.2f} bytes a voxel")
    row = table("still", "s, wall", "s, processor", "own noise")
    for look in asked("ONLY") or LOOKS:
        tb.render(volume, look=look, quality="draft", size=(32, 24), samples=2)
        for quality in SAMPLES:
            start, busy = time.perf_counter(), time.process_time()
            still = tb.render(volume, look=look, quality=quality)
            wall, cpu = time.perf_counter() - start, time.process_time() - busy
            noise = still.recipe.to_json()[-1]["noise"]
            row(f"{look}, {quality}", f"{wall:.1f}", f"{cpu:.1f}", f"{noise:.2f}")
            if pictures() is not None:
                tb.write(still, pictures() / f"still-{look}-{quality}.png")


def stills_noise() -> None:
    """Noise of 160 x 120 of 64^3, pixels as fine beside voxels as in 800 x 600 of 256^3: the
    standard deviation of a channel (0..255) by the picture's own halves, and its root mean square
    difference from 256 paths a pixel; looks by --only.
    """
    volume = bone(64)
    row = table("still", "own noise", "from long", "largest 1 %")
    for look in asked("ONLY") or LOOKS:
        given = {"look": look, "size": SMALL}
        long = tb.render(volume, quality="fine", samples=LONG, **given).values.astype(float)
        for quality in SAMPLES:
            small = tb.render(volume, quality=quality, **given)
            apart = np.abs(small.values - long)
            row(
                f"{look}, {quality}",
                f"{small.recipe.to_json()[-1]['noise']:.2f}",
                f"{np.sqrt(np.mean(apart**2)):.2f}",
                f"{np.quantile(apart, 0.99):.0f}",
            )

"""Path-traced stills: seconds, memory beside the volume, and noise against a long reference."""

from __future__ import annotations

import time

import numpy as np

import trabecula as tb
from common import pictures, table
from trabecula.view.trace.photograph import SAMPLES, forecast_traced
from view import bone

LOOKS = ("bone", "stone", "foam")
SMALL, LONG = (120, 90), 512


def stills() -> None:
    """Seconds of 800 x 600 of 256^3, and the noise of 120 x 90 of it: the standard deviation of a
    channel (0..255) by the picture's own two halves, and the root mean square difference from a
    reference of 512 paths a pixel.
    """
    volume = bone(256)
    held = forecast_traced(volume.shape, (800, 600)).memory
    beside = sum(held[name] for name in ("field", "blocks", "rim"))
    print(f"memory beside the volume, without the film: {beside / volume.values.size:.2f} bytes a "
          f"voxel, with it {1 + beside / volume.values.size:.2f}")  # fmt: skip
    row = table("still", "s, wall", "s, processor", "own noise", "from long", "largest 1 %")
    for look in LOOKS:
        tb.render(volume, look=look, quality="draft", size=(32, 24), samples=2)
        long = tb.render(volume, look=look, quality="fine", size=SMALL, samples=LONG)
        reference = long.values.astype(float)
        for quality in SAMPLES:
            start, busy = time.perf_counter(), time.process_time()
            still = tb.render(volume, look=look, quality=quality)
            wall, cpu = time.perf_counter() - start, time.process_time() - busy
            small = tb.render(volume, look=look, quality=quality, size=SMALL)
            apart = np.abs(small.values - reference)
            row(
                f"{look}, {quality}",
                f"{wall:.1f}",
                f"{cpu:.1f}",
                f"{small.recipe.to_json()[-1]['noise']:.2f}",
                f"{np.sqrt(np.mean(apart**2)):.2f}",
                f"{np.quantile(apart, 0.99):.0f}",
            )
            if pictures() is not None:
                tb.write(still, pictures() / f"still-{look}-{quality}.png")
